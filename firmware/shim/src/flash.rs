//! Flash controller (RM0090, section 3): lock and keys, sector erase, programming of 8, 16 or 32 bits, error flags.
//!
//! Sectors 7 to 11, which contain calibrations, copies of the flight recorder and the weights, can be changed; the program's own sectors are
//! write-protected. An operation takes no time, so the busy flag is never set.

use crate::store::{Store, Width};

/// First address of the flash.
pub const START: u32 = 0x0800_0000;
/// Length of the flash, bytes.
pub const BYTES: u32 = 8 * SECTOR_BYTES;
/// First address of sector 7.
pub const SLOTS: u32 = 0x0806_0000;
/// Length of sectors 7 to 11 together, bytes.
pub const SLOTS_BYTES: u32 = 5 * SECTOR_BYTES;
/// Offset of the copies of the flight recorder, sectors 8 and 9, from [`SLOTS`].
pub const COPIES: u32 = SECTOR_BYTES;
/// Offset of the weights slots, sectors 10 and 11, from [`SLOTS`].
pub const WEIGHTS: u32 = 3 * SECTOR_BYTES;
/// Length of a large sector, bytes.
pub const SECTOR_BYTES: u32 = 128 * 1024;
/// Value of an erased byte.
pub const ERASED: u8 = 0xFF;

const FIRST_SECTOR: u32 = 7;
const KEYS: [u32; 2] = [0x4567_0123, 0xCDEF_89AB];

const OPTION_KEYS: [u32; 2] = [0x0819_2A3B, 0x4C5D_6E7F];
const OPTIONS_LOCK: u32 = 1;
const OPTIONS_START: u32 = 1 << 1;
/// Option bytes of a new chip: no brown-out reset, no protection.
pub const NEW_OPTIONS: u32 = 0x0FFF_AAEC;

/// Status register: end of operation, and reasons for refusing one.
mod status {
    pub const END: u32 = 1;
    pub const PROTECTED: u32 = 1 << 4;
    pub const ALIGNMENT: u32 = 1 << 5;
    pub const PARALLELISM: u32 = 1 << 6;
    pub const SEQUENCE: u32 = 1 << 7;
}

/// Control register.
mod control {
    pub const PROGRAM: u32 = 1;
    pub const ERASE_SECTOR: u32 = 1 << 1;
    pub const ERASE_ALL: u32 = 1 << 2;
    pub const START: u32 = 1 << 16;
    pub const END_INTERRUPT: u32 = 1 << 24;
    pub const LOCK: u32 = 1 << 31;
}

/// State of the key sequence.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Key {
    /// No key was written.
    Out,
    /// The first key was written.
    Half,
    /// A wrong key was written: locked until the next reset.
    Broken,
}

/// The flash controller.
#[derive(Clone, Debug)]
pub struct Flash {
    access: u32,
    status: u32,
    control: u32,
    /// Option control register.
    options: u32,
    /// The option bytes in the flash, in the layout of that register.
    programmed: u32,
    key: Key,
    option_key: Key,
}

/// Operation on the memory behind the controller.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Operation {
    /// Set these bytes to [`ERASED`].
    Erase {
        /// First address.
        address: u32,
        /// Number of bytes.
        bytes: u32,
    },
    /// Clear the bits that are zero in `value`.
    Program {
        /// First address.
        address: u32,
        /// Width of the value.
        width: Width,
        /// Value to program.
        value: u32,
    },
}

impl Flash {
    /// The controller after a reset, with these option bytes.
    pub(crate) const fn new(programmed: u32) -> Self {
        Self {
            access: 0,
            status: 0,
            control: control::LOCK,
            options: programmed | OPTIONS_LOCK,
            programmed,
            key: Key::Out,
            option_key: Key::Out,
        }
    }

    /// The option bytes in the flash.
    pub(crate) fn programmed(&self) -> u32 {
        self.programmed
    }

    /// The word at an offset; zero where there is no register.
    pub fn read(&self, offset: u32) -> u32 {
        match offset {
            0x00 => self.access,
            0x0C => self.status,
            0x10 => self.control,
            0x14 => self.options,
            _ => 0,
        }
    }

