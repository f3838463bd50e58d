//! A journal in a region of flash of its own: small records, appended one after another and kept until the region is full.
//!
//! | from the start of the region | content |
//! |---|---|
//! | 0 | mark of an erase that has ended, padded with 0xFF to [`RECORD_BYTES`] |
//! | then, each [`RECORD_BYTES`] | sequence number, payload, CRC-32 of both, padded with 0xFF |
//!
//! A store writes the first place behind everything that was ever written, so it never changes an older record. A power cut
//! leaves a record with a wrong checksum, which does not count and whose place stays unused. The newest record is the last
//! valid one; the sequence numbers go on after an erase.
//!
//! **When the region is full, the next store erases it and with it all older records**; a power cut between that erase and the
//! end of the store leaves none. The mark tells an erased region from one whose erase was cut off, which may read as erased
//! without being so.

use embedded_storage::nor_flash::{NorFlash, ReadNorFlash};

use super::{ERASED, FlashError, UNIT, erase, is_newer, read, write};
use crate::checksum::{CHECKSUM_BYTES, crc32, verified};

/// Length of a record with its padding, bytes.
pub const RECORD_BYTES: usize = 2 * UNIT;
/// Length of a sequence number, bytes.
const SEQUENCE_BYTES: usize = 4;
/// Mark of an erase that has ended.
const READY: u32 = 0x4A6F_7572;

/// A journal of payloads of `PAYLOAD` bytes.
#[derive(Clone, Debug)]
pub struct Journal<const PAYLOAD: usize> {
    start: u32,
    /// Number of places in the region, with that of the mark.
    places: u32,
    /// First place behind everything that was written; that of the mark while there is none.
    next: u32,
    /// Number of valid records.
    count: u16,
    /// Sequence number of the newest record.
    newest: Option<u32>,
}

impl<const PAYLOAD: usize> Journal<PAYLOAD> {
    const CONTENT: usize = SEQUENCE_BYTES + PAYLOAD + CHECKSUM_BYTES;

    /// The journal in `bytes` bytes from the start of a sector. Reads the whole region.
    pub fn open<F: NorFlash>(flash: &mut F, start: u32, bytes: u32) -> Self {
        const { assert!(Self::CONTENT <= RECORD_BYTES) };
        const { assert!(UNIT.is_multiple_of(F::WRITE_SIZE) && UNIT.is_multiple_of(F::READ_SIZE)) };
        let places = (bytes / RECORD_BYTES as u32).min(u32::from(u16::MAX));
        let mut journal = Self { start, places, next: 0, count: 0, newest: None };
        if journal.is_ready(flash) {
            journal.next = (1..places).rev().find(|place| !journal.is_blank(flash, *place)).unwrap_or(0) + 1;
        }
        for place in 1..places {
            if let Some((sequence, _)) = journal.record(flash, place) {
                journal.note(sequence);
            }
        }
        journal
    }

    /// Number of valid records.
    pub fn count(&self) -> u16 {
        self.count
    }

    fn note(&mut self, sequence: u32) {
        self.count = self.count.saturating_add(1);
        if self.newest.is_none_or(|newest| is_newer(sequence, newest)) {
            self.newest = Some(sequence);
        }
    }

    fn address(&self, place: u32) -> u32 {
        self.start + place * RECORD_BYTES as u32
    }

    fn bytes<F: ReadNorFlash>(&self, flash: &mut F, place: u32) -> Option<[u8; RECORD_BYTES]> {
        let mut bytes = [0; RECORD_BYTES];
        read(flash, self.address(place), &mut bytes).ok()?;
        Some(bytes)
    }

    fn is_ready<F: ReadNorFlash>(&self, flash: &mut F) -> bool {
        self.bytes(flash, 0).is_some_and(|bytes| bytes[..4] == READY.to_le_bytes())
    }

    /// Whether nothing was ever written to a place. A place that cannot be read counts as written.
    fn is_blank<F: ReadNorFlash>(&self, flash: &mut F, place: u32) -> bool {
        self.bytes(flash, place).is_some_and(|bytes| bytes.iter().all(|byte| *byte == ERASED))
    }

    /// Sequence number and payload of a valid record. Not inlined: it would be in the chip's flash once for each caller.
    #[inline(never)]
    fn record<F: ReadNorFlash>(&self, flash: &mut F, place: u32) -> Option<(u32, [u8; PAYLOAD])> {
        let bytes = self.bytes(flash, place)?;
        let (sequence, payload) = verified(&bytes[..Self::CONTENT])?.split_first_chunk()?;
        Some((u32::from_le_bytes(*sequence), payload.try_into().ok()?))
    }

    /// Payload of a record: 0 gives the newest, 1 the one before, and so on. None if there are fewer.
    pub fn get<F: ReadNorFlash>(&self, flash: &mut F, back: u16) -> Option<[u8; PAYLOAD]> {
        // Records are in the order of their numbers, so the newest is the last.
        let places = (1..self.places).rev();
        let records = places.filter_map(|place| self.record(flash, place));
        records.map(|(_, payload)| payload).nth(usize::from(back))
    }

    /// Whether the next store erases the region, which stalls the core of a chip with one bank of flash for seconds.
    pub fn erases_next(&self) -> bool {
        self.next == 0 || self.next >= self.places
    }

    /// Stores a record.
    ///
    /// # Errors
    /// [`FlashError`]; the older records stay as they were, unless the store had to erase them.
    pub fn store<F: NorFlash>(&mut self, flash: &mut F, payload: &[u8; PAYLOAD]) -> Result<(), FlashError> {
        let sequence = self.newest.map_or(0, |newest| newest.wrapping_add(1));
        if self.erases_next() {
            self.erase(flash)?;
        }
        let place = self.next;
        debug_assert!(place > 0 && place < self.places, "neither the mark nor beyond the region");
        // A place whose store fails is not used again.
        self.next += 1;
        write(flash, self.address(place), &Self::encoded(sequence, payload))?;
        self.note(sequence);
        debug_assert!(self.newest == Some(sequence));
        Ok(())
    }

    fn erase<F: NorFlash>(&mut self, flash: &mut F) -> Result<(), FlashError> {
        (self.next, self.count) = (0, 0);
        erase(flash, self.start, self.places * RECORD_BYTES as u32)?;
        write(flash, self.start, &READY.to_le_bytes())?;
        self.next = 1;
        Ok(())
    }

    fn encoded(sequence: u32, payload: &[u8; PAYLOAD]) -> [u8; RECORD_BYTES] {
        let mut bytes = [ERASED; RECORD_BYTES];
        bytes[..SEQUENCE_BYTES].copy_from_slice(&sequence.to_le_bytes());
        bytes[SEQUENCE_BYTES..][..PAYLOAD].copy_from_slice(payload);
        let checksum = crc32(&bytes[..SEQUENCE_BYTES + PAYLOAD]);
        bytes[SEQUENCE_BYTES + PAYLOAD..Self::CONTENT].copy_from_slice(&checksum.to_le_bytes());
        bytes
    }
}

#[cfg(test)]
mod tests;
