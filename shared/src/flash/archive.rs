//! Copies of memory that changes, in two slots of flash: written piece by piece while a device runs, and never in place of the
//! newest one.
//!
//! A slot is a region of whole sectors:
//!
//! | from the start of the slot | content |
//! |---|---|
//! | 0 | the words, little endian, padded with 0xFF to whole [`UNIT`]s |
//! | then one [`UNIT`] | generation, CRC-32 of the words, CRC-32 of both |
//! | then one [`UNIT`] | commit word |
//! | then one [`UNIT`] | mark of an erase that has ended |
//!
//! A copy is made in this order: erase the slot that is not the newest, unless it is erased; write the words; read them back
//! and write the record; write the commit word. Until then the other slot stays the newest. The mark tells an erased slot
//! from one whose erase was cut off, which may read as erased without being so.
//!
//! The words are read in order, while another task may change them: a source whose words belong together puts at its end what
//! tells which of them changed meanwhile.

use embedded_storage::nor_flash::{NorFlash, ReadNorFlash};

use super::{COMMITTED, ERASED, FlashError, UNIT, committed, erase, is_newer, read, record, write};
use crate::checksum::CRC_32;

/// Units written in a step: 1 KiB, which takes the flash of an STM32F4 4 ms, at most 26 ms.
pub const STEP_UNITS: usize = 32;
/// Words in a unit.
const UNIT_WORDS: usize = UNIT / 4;
/// Mark of an erase that has ended.
const READY: u32 = 0x4572_6173;

/// Two slots for copies of `WORDS` words.
#[derive(Debug)]
pub struct Archive<const WORDS: usize> {
    starts: [u32; 2],
    /// Place and generation of the newest copy.
    newest: Option<(usize, u32)>,
    /// Whether the other slot is erased.
    erased: bool,
    /// Units of the running copy that are written.
    written: Option<usize>,
}

impl<const WORDS: usize> Archive<WORDS> {
    const UNITS: usize = WORDS.div_ceil(UNIT_WORDS);
    const RECORD: u32 = (Self::UNITS * UNIT) as u32;
    const COMMIT: u32 = Self::RECORD + UNIT as u32;
    const MARK: u32 = Self::COMMIT + UNIT as u32;
    /// Length of a slot's content, bytes.
    pub const BYTES: u32 = Self::MARK + UNIT as u32;

    /// Slots at these addresses of the flash, each with sectors of its own of at least [`Self::BYTES`].
    pub fn open<F: NorFlash>(flash: &mut F, starts: [u32; 2]) -> Self {
        const { assert!(UNIT.is_multiple_of(F::WRITE_SIZE) && UNIT.is_multiple_of(F::READ_SIZE)) };
        let newest = match starts.map(|start| Self::generation(flash, start)) {
            [Some(first), Some(second)] if is_newer(second, first) => Some((1, second)),
            [Some(first), _] => Some((0, first)),
            [None, second] => second.map(|generation| (1, generation)),
        };
        let mut archive = Self { starts, newest, erased: false, written: None };
        let (place, _) = archive.next();
        archive.erased = Self::is_blank(flash, starts[place]);
        archive
    }

    /// Generation of a complete, undamaged copy.
    fn generation<F: ReadNorFlash>(flash: &mut F, start: u32) -> Option<u32> {
        let (mut record, mut commit) = ([0; UNIT], [0; UNIT]);
        read(flash, start + Self::RECORD, &mut record).ok()?;
        read(flash, start + Self::COMMIT, &mut commit).ok()?;
        let [generation, checksum] = committed(&record, &commit)?;
        (Self::checksum(flash, start).ok()? == checksum).then_some(generation)
    }

    /// CRC-32 of the words in a slot.
    fn checksum<F: ReadNorFlash>(flash: &mut F, start: u32) -> Result<u32, FlashError> {
        let (mut digest, mut unit, mut left) = (CRC_32.digest(), [0; UNIT], 4 * WORDS);
        for index in 0..Self::UNITS {
            read(flash, start + (index * UNIT) as u32, &mut unit)?;
            digest.update(&unit[..left.min(UNIT)]);
            left = left.saturating_sub(UNIT);
        }
        Ok(digest.finalize())
    }

