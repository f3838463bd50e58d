//! Two slots in flash for weights images, so that a power failure during a store never loses the weights in use.
//!
//! A slot is a region of whole sectors:
//!
//! | from the start of the slot | content |
//! |---|---|
//! | 0 | the image, [`IMAGE_BYTES`], padded with 0xFF |
//! | [`RECORD`] | generation, u32; its CRC-32, u32; padded with 0xFF to one [`UNIT`] |
//! | [`RECORD`] + [`UNIT`] | commit word, u32, padded with 0xFF to one [`UNIT`] |
//!
//! A store erases the slot that is not the newest, writes image and record with read-back, and writes the commit word
//! last. Until then the slot counts as torn and the other one stays the newest.

use embedded_storage::nor_flash::NorFlash;
use heapless::Vec;
use serde::{Deserialize, Serialize};
use thiserror::Error;

use super::trust::Trust;
use super::{IMAGE_BYTES, Image, ImageProblem, VERSION_AT, WeightsError, decode_trusted};
use crate::checksum::verified;
pub use crate::flash::UNIT;
use crate::flash::{self, COMMITTED, ERASED, FlashError};

/// Offset of the record in a slot.
pub const RECORD: u32 = IMAGE_BYTES.next_multiple_of(UNIT) as u32;
/// Offset of the commit word in a slot. Fulfils: weights-commit.
const COMMIT: u32 = RECORD + UNIT as u32;
/// Length of a slot's content, bytes.
pub const SLOT_BYTES: u32 = COMMIT + UNIT as u32;

/// One of the two slots. The order of the variants is part of the link's protocol.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Slot {
    /// The first slot.
    A,
    /// The second slot.
    B,
}

/// Content of a slot. The order of the variants is part of the link's protocol: append only.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum SlotState {
    /// Erased.
    Empty,
    /// A store that was not completed, or an unreadable slot.
    Torn,
    /// A completely stored image that this device refuses.
    Invalid(ImageProblem),
    /// A valid image.
    Valid {
        /// Number of the store; the higher one is newer (wrapping).
        generation: u32,
        /// The image's id.
        id: u32,
    },
}

impl SlotState {
    /// The id of the valid image, if there is one.
    pub fn id(&self) -> Option<u32> {
        match *self {
            Self::Valid { id, .. } => Some(id),
            _ => None,
        }
    }
}

/// Reason why an image was not stored.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
pub enum StoreError {
    /// The flash failed.
    #[error(transparent)]
    Flash(#[from] FlashError),
    /// The device trusts a key, and an image of its own is not older.
    #[error("version {version} is not newer than {stored}, which is stored")]
    NotNewer {
        /// Version of the refused image.
        version: u32,
        /// Highest version stored.
        stored: u32,
    },
}

/// Both slots of a flash memory.
#[derive(Debug)]
pub struct Slots<F> {
    flash: F,
    starts: [u32; 2],
    trust: Trust,
    /// Reason for which the decoder refused the image of a slot.
    refused: [Option<ImageProblem>; 2],
}

impl<F: NorFlash> Slots<F> {
    /// Slots of a development build at these addresses of the flash, each with sectors of its own of at least [`SLOT_BYTES`].
    pub const fn new(flash: F, starts: [u32; 2]) -> Self {
        const { assert!(UNIT.is_multiple_of(F::WRITE_SIZE) && UNIT.is_multiple_of(F::READ_SIZE)) };
        Self { flash, starts, trust: Trust::Development, refused: [None; 2] }
    }

    /// The same with images that this device trusts alone.
    #[must_use]
    pub fn trusting(mut self, trust: Trust) -> Self {
        self.trust = trust;
        self
    }

    /// State of both slots; an unreadable one counts as torn. An image with the right checksum counts as valid unless
    /// [`Slots::load`] has refused it.
    pub fn states(&mut self) -> [SlotState; 2] {
        [Slot::A, Slot::B].map(|slot| self.state(slot).unwrap_or(SlotState::Torn))
    }

    #[inline(never)]
    fn state(&mut self, slot: Slot) -> Result<SlotState, FlashError> {
        let (mut bytes, mut record, mut commit) = ([0; IMAGE_BYTES], [0; UNIT], [0; UNIT]);
        let start = self.starts[slot as usize];
        self.read(start, &mut bytes)?;
        self.read(start + RECORD, &mut record)?;
        self.read(start + COMMIT, &mut commit)?;
        if bytes.iter().chain(&record).chain(&commit).all(|byte| *byte == ERASED) {
            return Ok(SlotState::Empty);
        }
        Ok(match (flash::committed(&record, &commit), identity(&bytes), self.refused[slot as usize]) {
            (None, ..) => SlotState::Torn,
            (Some(_), None, _) => SlotState::Invalid(ImageProblem::Checksum),
            (Some(_), Some(_), Some(problem)) => SlotState::Invalid(problem),
            (Some([generation]), Some(id), None) => SlotState::Valid { generation, id },
        })
    }

    fn read(&mut self, start: u32, bytes: &mut [u8]) -> Result<(), FlashError> {
        flash::read(&mut self.flash, start, bytes)
    }

    /// The flash, for what else is stored in it.
    pub fn flash(&mut self) -> &mut F {
        &mut self.flash
    }

