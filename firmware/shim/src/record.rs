//! State that survives a system reset, and counters for a debugger: at a fixed address that QEMU does not reload.

use core::mem::offset_of;

use crate::flash::NEW_OPTIONS;
use crate::gpio::Gpio;
use crate::rcc::ResetCause;

/// Address of the record, as in the linker script.
pub const ADDRESS: u32 = 0x1000_FF00;
/// Length of the record, words.
pub const WORDS: usize = size_of::<Record>() / 4;
/// Address of [`Record::power_cut`].
pub const POWER_CUT_ADDRESS: u32 = ADDRESS + offset_of!(Record, power_cut) as u32;
/// Address of [`Record::conditions`].
pub const CONDITIONS_ADDRESS: u32 = ADDRESS + offset_of!(Record, conditions) as u32;
/// Marks a record that this program has written.
const MARK: u32 = 0x5265_6331;
/// Number of words before the ports.
const PLAIN: usize = 14;

/// QEMU's handles of open files.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Handles {
    /// File with the changeable sectors of the flash; zero: not open.
    pub flash: u32,
    /// Pipe to the plant; zero: no plant is connected.
    pub request: u32,
    /// Pipe from the plant.
    pub answer: u32,
    /// File with the backup domain.
    pub backup: u32,
}

/// The record. It counts from power-on.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Record {
    mark: u32,
    /// Number of starts, including the first.
    pub starts: u32,
    /// Reset flags of `RCC_CSR` that the program has not cleared.
    pub reset_flags: u32,
    /// 1 if the watchdog has expired and caused the coming reset.
    expired: u32,
    /// Number of resets by the watchdog.
    pub watchdog_resets: u32,
    /// Number of feedings of the running watchdog.
    pub feeds: u32,
    /// Longest time between two feedings, nanoseconds, saturating.
    pub longest_gap_ns: u32,
    /// Number of emulated loads and stores.
    pub traps: u32,
    /// The open files.
    pub files: Handles,
    /// Number of erased sectors and programmed values.
    pub flash_operations: u32,
    /// Number of flash operations at which the power is cut; a debugger sets it ([`POWER_CUT_ADDRESS`]); zero: never.
    pub power_cut: u32,
    /// Ports A and B.
    pub ports: [Gpio; 2],
    /// Adverse conditions, such as [`NO_CRYSTAL`]; a debugger sets them ([`CONDITIONS_ADDRESS`]), and they survive a reset.
    pub conditions: u32,
    /// The flash's access control register: wait states, prefetch and caches.
    pub flash_access: u32,
    /// The option bytes, which keep their values until the emulation ends.
    pub options: u32,
}

/// Condition: the crystal does not run.
pub const NO_CRYSTAL: u32 = 1;
/// Condition: the supply voltage is low.
pub const SUPPLY_LOW: u32 = 1 << 1;
/// Condition: the crystal of the calendar clock does not run.
pub const NO_CLOCK_CRYSTAL: u32 = 1 << 2;

/// Ports A and B after a reset, with the debugger's pins configured.
const PORTS: [Gpio; 2] =
    [Gpio::new(0xA800_0000, 0x0C00_0000, 0x6400_0000), Gpio::new(0x0000_0280, 0x0000_00C0, 0x0000_0100)];

impl Record {
    pub(crate) fn at_power_on() -> Self {
        Self { mark: MARK, ports: PORTS, options: NEW_OPTIONS, ..Self::default() }
    }

    /// Counts a start of the chip and adds its cause to the reset flags. A record that this program has written is kept;
    /// otherwise the power was just switched on.
    pub fn begin(&mut self) {
        let cause = if self.mark != MARK {
            *self = Self::at_power_on();
            ResetCause::PowerOn
        } else if self.expired == 1 {
            self.watchdog_resets += 1;
            ResetCause::Watchdog
        } else {
            ResetCause::Software
        };
        self.expired = 0;
        self.starts += 1;
        self.reset_flags |= cause.flags();
        self.ports = PORTS;
    }

    /// Sets the watchdog as the cause of the next start.
    pub fn expire(&mut self) {
        self.expired = 1;
    }

