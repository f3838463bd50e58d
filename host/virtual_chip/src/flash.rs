//! The flash of a simulated device, in memory: weight slots and calibrations, which survive the device's restarts. Its
//! supply can fail in the middle of a write.

use embedded_storage::nor_flash::{ErrorType, NorFlash, NorFlashErrorKind, ReadNorFlash};
use shared::calibration::Calibration;
use shared::calibration::stored::StoredCalibrations;
use shared::device::server::Store;
use shared::link::refusal::Refusal;
use shared::weights::IMAGE_BYTES;
use shared::weights::slots::{Slot, SlotState, Slots, StoreError};

/// Length of a sector, bytes. Each weight slot has one.
const SECTOR: u32 = 16 * 1024;
/// Start and length of the calibrations, bytes.
const CALIBRATIONS: (u32, u32) = (2 * SECTOR, 8 * SECTOR);
/// Value of an erased byte.
const ERASED: u8 = 0xFF;

/// Flash memory of a device.
#[derive(Clone, Debug)]
pub struct Flash {
    cells: Vec<u8>,
    /// Number of bytes that can still be written before the supply fails.
    pub supply: usize,
}

impl Default for Flash {
    /// Erased flash.
    fn default() -> Self {
        let (start, bytes) = CALIBRATIONS;
        Self { cells: vec![ERASED; (start + bytes) as usize], supply: usize::MAX }
    }
}

impl Flash {
    /// The weight slots in this flash.
    pub fn slots(&mut self) -> Slots<&mut Self> {
        Slots::new(self, [0, SECTOR])
    }

    /// The calibrations in this flash.
    fn calibrations(&mut self) -> StoredCalibrations {
        let (start, bytes) = CALIBRATIONS;
        StoredCalibrations::open(self, start, bytes)
    }

    /// Flips a bit of the image in the first slot.
    pub fn flip(&mut self, bit: usize) {
        let bit = bit % (8 * IMAGE_BYTES);
        self.cells[bit / 8] ^= 1 << (bit % 8);
    }
}

impl Store for Flash {
    fn store_weights(&mut self, image: &[u8; IMAGE_BYTES]) -> (Result<Slot, StoreError>, [SlotState; 2]) {
        let mut slots = self.slots();
        let stored = slots.store(image);
        (stored.map(|(slot, _)| slot), slots.states())
    }

    fn store_calibration(&mut self, calibration: &Calibration) -> Result<u16, Refusal> {
        let mut stored = self.calibrations();
        stored.store(self, calibration).map_err(|_| Refusal::CalibrationStorage)?;
        Ok(stored.count())
    }

    fn calibration(&mut self, back: u16) -> (u16, Option<Calibration>) {
        let stored = self.calibrations();
        (stored.count(), stored.get(self, back))
    }
}

impl ErrorType for Flash {
    type Error = NorFlashErrorKind;
}

impl ReadNorFlash for Flash {
    const READ_SIZE: usize = 1;

    fn read(&mut self, offset: u32, bytes: &mut [u8]) -> Result<(), NorFlashErrorKind> {
        bytes.copy_from_slice(&self.cells[offset as usize..][..bytes.len()]);
        Ok(())
    }

    fn capacity(&self) -> usize {
        self.cells.len()
    }
}

impl NorFlash for Flash {
    const WRITE_SIZE: usize = 4;
    const ERASE_SIZE: usize = SECTOR as usize;

    fn erase(&mut self, from: u32, to: u32) -> Result<(), NorFlashErrorKind> {
        self.cells[from as usize..to as usize].fill(ERASED);
        Ok(())
    }

    /// Clears bits, as flash does.
    fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), NorFlashErrorKind> {
        for (cell, byte) in self.cells[offset as usize..].iter_mut().zip(bytes) {
            self.supply = self.supply.checked_sub(1).ok_or(NorFlashErrorKind::Other)?;
            *cell &= byte;
        }
        Ok(())
    }
}