    /// Decodes the newest valid image or, if it is refused, that of the other slot; returns what `take` makes of it.
    pub fn load<T>(&mut self, mut take: impl FnMut(&Image) -> T) -> Option<(Slot, T)> {
        for slot in by_age(&self.states()) {
            match self.decode(slot, &mut take) {
                Ok(taken) => return Some((slot, taken)),
                Err(error) => self.refused[slot as usize] = Some(error.into()),
            }
        }
        None
    }

    /// Decodes the image in a slot; returns what `take` makes of it. Not inlined, so that its buffer is on the stack only meanwhile.
    #[inline(never)]
    fn decode<T>(&mut self, slot: Slot, take: impl FnMut(&Image) -> T) -> Result<T, WeightsError> {
        let mut bytes = [0; IMAGE_BYTES];
        if self.read(self.starts[slot as usize], &mut bytes).is_err() {
            return Err(WeightsError::Checksum);
        }
        decode_trusted(&bytes, &self.trust, take)
    }

    /// Refuses an image that is not newer than the trusted ones, whatever their plant: otherwise images for another plant would
    /// push the newest version out of both slots. A development build accepts any order: without signatures a version says
    /// nothing. Not inlined, so that its images are off the stack during the store.
    ///
    /// # Errors
    /// [`StoreError::NotNewer`].
    #[inline(never)]
    fn is_newer(&mut self, image: &[u8; IMAGE_BYTES]) -> Result<(), StoreError> {
        let Trust::Key { .. } = self.trust else { return Ok(()) };
        let version = u32::from_le_bytes(image[VERSION_AT..].first_chunk().copied().unwrap_or_default());
        let stored = [Slot::A, Slot::B].map(|slot| self.trusted(slot));
        match stored.into_iter().flatten().max() {
            Some(stored) if version <= stored => Err(StoreError::NotNewer { version, stored }),
            _ => Ok(()),
        }
    }

    /// Version of the image in a slot, if it is trusted and its store was completed: an image whose store was cut off may be stored
    /// again.
    #[inline(never)]
    fn trusted(&mut self, slot: Slot) -> Option<u32> {
        let SlotState::Valid { .. } = self.state(slot).ok()? else { return None };
        self.decode(slot, |image| image.version).ok()
    }

    /// Stores an image in the slot that is not the newest; returns the slot and its generation. The image is not decoded
    /// here: validate it first.
    ///
    /// # Errors
    /// [`StoreError`]; the newest slot stays as it was, unless only the read-back of the commit word failed. After
    /// [`StoreError::NotNewer`] both do.
    pub fn store(&mut self, image: &[u8; IMAGE_BYTES]) -> Result<(Slot, u32), StoreError> {
        self.is_newer(image)?;
        // A slot that cannot be read may contain the weights in use, so it must not be erased.
        let states = [self.state(Slot::A)?, self.state(Slot::B)?];
        let newest = by_age(&states).first().copied();
        let (slot, generation) = match newest.map(|slot| (slot, states[slot as usize])) {
            Some((Slot::A, SlotState::Valid { generation, .. })) => (Slot::B, generation.wrapping_add(1)),
            Some((Slot::B, SlotState::Valid { generation, .. })) => (Slot::A, generation.wrapping_add(1)),
            _ => (Slot::A, 0),
        };
        debug_assert!(newest != Some(slot), "the newest image stays");
        debug_assert!(newest.is_none() || matches!(states[1 - slot as usize], SlotState::Valid { .. }));
        let start = self.starts[slot as usize];
        flash::erase(&mut self.flash, start, SLOT_BYTES)?;
        self.refused[slot as usize] = None;
        self.write(start, image)?;
        self.write(start + RECORD, &flash::record([generation]))?;
        self.write(start + COMMIT, &COMMITTED.to_le_bytes())?;
        Ok((slot, generation))
    }

    fn write(&mut self, start: u32, bytes: &[u8]) -> Result<(), FlashError> {
        flash::write(&mut self.flash, start, bytes)
    }
}

/// Content of both slots after the first store: what a programmer writes to a chip together with its program.
pub fn after_first_store(image: &[u8; IMAGE_BYTES]) -> [[u8; SLOT_BYTES as usize]; 2] {
    let mut slot = [ERASED; SLOT_BYTES as usize];
    slot[..IMAGE_BYTES].copy_from_slice(image);
    slot[RECORD as usize..][..UNIT].copy_from_slice(&flash::record([0]));
    slot[COMMIT as usize..][..4].copy_from_slice(&COMMITTED.to_le_bytes());
    [slot, [ERASED; SLOT_BYTES as usize]]
}

/// Id of an image with the right checksum: the checksum itself.
fn identity(image: &[u8; IMAGE_BYTES]) -> Option<u32> {
    verified(image)?;
    Some(u32::from_le_bytes(*image.last_chunk()?))
}

/// The valid slots, the newest first.
fn by_age(states: &[SlotState; 2]) -> Vec<Slot, 2> {
    let generation = |slot: Slot| match states[slot as usize] {
        SlotState::Valid { generation, .. } => Some(generation),
        _ => None,
    };
    let order = match (generation(Slot::A), generation(Slot::B)) {
        (Some(a), Some(b)) if flash::is_newer(b, a) => [Some(Slot::B), Some(Slot::A)],
        (a, b) => [a.map(|_| Slot::A), b.map(|_| Slot::B)],
    };
    order.into_iter().flatten().collect()
}

#[cfg(test)]
mod tests;
