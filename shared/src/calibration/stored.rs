//! The calibrations of a device: a journal in its flash, the newest of which is in force.

use embedded_storage::nor_flash::{NorFlash, ReadNorFlash};

use super::{CALIBRATION_BYTES, Calibration};
use crate::flash::FlashError;
use crate::flash::journal::Journal;

/// The calibrations in a device's flash.
#[derive(Clone, Debug)]
pub struct StoredCalibrations(Journal<CALIBRATION_BYTES>);

impl StoredCalibrations {
    /// The calibrations in `bytes` bytes of the flash from the start of a sector of their own.
    pub fn open<F: NorFlash>(flash: &mut F, start: u32, bytes: u32) -> Self {
        Self(Journal::open(flash, start, bytes))
    }

    /// Number of stored calibrations.
    pub fn count(&self) -> u16 {
        self.0.count()
    }

    /// A stored calibration: 0 gives the newest, 1 the one before, and so on. None if there are fewer, or if this version refuses
    /// it: then its neighbours do not move up, and a refused newest one leaves the readings uncorrected.
    pub fn get<F: ReadNorFlash>(&self, flash: &mut F, back: u16) -> Option<Calibration> {
        let calibration = Calibration::from_bytes(&self.0.get(flash, back)?);
        calibration.validate().is_ok().then_some(calibration)
    }

    /// Stores a calibration. Only in standby: the first store and one in a full journal erase the sector, which stalls the
    /// core of a chip for seconds.
    ///
    /// # Errors
    /// [`FlashError`]; the calibrations before stay, unless the sector had to be erased.
    pub fn store<F: NorFlash>(&mut self, flash: &mut F, calibration: &Calibration) -> Result<(), FlashError> {
        self.0.store(flash, &calibration.to_bytes())
    }
}