    /// Stores to an offset.
    pub fn write(&mut self, offset: u32, store: Store) -> Option<Operation> {
        match offset {
            0x00 => self.access = store.over(self.access),
            0x04 => self.turn(store.bits()),
            0x08 => self.turn_options(store.bits()),
            0x0C => self.status &= !store.bits(),
            0x14 if self.options & OPTIONS_LOCK == 0 => {
                self.options = store.over(self.options) & !OPTIONS_START;
                if store.bits() & OPTIONS_START != 0 {
                    self.programmed = self.options & !OPTIONS_LOCK;
                }
            }
            0x10 if self.control & control::LOCK == 0 => return self.command(store.over(self.control)),
            _ => {}
        }
        None
    }

    fn turn_options(&mut self, key: u32) {
        self.option_key = match self.option_key {
            Key::Out if key == OPTION_KEYS[0] => Key::Half,
            Key::Half if key == OPTION_KEYS[1] => {
                self.options &= !OPTIONS_LOCK;
                Key::Out
            }
            _ => Key::Broken,
        }
    }

    fn turn(&mut self, key: u32) {
        self.key = match self.key {
            Key::Out if key == KEYS[0] => Key::Half,
            Key::Half if key == KEYS[1] => {
                self.control &= !control::LOCK;
                Key::Out
            }
            _ => Key::Broken,
        }
    }

    /// A store to the unlocked control register.
    fn command(&mut self, value: u32) -> Option<Operation> {
        self.control = value & !control::START;
        if value & control::START == 0 {
            return None;
        }
        let sector = value >> 3 & 0x1F;
        if value & control::ERASE_ALL != 0 || sector < FIRST_SECTOR {
            self.status |= status::PROTECTED;
            return None;
        }
        let address = SLOTS + (sector - FIRST_SECTOR) * SECTOR_BYTES;
        let in_slots = address < SLOTS + SLOTS_BYTES;
        if value & control::ERASE_SECTOR == 0 || value & control::PROGRAM != 0 || !in_slots {
            self.status |= status::SEQUENCE;
            return None;
        }
        self.finish();
        Some(Operation::Erase { address, bytes: SECTOR_BYTES })
    }

    /// A store to the flash memory.
    pub fn program(&mut self, address: u32, width: Width, value: u32) -> Option<Operation> {
        let refusal = if self.control & (control::LOCK | control::PROGRAM | control::ERASE_SECTOR)
            != control::PROGRAM
        {
            status::SEQUENCE
        } else if self.control >> 8 & 3 != width.bytes().ilog2() {
            status::PARALLELISM
        } else if !address.is_multiple_of(width.bytes()) {
            status::ALIGNMENT
        } else {
            self.finish();
            return Some(Operation::Program { address, width, value: value & width.mask() });
        };
        self.status |= refusal;
        None
    }

