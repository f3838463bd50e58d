//! What the flash keeps for the host: weights and calibrations.

use shared::calibration::stored::StoredCalibrations;
use shared::calibration::{Calibration, SensorCorrection};
use shared::device::control::Control;
use shared::device::server::Store;
use shared::link::refusal::Refusal;
use shared::weights::IMAGE_BYTES;
use shared::weights::slots::{Slot, SlotState, Slots, StoreError};

use super::drivers::flash::{self, BoardFlash};
use super::drivers::watchdog;

/// The weight slots, and the calibrations on a board with room for them.
pub struct Storage {
    slots: Slots<BoardFlash>,
    calibrations: Option<StoredCalibrations>,
}

impl Storage {
    /// Opens the calibrations; the newest one corrects the readings from the first tick on. Called once.
    #[inline(never)]
    pub fn attach(mut slots: Slots<BoardFlash>, control: &mut Control) -> Self {
        let place = flash::calibrations();
        let calibrations = place.map(|(start, bytes)| StoredCalibrations::open(slots.flash(), start, bytes));
        let newest = calibrations.as_ref().and_then(|stored| stored.get(slots.flash(), 0));
        if let Some(correction) = newest.and_then(|newest| SensorCorrection::new(&newest).ok()) {
            control.calibrate(correction);
        }
        Self { slots, calibrations }
    }

    /// The flash, for what else is stored in it.
    pub fn flash(&mut self) -> &mut BoardFlash {
        self.slots.flash()
    }
}

/// Stores with the long timeout of the watchdog: the core stalls while a sector is erased.
impl Store for Storage {
    fn store_weights(&mut self, image: &[u8; IMAGE_BYTES]) -> (Result<Slot, StoreError>, [SlotState; 2]) {
        let stored = watchdog::with_long_timeout(|| self.slots.store(image));
        (stored.map(|(slot, _)| slot), self.slots.states())
    }

    /// Refuses with [`Refusal::NoCalibrations`] on a board without room for them.
    fn store_calibration(&mut self, calibration: &Calibration) -> Result<u16, Refusal> {
        let stored = self.calibrations.as_mut().ok_or(Refusal::NoCalibrations)?;
        match watchdog::with_long_timeout(|| stored.store(self.slots.flash(), calibration)) {
            Ok(()) => Ok(stored.count()),
            Err(_) => Err(Refusal::CalibrationStorage),
        }
    }

    #[cfg(feature = "desk")]
    fn set_bench(&mut self, description: &[u8]) -> Result<(), Refusal> {
        super::drivers::desk::describe(description)
    }

    fn calibration(&mut self, back: u16) -> (u16, Option<Calibration>) {
        let Self { slots, calibrations } = self;
        calibrations.as_ref().map_or((0, None), |stored| (stored.count(), stored.get(slots.flash(), back)))
    }
}
