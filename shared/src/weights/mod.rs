//! The weights image: the binary form of a learned controller, for files, the link and flash slots.
//!
//! All numbers are little endian; floats are IEEE 754 single precision.
//!
//! | offset | bytes | content |
//! |---|---|---|
//! | 0 | 4 | magic, `EUPN` |
//! | 4 | 2 | format version, [`FORMAT_VERSION`] |
//! | 6 | 2 | architecture, [`ARCHITECTURE`] |
//! | 8 | 8 | sizes of the network from input to output, four u16: [`Network::SHAPE`] |
//! | 16 | 4 | control period, microseconds, u32 |
//! | 20 | 12 | gains P, I, D of the PID underneath |
//! | 32 | 4 | lambda |
//! | 36 | 4 | authority, percent |
//! | 40 | 7 | ages of the error taps, ticks, u8 each |
//! | 47 | 6 | ages of the command taps, ticks, u8 each |
//! | 53 | 8 | time constants of the error's averages, s |
//! | 61 | 8 | time constants of the command's averages, s |
//! | 69 | 12 | time constants of the time features, s |
//! | 81 | 2 | ticks ahead at which the target is seen, u8 each |
//! | 83 | 16 | training id |
//! | 99 | 16 | plant id |
//! | 115 | 4 | golden: last command of the [`exercise`], percent |
//! | 119 | 4 | golden: CRC-32 over the bits of all its commands |
//! | 123 | 4 | length of the parameters, bytes, u32 |
//! | 127 | 4 | image version, u32: grows with every signed image; 0 in an unsigned image |
//! | 131 | ... | parameters in the order of [`Network::parameters`] |
//! | ... | 64 | ed25519 signature of everything before; zeros in an unsigned image ([`trust`]) |
//! | end | 4 | CRC-32 over everything before, u32; also the image's id |
//!
//! Bytes after the checksum are ignored: a flash slot is longer than its image.
//!
//! The golden values are the results of the *built* controller when the image was packed. A device that gets other bits
//! from the same script computes features, network or PID differently from the trainer, and must not run these weights.

pub mod exercise;
mod image;
pub mod slots;
pub mod trust;

use core::fmt;

use serde::{Deserialize, Serialize};
use thiserror::Error;

use crate::control::network::Network;
use crate::control::residual::{Residual, ResidualError};
use exercise::Golden;
pub use image::{decode, decode_trusted, encode};

/// First bytes of every image.
pub const MAGIC: [u8; 4] = *b"EUPN";
/// Version of the layout above and of the [`exercise`]'s script.
pub const FORMAT_VERSION: u16 = 4;
/// Architecture: features of [`crate::control::features`] and what [`crate::control::memory`] recalls, two softsign layers, linear
/// output, PID underneath.
pub const ARCHITECTURE: u16 = 3;
/// Offset of the plant id, bytes.
pub const PLANT_AT: usize = 99;
/// Length of the plant id, bytes.
pub const PLANT_BYTES: usize = 16;
/// Offset of the image version, bytes.
pub const VERSION_AT: usize = 127;
/// Length of the header, before the parameters, bytes.
pub const HEADER_BYTES: usize = 131;
/// Length of the signature, bytes.
pub const SIGNATURE_BYTES: usize = 64;
/// Length of the parameters, bytes.
pub const PARAMETER_BYTES: usize = 4 * Network::PARAMETERS;
/// Length of the signed part, header and parameters, bytes.
pub const SIGNED_BYTES: usize = HEADER_BYTES + PARAMETER_BYTES;
/// Length of an image, bytes.
pub const IMAGE_BYTES: usize = SIGNED_BYTES + SIGNATURE_BYTES + crate::checksum::CHECKSUM_BYTES;

/// Origin of weights.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Identity {
    /// Id of the training that produced them.
    pub training: [u8; 16],
    /// Id of the ventilator whose recording they were trained on.
    pub plant: [u8; PLANT_BYTES],
}