    /// Counts a feeding of the watchdog this many nanoseconds after the last one.
    pub(crate) fn fed(&mut self, gap_ns: u64) {
        self.feeds += 1;
        self.longest_gap_ns = self.longest_gap_ns.max(u32::try_from(gap_ns).unwrap_or(u32::MAX));
    }

    /// Decodes the words at [`ADDRESS`]; none if no shim has run.
    pub fn from_words(words: &[u32; WORDS]) -> Option<Self> {
        let (plain, ports) = words.split_first_chunk::<PLAIN>()?;
        let [mark, starts, reset_flags, expired, watchdog_resets, feeds, longest_gap_ns, traps, ..] = *plain;
        let [.., flash, request, answer, backup, flash_operations, power_cut] = *plain;
        let (a, rest) = ports.split_first_chunk()?;
        let (b, rest) = rest.split_first_chunk()?;
        let [conditions, flash_access, options] = *rest.first_chunk()?;
        let record = Self {
            mark,
            starts,
            reset_flags,
            expired,
            watchdog_resets,
            feeds,
            longest_gap_ns,
            traps,
            files: Handles { flash, request, answer, backup },
            flash_operations,
            power_cut,
            ports: [Gpio::from_words(*a), Gpio::from_words(*b)],
            conditions,
            flash_access,
            options,
        };
        (mark == MARK).then_some(record)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn blank() -> Record {
        Record { mark: 0, starts: 77, ..Record::at_power_on() }
    }

    #[test]
    fn memory_without_the_mark_means_power_on() {
        let mut record = blank();
        record.begin();
        assert_eq!((record.starts, record.reset_flags), (1, ResetCause::PowerOn.flags()));
    }

    #[test]
    fn an_unannounced_start_is_a_software_reset() {
        let mut record = blank();
        record.begin();
        record.reset_flags = 0;
        record.begin();
        assert_eq!((record.starts, record.reset_flags), (2, ResetCause::Software.flags()));
    }

    #[test]
    fn after_the_watchdog_expired_it_is_the_cause_once() {
        let mut record = blank();
        record.begin();
        record.expire();
        for (flags, resets) in [(ResetCause::Watchdog.flags(), 1), (ResetCause::Software.flags(), 1)] {
            record.reset_flags = 0;
            record.begin();
            assert_eq!((record.reset_flags, record.watchdog_resets), (flags, resets));
        }
    }

    #[test]
    fn flags_that_were_not_removed_add_up() {
        let mut record = blank();
        record.begin();
        record.begin();
        assert_eq!(record.reset_flags, ResetCause::PowerOn.flags() | ResetCause::Software.flags());
    }

    #[test]
    fn open_files_outlive_a_reset_and_pins_do_not() {
        let mut record = blank();
        record.begin();
        record.files.flash = 3;
        record.ports[0] = Gpio::new(0, 0, 0);
        record.begin();
        assert_eq!((record.files.flash, record.ports), (3, PORTS));
    }

    #[test]
    fn the_longest_gap_between_feedings_is_kept() {
        let mut record = Record::at_power_on();
        for gap in [3_000_000, 9_000_000, 1_000_000] {
            record.fed(gap);
        }
        assert_eq!((record.feeds, record.longest_gap_ns), (3, 9_000_000));
    }

    #[test]
    fn a_debugger_reads_the_words_in_their_order() {
        let mut words: [u32; WORDS] = core::array::from_fn(|n| n as u32);
        assert_eq!(Record::from_words(&words), None);
        words[0] = MARK;
        let record = Record::from_words(&words).unwrap();
        assert_eq!((record.starts, record.traps, record.flash_operations), (1, 7, 12));
        assert_eq!((record.power_cut, POWER_CUT_ADDRESS), (13, ADDRESS + 4 * 13));
        assert_eq!((record.conditions, CONDITIONS_ADDRESS), (34, ADDRESS + 4 * 34));
        assert_eq!((record.flash_access, record.options), (35, 36));
        assert_eq!(record.ports[1], Gpio::from_words(core::array::from_fn(|n| 24 + n as u32)));
    }
}
