//! Reset and clock control (RM0090, section 7): oscillators are ready as soon as they are on, and the reset flags report
//! the cause of the start.
//!
//! No access is passed on to QEMU's own model: that only returns written values, and resetting a serial port through it
//! crashes QEMU 10.0.2.

use crate::store::Store;

/// Length of the registers, bytes.
pub const BYTES: u32 = 0x94;

/// Offset of `RCC_BDCR`, which belongs to the backup domain.
pub const BACKUP_CONTROL: u32 = 0x70;

const CR: usize = 0;
const CFGR: usize = 0x08 / 4;
const AHB1ENR: usize = 0x30 / 4;
const CSR: usize = 0x74 / 4;

/// HSION, HSEON, PLLON, PLLI2SON; the bit above each is its ready bit.
const CR_ON: u32 = 1 | 1 << 16 | 1 << 24 | 1 << 26;
const CR_CRYSTAL_ON: u32 = 1 << 16;
const CR_CRYSTAL_READY: u32 = 1 << 17;
/// CSSON: the clock security system.
const CR_SECURITY: u32 = 1 << 19;
const CR_PLL: u32 = 0b11 << 24;
const CR_PLL_READY: u32 = 1 << 25;
const PLLCFGR: usize = 1;
const PLL_FROM_CRYSTAL: u32 = 1 << 22;
/// BKPSRAMEN: the clock of the backup memory.
const BACKUP_MEMORY_ON: u32 = 1 << 18;
/// LSION in CSR; the bit above is its ready bit.
const LOW_SPEED_ON: u32 = 1;
const CSR_FLAGS: u32 = 0xFE00_0000;
const CSR_REMOVE_FLAGS: u32 = 1 << 24;

/// Cause of the chip's start. Every cause pulls the reset pin, so each also sets the pin's flag.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ResetCause {
    /// The supply was switched on: PORRSTF, BORRSTF.
    PowerOn,
    /// The program requested it: SFTRSTF.
    Software,
    /// The independent watchdog was not fed: IWDGRSTF.
    Watchdog,
}

impl ResetCause {
    /// Flags that this cause sets in `RCC_CSR`.
    pub const fn flags(self) -> u32 {
        const PIN: u32 = 1 << 26;
        match self {
            Self::PowerOn => PIN | 1 << 27 | 1 << 25,
            Self::Software => PIN | 1 << 28,
            Self::Watchdog => PIN | 1 << 29,
        }
    }
}

/// The registers.
#[derive(Clone, Debug)]
pub struct Rcc {
    registers: [u32; BYTES as usize / 4],
}

impl Rcc {
    /// The registers after a reset, with the flags of this start and those of earlier starts that were not cleared.
    pub const fn new(flags: u32) -> Self {
        let mut registers = [0; BYTES as usize / 4];
        registers[CR] = 0x83;
        registers[1] = 0x2400_3010;
        registers[CSR] = flags & CSR_FLAGS;
        Self { registers }
    }

    /// Whether the backup memory has a clock.
    pub fn drives_backup_memory(&self) -> bool {
        self.registers[AHB1ENR] & BACKUP_MEMORY_ON != 0
    }

    /// The current reset flags.
    pub fn flags(&self) -> u32 {
        self.registers[CSR] & CSR_FLAGS
    }

    /// The word at an offset; zero where there is no register.
    pub fn read(&self, offset: u32) -> u32 {
        self.registers.get(offset as usize / 4).copied().unwrap_or(0)
    }

    /// The crystal stops. If the clock security system is on, the chip switches to its internal oscillator, without the PLL, and true
    /// is returned: the core gets the non-maskable interrupt.
    pub fn stop_crystal(&mut self) -> bool {
        let watched = CR_SECURITY | CR_CRYSTAL_READY;
        if self.registers[CR] & watched != watched {
            return false;
        }
        self.registers[CR] &= !(CR_SECURITY | CR_CRYSTAL_ON | CR_CRYSTAL_READY);
        if self.registers[PLLCFGR] & PLL_FROM_CRYSTAL != 0 {
            self.registers[CR] &= !CR_PLL;
        }
        self.registers[CFGR] &= !0b1111;
        true
    }

