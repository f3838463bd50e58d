//! Reasons for a refused request; as text, each says how to go on.

use serde::{Deserialize, Serialize};
use thiserror::Error;

use crate::settings::SettingsError;
use crate::weights::{IMAGE_BYTES, ImageProblem};

/// A refused request. The order of the variants is part of the protocol: append only.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Error)]
pub enum Refusal {
    /// Settings out of bounds or at odds with each other; those in force stay.
    #[error("settings refused: {0}")]
    Settings(#[from] SettingsError),
    /// A PID gain is out of range.
    #[error("a PID gain is out of range; build the PID on the host to see which")]
    Gains,
    /// An exploration range makes no sense.
    #[error("an exploration range is out of bounds; validate it on the host to see which")]
    Exploration,
    /// Not while ventilating.
    #[error("the device is ventilating; stop it first")]
    Ventilating,
    /// A latched fault must be acknowledged first.
    #[error("a fault is latched; find its cause, then acknowledge it")]
    FaultLatched,
    /// There is no fault to acknowledge.
    #[error("no fault is latched; there is nothing to acknowledge")]
    NoFault,
    /// No valid weights for this control period.
    #[error("the device holds no valid weights for its control period; upload an image first")]
    NoWeights,
    /// No upload has begun.
    #[error("no upload is running; begin it again")]
    NoUpload,
    /// An image of another length.
    #[error("an image of this version has {IMAGE_BYTES} bytes; pack it with this version's trainer")]
    WrongLength,
    /// A chunk that does not follow the last one.
    #[error("chunk out of order; go on at offset {expected}")]
    WrongOffset {
        /// First byte that is missing.
        expected: u32,
    },
    /// Something is wrong with the uploaded image.
    #[error("the device refused the image ({0:?}); decode it on the host to see why")]
    BadImage(ImageProblem),
    /// The image is not the one that was announced.
    #[error("another image arrived than was announced; begin the upload again")]
    OtherImage,
    /// The flash could not be written.
    #[error("the image could not be stored; try again, the old weights are still in force")]
    Storage,
    /// The request could not be read.
    #[error("the device does not know this request; update the older side")]
    UnknownRequest,
    /// No room for more settings.
    #[error("settings for enough breaths are waiting; send more when one has started")]
    QueueFull,
    /// There is no plant to reset.
    #[error("this device breathes with real valves; only one with hardware in the loop has a plant to reset")]
    NoPlant,
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::breath::Breath;
    use crate::settings::{FieldIndex, Settings};
    use proptest::prelude::*;
    use std::string::ToString;

    #[test]
    fn the_reader_of_a_refusal_sees_the_settings_own_words() {
        let settings = Settings { rate: 200.0, ..Settings::default() };
        let error = settings.validate().unwrap_err();
        assert_eq!(Refusal::from(error).to_string(), std::format!("settings refused: {error}"));
    }

    #[test]
    fn a_field_of_a_newer_device_is_no_panic() {
        let newer = SettingsError::OutOfBounds { field: FieldIndex(200), value: 1.0, min: 2.0, max: 3.0 };
        assert!(Refusal::Settings(newer).to_string().contains("another version"));
    }

    proptest! {
        #[test]
        fn no_settings_error_changes_over_the_link(
            pip in 0.0f32..60.0, peep in -1.0f32..25.0, rate in 0.0f32..100.0, limit in 10.0f32..80.0, period in 0u32..400,
        ) {
            let settings = Settings { pip, peep, rate, pressure_limit: limit, ..Settings::default() };
            if let Err(error) = Breath::new(&settings, period) {
                let mut buffer = [0; 16];
                let bytes = postcard::to_slice(&error, &mut buffer).unwrap();
                prop_assert_eq!(postcard::from_bytes(bytes), Ok(error));
            }
        }
    }
}
