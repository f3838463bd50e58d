//! NOR flash for tests.

use std::vec;
use std::vec::Vec;

use embedded_storage::nor_flash::{ErrorType, NorFlash, NorFlashError, NorFlashErrorKind, ReadNorFlash};

use super::ERASED;

/// NOR flash of two sectors of `SECTOR` bytes with words of `W` bytes: an erase sets bits, a write clears them, and a word is
/// written once. After a number of bytes the supply fails in the middle of the running operation.
#[derive(Clone)]
pub struct Nor<const W: usize, const SECTOR: usize> {
    pub cells: Vec<u8>,
    /// Bytes written since their last erase.
    pub written: Vec<bool>,
    /// Bytes that can be erased or written until the supply fails.
    pub supply: usize,
    /// First byte that cannot be read.
    pub unreadable: usize,
    /// Number of erases.
    pub erases: usize,
}

#[derive(Debug)]
pub struct Cut;

impl NorFlashError for Cut {
    fn kind(&self) -> NorFlashErrorKind {
        NorFlashErrorKind::Other
    }
}

impl<const W: usize, const SECTOR: usize> Nor<W, SECTOR> {
    pub fn new() -> Self {
        let (cells, written) = (vec![ERASED; 2 * SECTOR], vec![false; 2 * SECTOR]);
        Self { cells, written, supply: usize::MAX, unreadable: usize::MAX, erases: 0 }
    }

    /// The same content, with a supply that does not fail.
    pub fn powered(&self) -> Self {
        Self { supply: usize::MAX, ..self.clone() }
    }

    fn spend(&mut self) -> Result<(), Cut> {
        self.supply = self.supply.checked_sub(1).ok_or(Cut)?;
        Ok(())
    }
}

impl<const W: usize, const SECTOR: usize> ErrorType for Nor<W, SECTOR> {
    type Error = Cut;
}

impl<const W: usize, const SECTOR: usize> ReadNorFlash for Nor<W, SECTOR> {
    const READ_SIZE: usize = 1;

    fn read(&mut self, offset: u32, bytes: &mut [u8]) -> Result<(), Cut> {
        if offset as usize + bytes.len() > self.unreadable {
            return Err(Cut);
        }
        bytes.copy_from_slice(&self.cells[offset as usize..][..bytes.len()]);
        Ok(())
    }

    fn capacity(&self) -> usize {
        self.cells.len()
    }
}

impl<const W: usize, const SECTOR: usize> NorFlash for Nor<W, SECTOR> {
    const WRITE_SIZE: usize = W;
    const ERASE_SIZE: usize = SECTOR;

    fn erase(&mut self, from: u32, to: u32) -> Result<(), Cut> {
        let range = from as usize..to as usize;
        assert!(range.start.is_multiple_of(SECTOR) && range.end.is_multiple_of(SECTOR));
        self.erases += 1;
        for place in range.clone() {
            // During its erase a sector has any content.
            self.cells[place] ^= 0x5A;
        }
        for place in range {
            self.spend()?;
            (self.cells[place], self.written[place]) = (ERASED, false);
        }
        Ok(())
    }

    fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), Cut> {
        assert!((offset as usize).is_multiple_of(W) && bytes.len().is_multiple_of(W));
        for (place, byte) in (offset as usize..).zip(bytes) {
            self.spend()?;
            assert!(!core::mem::replace(&mut self.written[place], true), "byte {place} written twice");
            self.cells[place] &= byte;
        }
        Ok(())
    }
}