    /// Stores to an offset; `crystal` if the board has a sound one.
    pub fn write(&mut self, offset: u32, store: Store, crystal: bool) {
        let index = offset as usize / 4;
        let pll_from_crystal = self.registers[PLLCFGR] & PLL_FROM_CRYSTAL != 0;
        let Some(register) = self.registers.get_mut(index) else { return };
        let value = store.over(*register);
        *register = match index {
            CR => {
                let mut value = ready(value, CR_ON);
                if !crystal {
                    value &= !CR_CRYSTAL_READY;
                }
                if pll_from_crystal && value & CR_CRYSTAL_READY == 0 {
                    value &= !CR_PLL_READY;
                }
                value
            }
            CFGR => value & !0b1100 | (value & 0b11) << 2,
            CSR => {
                let flags = if store.bits() & CSR_REMOVE_FLAGS == 0 { *register & CSR_FLAGS } else { 0 };
                ready(value & 0x00FF_FFFF, LOW_SPEED_ON) | flags
            }
            _ => value,
        }
    }
}

/// Copies each of the `on` bits to the bit above it.
fn ready(value: u32, on: u32) -> u32 {
    value & !(on << 1) | (value & on) << 1
}

#[cfg(test)]
mod tests {
    use super::*;

    fn written(offset: u32, value: u32) -> u32 {
        let mut rcc = Rcc::new(ResetCause::PowerOn.flags());
        rcc.write(offset, Store::word(value), true);
        rcc.read(offset)
    }

    #[test]
    fn an_oscillator_is_ready_while_it_is_on() {
        for bit in [0, 16, 24, 26] {
            assert_eq!(written(0x00, 1 << bit), 0b11 << bit, "bit {bit}");
            assert_eq!(written(0x00, 0b10 << bit), 0, "bit {bit}");
        }
        assert_eq!(written(0x74, 1) & 0b11, 0b11);
    }

    #[test]
    fn without_a_crystal_neither_it_nor_a_pll_from_it_is_ready() {
        let mut rcc = Rcc::new(0);
        rcc.write(0x00, Store::word(CR_CRYSTAL_ON | 1 << 24), false);
        assert_eq!(rcc.read(0x00) & (CR_CRYSTAL_READY | CR_PLL_READY), CR_PLL_READY, "from the internal one");
        rcc.write(0x04, Store::word(PLL_FROM_CRYSTAL), false);
        rcc.write(0x00, Store::word(CR_CRYSTAL_ON | 1 << 24), false);
        assert_eq!(rcc.read(0x00) & (CR_CRYSTAL_READY | CR_PLL_READY), 0);
    }

    #[test]
    fn a_crystal_that_stops_takes_the_pll_along_and_is_noticed_once_if_it_is_watched() {
        let mut rcc = Rcc::new(0);
        let on = CR_CRYSTAL_ON | 1 << 24;
        rcc.write(0x04, Store::word(PLL_FROM_CRYSTAL), true);
        rcc.write(0x00, Store::word(on), true);
        rcc.write(0x08, Store::word(0b10), true);
        assert!(!rcc.stop_crystal(), "not watched");
        rcc.write(0x00, Store::word(on | CR_SECURITY), true);
        assert!(rcc.stop_crystal() && !rcc.stop_crystal());
        assert_eq!((rcc.read(0x00) & (CR_CRYSTAL_READY | CR_PLL), rcc.read(0x08) & 0b1111), (0, 0));
    }

    #[test]
    fn the_clock_asked_for_is_the_clock_used() {
        assert_eq!(written(0x08, 0b10) & 0b1111, 0b1010);
        assert_eq!(written(0x08, 0b1100) & 0b1111, 0, "the answer cannot be written");
    }

    #[test]
    fn the_reset_flags_stay_until_they_are_removed() {
        let mut rcc = Rcc::new(ResetCause::Watchdog.flags());
        rcc.write(0x74, Store::word(0xFE00_0001), true);
        assert_eq!(rcc.flags(), 1 << 29 | 1 << 26, "a program cannot set or clear them one by one");
        rcc.write(0x74, Store::word(1 << 24), true);
        assert_eq!(rcc.read(0x74), 0);
    }

    #[test]
    fn power_on_reads_as_in_the_reference_manual() {
        assert_eq!(Rcc::new(ResetCause::PowerOn.flags()).read(0x74), 0x0E00_0000);
    }

    #[test]
    fn where_there_is_no_register_nothing_is_stored() {
        assert_eq!(written(BYTES, 5), 0);
    }
}
