//! The flash of a simulated device, in memory: one sector, which survives the device's restarts.

use std::convert::Infallible;

use embedded_storage::nor_flash::{ErrorType, NorFlash, ReadNorFlash};

/// Length of the sector, bytes.
pub const SECTOR_BYTES: u32 = 128 * 1024;
/// Value of an erased byte.
const ERASED: u8 = 0xFF;

/// Flash of one sector.
pub struct Flash(Vec<u8>);

impl Flash {
    /// Erased flash.
    pub fn new() -> Self {
        Self(vec![ERASED; SECTOR_BYTES as usize])
    }
}

impl ErrorType for Flash {
    type Error = Infallible;
}

impl ReadNorFlash for Flash {
    const READ_SIZE: usize = 1;

    fn read(&mut self, offset: u32, bytes: &mut [u8]) -> Result<(), Infallible> {
        bytes.copy_from_slice(&self.0[offset as usize..][..bytes.len()]);
        Ok(())
    }

    fn capacity(&self) -> usize {
        self.0.len()
    }
}

impl NorFlash for Flash {
    const WRITE_SIZE: usize = 1;
    const ERASE_SIZE: usize = SECTOR_BYTES as usize;

    fn erase(&mut self, from: u32, to: u32) -> Result<(), Infallible> {
        self.0[from as usize..to as usize].fill(ERASED);
        Ok(())
    }

    /// Clears bits, as flash does.
    fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), Infallible> {
        for (cell, byte) in self.0[offset as usize..].iter_mut().zip(bytes) {
            *cell &= byte;
        }
        Ok(())
    }
}
