//! Signatures of weights images: whom a device trusts. Fulfils: weights-trust.
//!
//! A firmware is built with a public key or without one. With a key it runs only images that carry a valid ed25519 signature of
//! that key over header (with plant id and image version) and parameters, and stores none whose version is not newer than those of
//! its own trusted images. With the plant's id as well, it runs only images for that plant. Without a key it is a development
//! build, which accepts every valid image and says so in its greeting.

use ed25519_compact::{PublicKey, Signature};
use serde::{Deserialize, Serialize};

use super::{IMAGE_BYTES, PLANT_AT, PLANT_BYTES, SIGNATURE_BYTES, SIGNED_BYTES, VERSION_AT, WeightsError};
use crate::checksum::{CHECKSUM_BYTES, crc32};

/// Length of a public key, bytes.
pub const KEY_BYTES: usize = 32;

/// The first bytes of a public key, by which people tell keys apart.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct KeyId(pub [u8; 8]);

/// Whose images a device runs.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Trust {
    /// Every valid image: a development build.
    #[default]
    Development,
    /// Only images that the owner of a public key has signed.
    Key {
        /// The public key.
        key: [u8; KEY_BYTES],
        /// Plant for which the images must be; any plant if none.
        plant: Option<[u8; PLANT_BYTES]>,
    },
}

impl Trust {
    /// Id of the key; none for a development build.
    pub fn key(&self) -> Option<KeyId> {
        match self {
            Self::Development => None,
            Self::Key { key, .. } => key.first_chunk().map(|id| KeyId(*id)),
        }
    }

    /// Verifies the signature and the plant of an image; bytes after it are ignored. Takes as long as many control ticks: only in
    /// standby and at the start.
    ///
    /// # Errors
    /// [`WeightsError::Length`], [`WeightsError::Unsigned`], [`WeightsError::Signature`], [`WeightsError::Plant`].
    pub fn verify(&self, image: &[u8]) -> Result<(), WeightsError> {
        let Self::Key { key, plant } = self else { return Ok(()) };
        let have = image.len();
        let image = image.get(..IMAGE_BYTES).ok_or(WeightsError::Length { have, need: IMAGE_BYTES })?;
        let (signed, rest) = image.split_at(SIGNED_BYTES);
        let signature = rest.first_chunk().filter(|_| is_signed(image)).ok_or(WeightsError::Unsigned)?;
        if !is_by(key, signed, signature) {
            return Err(WeightsError::Signature);
        }
        if plant.is_some_and(|plant| !signed[PLANT_AT..].starts_with(&plant)) {
            return Err(WeightsError::Plant);
        }
        Ok(())
    }
}

/// Whether the owner of a key has signed this. Not inlined: its variables take kilobytes of the stack, which its callers must not
/// keep while they decode an image.
#[inline(never)]
fn is_by(key: &[u8; KEY_BYTES], signed: &[u8], signature: &[u8; SIGNATURE_BYTES]) -> bool {
    PublicKey::new(*key).verify(signed, &Signature::new(*signature)).is_ok()
}

/// Whether an image carries a signature, valid or not.
pub fn is_signed(image: &[u8]) -> bool {
    let signature = image.get(SIGNED_BYTES..SIGNED_BYTES + SIGNATURE_BYTES);
    signature.is_some_and(|signature| signature.iter().any(|byte| *byte != 0))
}

/// Signs an image: gives it a version, the signature that `sign` makes of the signed bytes, and a new checksum.
pub fn seal(image: &mut [u8; IMAGE_BYTES], version: u32, sign: impl FnOnce(&[u8]) -> [u8; SIGNATURE_BYTES]) {
    image[VERSION_AT..VERSION_AT + 4].copy_from_slice(&version.to_le_bytes());
    let signature = sign(&image[..SIGNED_BYTES]);
    image[SIGNED_BYTES..SIGNED_BYTES + SIGNATURE_BYTES].copy_from_slice(&signature);
    let checksum = crc32(&image[..IMAGE_BYTES - CHECKSUM_BYTES]);
    image[IMAGE_BYTES - CHECKSUM_BYTES..].copy_from_slice(&checksum.to_le_bytes());
}

#[cfg(test)]
pub(crate) mod tests;