    fn finish(&mut self) {
        if self.control & control::END_INTERRUPT != 0 {
            self.status |= status::END;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn unlocked() -> Flash {
        let mut flash = Flash::new(NEW_OPTIONS);
        for key in KEYS {
            flash.write(0x04, Store::word(key));
        }
        flash
    }

    /// A controller ready to program words of `8 << parallelism` bits.
    fn programming(parallelism: u32) -> Flash {
        let mut flash = unlocked();
        flash.write(0x10, Store::word(control::PROGRAM | parallelism << 8));
        flash
    }

    fn erase(sector: u32) -> u32 {
        control::ERASE_SECTOR | control::START | sector << 3
    }

    #[test]
    fn it_is_locked_until_both_keys_came_in_their_order() {
        assert_eq!(unlocked().read(0x10), 0);
        for keys in [[KEYS[1], KEYS[0]], [KEYS[0], KEYS[0]], [KEYS[0], 0]] {
            let mut flash = Flash::new(NEW_OPTIONS);
            for key in keys {
                flash.write(0x04, Store::word(key));
            }
            assert_eq!(flash.read(0x10), control::LOCK);
        }
    }

    #[test]
    fn after_a_wrong_key_the_right_ones_do_not_help() {
        let mut flash = Flash::new(NEW_OPTIONS);
        for key in [1, KEYS[0], KEYS[1]] {
            flash.write(0x04, Store::word(key));
        }
        assert_eq!(flash.read(0x10), control::LOCK);
    }

    #[test]
    fn while_locked_nothing_is_erased_or_programmed() {
        let mut flash = Flash::new(NEW_OPTIONS);
        assert_eq!(flash.write(0x10, Store::word(erase(10))), None);
        assert_eq!(flash.program(SLOTS, Width::Word, 0), None);
        assert_eq!(flash.read(0x0C), status::SEQUENCE);
    }

    #[test]
    fn locking_again_ends_programming() {
        let mut flash = programming(2);
        flash.write(0x10, Store::word(control::LOCK | control::PROGRAM | 2 << 8));
        assert_eq!(flash.program(SLOTS, Width::Word, 0), None);
        assert_eq!(flash.write(0x10, Store::word(0)), None);
        assert_ne!(flash.read(0x10) & control::LOCK, 0);
    }

    #[test]
    fn each_slot_is_erased_by_its_sector() {
        for (sector, address) in
            [(7, 0x0806_0000), (8, 0x0808_0000), (9, 0x080A_0000), (10, 0x080C_0000), (11, 0x080E_0000)]
        {
            let operation = unlocked().write(0x10, Store::word(erase(sector)));
            assert_eq!(operation, Some(Operation::Erase { address, bytes: SECTOR_BYTES }));
        }
    }

    #[test]
    fn the_programs_sectors_are_protected() {
        let mut flash = unlocked();
        assert_eq!(flash.write(0x10, Store::word(erase(6))), None);
        assert_eq!(flash.read(0x0C), status::PROTECTED);
        let mut flash = unlocked();
        assert_eq!(flash.write(0x10, Store::word(control::ERASE_ALL | control::START)), None);
        assert_eq!(flash.read(0x0C), status::PROTECTED);
    }

    #[test]
    fn a_sector_that_is_not_there_is_not_erased() {
        let mut flash = unlocked();
        assert_eq!(flash.write(0x10, Store::word(erase(12))), None);
        assert_eq!(flash.read(0x0C), status::SEQUENCE);
    }

    #[test]
    fn programming_takes_the_width_that_was_set() {
        for (parallelism, width) in [(0, Width::Byte), (1, Width::Half), (2, Width::Word)] {
            let operation = programming(parallelism).program(SLOTS + 4, width, 0xDEAD_BEEF);
            let value = 0xDEAD_BEEF & width.mask();
            assert_eq!(operation, Some(Operation::Program { address: SLOTS + 4, width, value }));
        }
    }

    #[test]
    fn another_width_is_an_error_of_parallelism() {
        for (parallelism, width) in [(2, Width::Byte), (0, Width::Word), (3, Width::Word)] {
            let mut flash = programming(parallelism);
            assert_eq!(flash.program(SLOTS, width, 0), None);
            assert_eq!(flash.read(0x0C), status::PARALLELISM);
        }
    }

    #[test]
    fn an_address_between_two_words_is_an_error_of_alignment() {
        let mut flash = programming(2);
        assert_eq!(flash.program(SLOTS + 2, Width::Word, 0), None);
        assert_eq!(flash.read(0x0C), status::ALIGNMENT);
    }

    #[test]
    fn a_store_without_programming_is_an_error_of_sequence() {
        let mut flash = unlocked();
        assert_eq!(flash.program(SLOTS, Width::Word, 0), None);
        assert_eq!(flash.read(0x0C), status::SEQUENCE);
    }

    #[test]
    fn flags_are_cleared_by_writing_ones() {
        let mut flash = unlocked();
        flash.program(SLOTS, Width::Word, 0);
        flash.write(0x0C, Store::word(0));
        assert_eq!(flash.read(0x0C), status::SEQUENCE);
        flash.write(0x0C, Store::word(status::SEQUENCE));
        assert_eq!(flash.read(0x0C), 0);
    }

    #[test]
    fn option_bytes_are_programmed_after_both_keys_when_started() {
        let mut flash = Flash::new(NEW_OPTIONS);
        assert_eq!(flash.read(0x14), 0x0FFF_AAED, "as in the reference manual");
        let changed = NEW_OPTIONS & !0b1100;
        flash.write(0x14, Store::word(changed | OPTIONS_START));
        assert_eq!(flash.programmed(), NEW_OPTIONS, "locked");
        for key in OPTION_KEYS {
            flash.write(0x08, Store::word(key));
        }
        flash.write(0x14, Store::word(changed));
        assert_eq!(flash.programmed(), NEW_OPTIONS, "not started");
        flash.write(0x14, Store::word(changed | OPTIONS_START));
        flash.write(0x14, Store::word(changed | OPTIONS_LOCK));
        assert_eq!((flash.programmed(), flash.read(0x14)), (changed, changed | OPTIONS_LOCK));
    }

    #[test]
    fn the_end_of_an_operation_is_flagged_if_its_interrupt_is_enabled() {
        let mut flash = unlocked();
        flash.write(0x10, Store::word(erase(10) | control::END_INTERRUPT));
        assert_eq!(flash.read(0x0C), status::END);
    }
}
