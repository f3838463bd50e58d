//! A flash memory whose supply can fail in the middle of a write.

use embedded_storage::nor_flash::{ErrorType, NorFlash, NorFlashErrorKind, ReadNorFlash};
use shared::weights::IMAGE_BYTES;
use shared::weights::slots::Slots;

/// Size of a sector in bytes; each contains one slot.
const SECTOR: usize = 16 * 1024;
/// Value of an erased byte.
const ERASED: u8 = 0xFF;

/// Two sectors of flash.
#[derive(Clone, Debug)]
pub struct Flash {
    cells: Vec<u8>,
    /// Number of bytes that can still be written before the supply fails.
    pub supply: usize,
}

impl Flash {
    /// Erased flash.
    pub fn new() -> Self {
        Self { cells: vec![ERASED; 2 * SECTOR], supply: usize::MAX }
    }

    /// The weight slots in this flash.
    pub fn slots(&mut self) -> Slots<&mut Self> {
        Slots::new(self, [0, SECTOR as u32])
    }

    /// Flips a bit of the image in the first slot.
    pub fn flip(&mut self, bit: usize) {
        let bit = bit % (8 * IMAGE_BYTES);
        self.cells[bit / 8] ^= 1 << (bit % 8);
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
    const ERASE_SIZE: usize = SECTOR;

    fn erase(&mut self, from: u32, to: u32) -> Result<(), NorFlashErrorKind> {
        self.cells[from as usize..to as usize].fill(ERASED);
        Ok(())
    }

    fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), NorFlashErrorKind> {
        for (cell, byte) in self.cells[offset as usize..].iter_mut().zip(bytes) {
            self.supply = self.supply.checked_sub(1).ok_or(NorFlashErrorKind::Other)?;
            *cell &= byte;
        }
        Ok(())
    }
}