    /// Whether a slot was erased to the end and nothing was written since.
    fn is_blank<F: ReadNorFlash>(flash: &mut F, start: u32) -> bool {
        let mut unit = [0; UNIT];
        let is_erased = (0..Self::MARK).step_by(UNIT).all(|offset| {
            read(flash, start + offset, &mut unit).is_ok() && unit.iter().all(|byte| *byte == ERASED)
        });
        is_erased && read(flash, start + Self::MARK, &mut unit).is_ok() && unit[..4] == READY.to_le_bytes()
    }

    /// Place and generation of the next copy.
    fn next(&self) -> (usize, u32) {
        self.newest.map_or((0, 0), |(place, generation)| (1 - place % 2, generation.wrapping_add(1)))
    }

    /// A word of the newest copy.
    pub fn word<F: ReadNorFlash>(&self, flash: &mut F, index: usize) -> Option<u32> {
        let (place, _) = self.newest.filter(|_| index < WORDS)?;
        let (start, mut unit) = (self.starts[place % 2], [0; UNIT]);
        read(flash, start + (index / UNIT_WORDS * UNIT) as u32, &mut unit).ok()?;
        unit.as_chunks().0.get(index % UNIT_WORDS).map(|word| u32::from_le_bytes(*word))
    }

    /// Whether the slot of the next copy is erased.
    pub fn is_erased(&self) -> bool {
        self.erased
    }

    /// Erases the slot of the next copy, which stalls the core of a chip with one bank of flash for seconds.
    ///
    /// # Errors
    /// [`FlashError`]; the newest copy stays as it was.
    pub fn erase<F: NorFlash>(&mut self, flash: &mut F) -> Result<(), FlashError> {
        let (place, _) = self.next();
        let start = self.starts[place % 2];
        (self.erased, self.written) = (false, None);
        erase(flash, start, Self::BYTES)?;
        write(flash, start + Self::MARK, &READY.to_le_bytes())?;
        self.erased = true;
        Ok(())
    }

    /// Begins a copy; its slot must be erased.
    pub fn begin(&mut self) {
        self.written = self.erased.then_some(0);
    }

    /// Whether a copy has begun and is not complete.
    pub fn is_running(&self) -> bool {
        self.written.is_some()
    }

    /// Gives up a running copy.
    pub fn abandon(&mut self) {
        self.written = None;
    }

    /// Writes the next piece of the running copy, whose words `source` gives by their index; returns whether it is complete.
    ///
    /// # Errors
    /// [`FlashError`]; the copy has ended, and the newest one stays as it was, unless only the read-back of the commit word failed.
    pub fn step<F: NorFlash>(
        &mut self,
        flash: &mut F,
        source: impl Fn(usize) -> u32,
    ) -> Result<bool, FlashError> {
        let Some(written) = self.written.take() else { return Ok(false) };
        self.erased = false;
        let (place, generation) = self.next();
        debug_assert!(written <= Self::UNITS);
        debug_assert!(self.newest.is_none_or(|(newest, _)| newest != place), "the newest copy stays");
        let start = self.starts[place % 2];
        if written < Self::UNITS {
            let end = (written + STEP_UNITS).min(Self::UNITS);
            for unit in written..end {
                write(flash, start + (unit * UNIT) as u32, &Self::unit(unit, &source))?;
            }
            self.written = Some(end);
            return Ok(false);
        }
        let checksum = Self::checksum(flash, start)?;
        write(flash, start + Self::RECORD, &record([generation, checksum]))?;
        write(flash, start + Self::COMMIT, &COMMITTED.to_le_bytes())?;
        self.newest = Some((place, generation));
        Ok(true)
    }

    fn unit(unit: usize, source: &impl Fn(usize) -> u32) -> [u8; UNIT] {
        let mut bytes = [ERASED; UNIT];
        for (index, word) in (unit * UNIT_WORDS..WORDS).zip(bytes.chunks_exact_mut(4)) {
            word.copy_from_slice(&source(index).to_le_bytes());
        }
        bytes
    }
}

#[cfg(test)]
mod tests;
