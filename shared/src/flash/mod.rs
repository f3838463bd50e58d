//! Data in NOR flash that survives a power cut at any word.
//!
//! Data is written in whole [`UNIT`]s, each read back, and every address once after an erase, which suits flash with words of
//! up to that size. A record with a checksum follows the data, and a commit word is written last: until then, what is there
//! does not count.
//!
//! | module | contains |
//! |---|---|
//! | [`crate::weights::slots`] | weights images, stored at once on request |
//! | [`archive`] | copies of memory that changes, written piece by piece |
//! | [`journal`] | small records, appended one after another |

pub mod archive;
pub mod journal;
#[cfg(test)]
pub(crate) mod nor;

use embedded_storage::nor_flash::{NorFlash, ReadNorFlash};
use thiserror::Error;

use crate::checksum::{CHECKSUM_BYTES, crc32, verified};

/// Unit of writing, bytes: the longest word of the supported flash memories.
pub const UNIT: usize = 32;
/// Commit word: everything before it was written and read back.
pub(crate) const COMMITTED: u32 = 0x4B4F_2121;
/// Value of an erased byte.
pub(crate) const ERASED: u8 = 0xFF;

/// Reason why data was not stored.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
pub enum FlashError {
    /// The flash refused an operation.
    #[error("the flash refused to read, erase or write")]
    Operation,
    /// The flash does not contain the data that was written.
    #[error("the flash does not contain the data that was written; the sector may be worn out")]
    Readback,
}

/// Reads any number of bytes, also if it is not a multiple of the flash's word.
pub(crate) fn read<F: ReadNorFlash>(flash: &mut F, start: u32, bytes: &mut [u8]) -> Result<(), FlashError> {
    let mut unit = [0; UNIT];
    for (index, part) in bytes.chunks_mut(UNIT).enumerate() {
        let place = start + (index * UNIT) as u32;
        flash.read(place, &mut unit).map_err(|_| FlashError::Operation)?;
        part.copy_from_slice(&unit[..part.len()]);
    }
    Ok(())
}

/// Writes in whole units, padded with erased bytes, and reads each back.
pub(crate) fn write<F: NorFlash>(flash: &mut F, start: u32, bytes: &[u8]) -> Result<(), FlashError> {
    for (index, part) in bytes.chunks(UNIT).enumerate() {
        let place = start + (index * UNIT) as u32;
        let (mut unit, mut back) = ([ERASED; UNIT], [0; UNIT]);
        unit[..part.len()].copy_from_slice(part);
        flash.write(place, &unit).map_err(|_| FlashError::Operation)?;
        read(flash, place, &mut back)?;
        if unit != back {
            return Err(FlashError::Readback);
        }
    }
    Ok(())
}

/// Erases the sectors that contain `bytes` bytes from the start of a sector.
pub(crate) fn erase<F: NorFlash>(flash: &mut F, start: u32, bytes: u32) -> Result<(), FlashError> {
    let end = start + bytes.next_multiple_of(F::ERASE_SIZE as u32);
    flash.erase(start, end).map_err(|_| FlashError::Operation)
}

/// A record: numbers with their CRC-32, padded to a unit.
pub(crate) fn record<const COUNT: usize>(numbers: [u32; COUNT]) -> [u8; UNIT] {
    const { assert!(4 * COUNT + CHECKSUM_BYTES <= UNIT) };
    let mut unit = [ERASED; UNIT];
    for (place, number) in unit.chunks_exact_mut(4).zip(numbers) {
        place.copy_from_slice(&number.to_le_bytes());
    }
    let checksum = crc32(&unit[..4 * COUNT]);
    unit[4 * COUNT..4 * COUNT + CHECKSUM_BYTES].copy_from_slice(&checksum.to_le_bytes());
    unit
}

/// The numbers of a record, if it was committed and is undamaged.
pub(crate) fn committed<const COUNT: usize>(
    record: &[u8; UNIT],
    commit: &[u8; UNIT],
) -> Option<[u32; COUNT]> {
    const { assert!(4 * COUNT + CHECKSUM_BYTES <= UNIT) };
    if commit[..4] != COMMITTED.to_le_bytes() {
        return None;
    }
    let (words, _) = verified(&record[..4 * COUNT + CHECKSUM_BYTES])?.as_chunks();
    Some(core::array::from_fn(|index| words.get(index).map_or(0, |word| u32::from_le_bytes(*word))))
}

/// Whether a generation is newer than another. Generations wrap: the newer one is ahead by less than half of the range.
pub(crate) fn is_newer(generation: u32, other: u32) -> bool {
    generation.wrapping_sub(other) as i32 > 0
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_record_counts_only_undamaged_and_committed() {
        let (sound, mut commit) = (record([7, u32::MAX]), [ERASED; UNIT]);
        assert_eq!(committed::<2>(&sound, &commit), None, "not committed");
        commit[..4].copy_from_slice(&COMMITTED.to_le_bytes());
        assert_eq!(committed(&sound, &commit), Some([7, u32::MAX]));
        for bit in 0..8 * 12 {
            let mut damaged = sound;
            damaged[bit / 8] ^= 1 << (bit % 8);
            assert_eq!(committed::<2>(&damaged, &commit), None, "bit {bit}");
        }
        for bit in 0..32 {
            let mut damaged = commit;
            damaged[bit / 8] ^= 1 << (bit % 8);
            assert_eq!(committed::<2>(&sound, &damaged), None, "bit {bit} of the commit word");
        }
    }

    #[test]
    fn generations_wrap() {
        for (generation, other, newer) in [
            (1, 0, true),
            (0, 0, false),
            (0, 1, false),
            (0, u32::MAX, true),
            (u32::MAX, 0, false),
            (i32::MAX as u32, 0, true),
        ] {
            assert_eq!(is_newer(generation, other), newer, "{generation} {other}");
        }
    }
}
