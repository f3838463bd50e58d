//! Power control (RM0090, section 5): regulators are ready as soon as they are enabled.

use crate::store::Store;

/// PVDE enables the voltage detector; PVDO reports that the voltage is low.
const DETECTOR_ON: u32 = 1 << 4;
/// DBP opens the backup domain.
const BACKUP_OPEN: u32 = 1 << 8;
const DETECTED: u32 = 1 << 2;
const VOLTAGE_READY: u32 = 1 << 14;
/// BRE enables the backup regulator; BRR reports that it is ready.
const BACKUP_ON: u32 = 1 << 9;
const BACKUP_READY: u32 = 1 << 3;

/// The registers.
#[derive(Clone, Debug)]
pub struct Pwr {
    control: u32,
    status: u32,
}

impl Pwr {
    /// The registers after a reset.
    pub(crate) const fn new() -> Self {
        Self { control: 0x4000, status: VOLTAGE_READY }
    }

    /// Whether the voltage detector is on.
    pub fn detects(&self) -> bool {
        self.control & DETECTOR_ON != 0
    }

    /// Whether the program may write to the backup domain.
    pub fn opens_backup(&self) -> bool {
        self.control & BACKUP_OPEN != 0
    }

    /// Whether the regulator of the backup memory is on.
    pub fn regulates_backup(&self) -> bool {
        self.status & BACKUP_ON != 0
    }

    /// The word at an offset; zero where there is no register. The supply voltage is `low` or sound.
    pub fn read(&self, offset: u32, low: bool) -> u32 {
        match offset {
            0 => self.control,
            4 if low && self.detects() => self.status | DETECTED,
            4 => self.status,
            _ => 0,
        }
    }

    /// Stores to an offset.
    pub fn write(&mut self, offset: u32, store: Store) {
        match offset {
            0 => self.control = store.over(self.control),
            4 if self.opens_backup() => {
                let backup = store.over(self.status) & BACKUP_ON;
                let ready = if backup == 0 { 0 } else { BACKUP_READY };
                self.status = VOLTAGE_READY | backup | ready;
            }
            _ => {}
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_voltage_asked_for_is_there() {
        let mut pwr = Pwr::new();
        pwr.write(0, Store::word(0xC000));
        assert_eq!(pwr.read(0, false), 0xC000);
        assert_ne!(pwr.read(4, false) & VOLTAGE_READY, 0);
    }

    #[test]
    fn a_low_voltage_is_detected_while_the_detector_is_on() {
        let mut pwr = Pwr::new();
        assert_eq!(pwr.read(4, true) & DETECTED, 0);
        pwr.write(0, Store::word(DETECTOR_ON));
        assert_eq!((pwr.read(4, true) & DETECTED, pwr.read(4, false) & DETECTED), (DETECTED, 0));
    }

    #[test]
    fn the_backup_regulator_is_ready_while_it_is_on() {
        let mut pwr = Pwr::new();
        pwr.write(4, Store::word(BACKUP_ON));
        assert!(!pwr.regulates_backup(), "the backup domain is closed");
        pwr.write(0, Store::word(BACKUP_OPEN));
        pwr.write(4, Store::word(BACKUP_ON));
        assert!(pwr.opens_backup() && pwr.regulates_backup());
        assert_ne!(pwr.read(4, false) & BACKUP_READY, 0);
        pwr.write(4, Store::word(BACKUP_READY));
        assert_eq!(pwr.read(4, false) & BACKUP_READY, 0);
    }
}