/// A validated image.
#[derive(Clone, Debug, PartialEq)]
pub struct Image {
    /// The learned controller, ready to run.
    pub residual: Residual,
    /// Its origin.
    pub identity: Identity,
    /// Its version, which grows with every signed image.
    pub version: u32,
    /// Its results in the exercise.
    pub golden: Golden,
    /// The image's checksum, which identifies it.
    pub id: u32,
}

/// The id of an image, to be written in hexadecimal.
#[derive(Clone, Copy, Debug)]
pub struct ImageId(pub u32);

impl fmt::Display for ImageId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{:08x}", self.0)
    }
}

/// Reason for refusing an image.
#[derive(Clone, Copy, Debug, PartialEq, Error)]
pub enum WeightsError {
    /// Bytes are missing.
    #[error("image is truncated: {have} of {need} bytes; transfer it again")]
    Length {
        /// Bytes given.
        have: usize,
        /// Bytes of a complete image.
        need: usize,
    },
    /// Not an image, for example an erased flash slot.
    #[error("this is not a weights image; use a file that the trainer packed")]
    Magic,
    /// The image has another version of the layout.
    #[error(
        "image has format {0}, but this version reads {FORMAT_VERSION}; pack its controller again with this version's trainer"
    )]
    Version(u16),
    /// The checksum does not match.
    #[error("image is damaged (checksum differs); transfer it again")]
    Checksum,
    /// The image contains another kind of controller.
    #[error("image has architecture {0}, this version runs {ARCHITECTURE}; train with this version")]
    Architecture(u16),
    /// The network's sizes differ.
    #[error("image has a network of {0:?}, this version runs {shape:?}; train with this version", shape = Network::SHAPE)]
    Shape([u16; 4]),
    /// A parameter is not a number or out of bounds.
    #[error("parameter {0} is not finite or out of bounds; train again with a lower learning rate")]
    Weight(usize),
    /// Gains, lambda, authority, control period or features are out of bounds.
    #[error("controller cannot be built: {0}; pack it again with values in bounds")]
    Spec(#[from] ResidualError),
    /// The built controller gives other commands than when it was packed.
    #[error(
        "controller gives other commands here than on the trainer; pack it again with the version that runs here"
    )]
    Golden,
    /// The device trusts only signed images, and this one has no signature.
    #[error(
        "image is not signed, but the device runs only signed ones; sign it with: trainer flash --key FILE"
    )]
    Unsigned,
    /// The signature is not that of the trusted key, or the image was altered.
    #[error(
        "the signature does not match: the image was altered, or signed with another key than the device trusts"
    )]
    Signature,
    /// The image is signed, but for another plant than the device's.
    #[error("image is for another plant than the one that the device's firmware was built for")]
    Plant,
}

/// A [`WeightsError`] without its numbers, for the link. The order of the variants is part of the protocol: append
/// only.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[expect(missing_docs, reason = "the same variants as in the error")]
pub enum ImageProblem {
    Length,
    Magic,
    Version,
    Checksum,
    Architecture,
    Shape,
    Weight,
    Spec,
    Golden,
    Unsigned,
    Signature,
    Plant,
}

impl ImageProblem {
    /// Whether the image is damaged, or else whole but not meant to run here: of another layout, or not trusted.
    pub fn is_damage(self) -> bool {
        !matches!(self, Self::Version | Self::Unsigned | Self::Signature | Self::Plant)
    }
}

impl From<WeightsError> for ImageProblem {
    fn from(error: WeightsError) -> Self {
        match error {
            WeightsError::Length { .. } => Self::Length,
            WeightsError::Magic => Self::Magic,
            WeightsError::Version(_) => Self::Version,
            WeightsError::Checksum => Self::Checksum,
            WeightsError::Architecture(_) => Self::Architecture,
            WeightsError::Shape(_) => Self::Shape,
            WeightsError::Weight(_) => Self::Weight,
            WeightsError::Spec(_) => Self::Spec,
            WeightsError::Golden => Self::Golden,
            WeightsError::Unsigned => Self::Unsigned,
            WeightsError::Signature => Self::Signature,
            WeightsError::Plant => Self::Plant,
        }
    }
}
