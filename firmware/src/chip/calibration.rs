//! The calibrations in flash: read at the start, stored and read back for the host.

use shared::calibration::stored::StoredCalibrations;
use shared::calibration::{Calibration, SensorCorrection};
use shared::device::control::Control;
use shared::link::refusal::Refusal;

use super::drivers::flash::{self, BoardFlash};
use super::drivers::watchdog;

/// The calibrations, on a board with room for them; the newest one corrects the readings from the first tick on. Called once.
#[inline(never)]
pub fn attach(flash: &mut BoardFlash, control: &mut Control) -> Option<StoredCalibrations> {
    let (start, bytes) = flash::calibrations()?;
    let stored = StoredCalibrations::open(flash, start, bytes);
    let newest = stored.get(flash, 0);
    if let Some(correction) = newest.and_then(|newest| SensorCorrection::new(&newest).ok()) {
        control.calibrate(correction);
    }
    Some(stored)
}

/// Stores a calibration; returns the number of stored ones. Only in standby.
///
/// # Errors
/// [`Refusal::NoCalibrations`] on a board without room for them, [`Refusal::CalibrationStorage`].
pub fn store(
    stored: &mut Option<StoredCalibrations>,
    flash: &mut BoardFlash,
    calibration: &Calibration,
) -> Result<u16, Refusal> {
    let stored = stored.as_mut().ok_or(Refusal::NoCalibrations)?;
    // The core stalls while a sector is erased.
    match watchdog::with_long_timeout(|| stored.store(flash, calibration)) {
        Ok(()) => Ok(stored.count()),
        Err(_) => Err(Refusal::CalibrationStorage),
    }
}

/// The number of stored calibrations, and one of them: 0 for the newest.
pub fn read(
    stored: Option<&StoredCalibrations>,
    flash: &mut BoardFlash,
    back: u16,
) -> (u16, Option<Calibration>) {
    stored.map_or((0, None), |stored| (stored.count(), stored.get(flash, back)))
}
