//! Reasons for refusing a request; each text says what to do next.

use serde::{Deserialize, Serialize};
use thiserror::Error;

use super::host_name::HostName;
use super::self_test::{Finding, Step};
use crate::calibration::CalibrationError;
use crate::explore::sines::SweepError;
use crate::settings::SettingsError;
use crate::timing::LEASE_S;
use crate::weights::{IMAGE_BYTES, ImageProblem};

/// Longest audio pause, s.
pub const AUDIO_PAUSE_MAX: u16 = 120;

/// Reason for refusing a request. The order of the variants is part of the protocol: append only.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Error)]
pub enum Refusal {
    /// Settings are out of bounds or contradict each other; those in force stay.
    #[error("settings refused: {0}")]
    Settings(#[from] SettingsError),
    /// A PID gain is out of range.
    #[error("a PID gain is out of range; build the PID on the host to see which one")]
    Gains,
    /// An exploration range is out of bounds.
    #[error("an exploration range is out of bounds; validate the exploration on the host to see which one")]
    Exploration,
    /// The request is not allowed while ventilating.
    #[error("the device is ventilating; stop it first")]
    Ventilating,
    /// A latched fault must be acknowledged first.
    #[error("a fault is latched; find its cause, then acknowledge it")]
    FaultLatched,
    /// There is no alarm to acknowledge.
    #[error("there is no alarm to acknowledge")]
    NoFault,
    /// No valid weights for the control period were loaded at the start.
    #[error("no valid weights for the control period are loaded; upload an image, then reset the device")]
    NoWeights,
    /// No upload is in progress.
    #[error("no upload is in progress; begin it again")]
    NoUpload,
    /// The image has another length than images of this version.
    #[error("an image of this version has {IMAGE_BYTES} bytes; pack it with this version's trainer")]
    WrongLength,
    /// The chunk does not follow the last one, or bytes are missing.
    #[error("chunk out of order; continue at offset {expected}")]
    WrongOffset {
        /// Offset of the first missing byte.
        expected: u32,
    },
    /// The uploaded image is invalid.
    #[error("the device refused the image ({0:?}); decode it on the host to see why")]
    BadImage(ImageProblem),
    /// The image's id is not the announced one.
    #[error("the uploaded image is not the announced one; begin the upload again")]
    OtherImage,
    /// The image could not be written to the flash.
    #[error("the image could not be stored; the old weights are still in force, try again")]
    Storage,
    /// The request could not be decoded.
    #[error("the device does not know this request; update the older side")]
    UnknownRequest,
    /// The queue of settings is full.
    #[error("the queue of settings is full; send more after the next breath has started")]
    QueueFull,
    /// The device has no plant to reset.
    #[error("this device has real valves; only a device with a simulated plant can reset it")]
    NoPlant,
    /// No pressure sensor is sound.
    #[error(
        "no pressure sensor is sound; check its supply and wiring, and start once the reading has been sound for 5 s"
    )]
    NoSensor,
    /// The audio pause is too long.
    #[error(
        "an audio pause lasts at most {AUDIO_PAUSE_MAX} s; request a shorter one, and repeat it if necessary"
    )]
    PauseTooLong,
    /// There is no sound to pause.
    #[error("no alarm sounds: there is nothing to pause")]
    NothingSounds,
    /// A step of the self-test has failed.
    #[error("the self-test step '{}' has failed: {finding}", .step.name())]
    SelfTestFailed {
        /// The step.
        step: Step,
        /// What it found.
        finding: Finding,
    },
    /// The self-test has not ended.
    #[error("the self-test has not ended; wait a few seconds and try again")]
    SelfTestRuns,
    /// Another host steers the device; this one only reads.
    #[error(
        "{holder} steers this device: end that program, wait {LEASE_S} s after its last request, or take over on the page of `trainer serve --steer`"
    )]
    Lease {
        /// The host that steers.
        holder: HostName,
    },
    /// The request changes the device, and the host does not hold its lease.
    #[error("this request changes the device: acquire its lease first")]
    NoLease,
    /// No host has sent settings in this standby.
    #[error(
        "no settings were sent since the device went to standby: check and send the settings, then start"
    )]
    NotConfirmed,
    /// The device runs only signed images.
    #[error(
        "this device runs only signed weights, and these are not signed: sign them with the device's key, trainer flash --key FILE"
    )]
    Unsigned,
    /// The signature does not match the device's key.
    #[error(
        "the signature of the weights does not match the device's key: they were altered, or signed with another key (`trainer identify` and `trainer keys --show` name both)"
    )]
    WrongSignature,
    /// The device has signed weights that are not older.
    #[error(
        "weights of version {version} are not newer than version {stored}, which the device has: sign them again with a higher --image-version"
    )]
    OldWeights {
        /// Version of the refused image.
        version: u32,
        /// Highest version that the device has.
        stored: u32,
    },
    /// The weights were made for another plant than the device's.
    #[error(
        "these weights are signed for another plant than the one that this device's firmware was built for: `trainer inspect` names theirs; train on recordings of this plant"
    )]
    OtherPlant,
    /// A value of the calibration is out of bounds.
    #[error("calibration refused: {0}")]
    Calibration(#[from] CalibrationError),
    /// The calibration could not be written to the flash.
    #[error(
        "the calibration could not be stored; send it again, and if that fails too, replace the board: its flash is worn out"
    )]
    CalibrationStorage,
    /// The board's flash has no room for calibrations.
    #[error("this board has no room for calibrations; use the main board (docs/HARDWARE.md)")]
    NoCalibrations,
    /// The device does not simulate its plant.
    #[error("this device simulates no bench: only one with the image for the desk does (docs/HARDWARE.md)")]
    NoBench,
    /// The description cannot be used.
    #[error(
        "the device cannot simulate this bench: it takes at most 2 faults, of which one delays a reading, by at most 250 ms, 16 changes of the leak and 4 sub-steps; if it has no more, update the older side"
    )]
    BadBench,
    /// A value of a sweep of sines is out of bounds.
    #[error("sweep refused: {0}")]
    Sweep(#[from] SweepError),
    /// An alarm is present, during which no sine is added to the command.
    #[error("an alarm is present: find its cause, and measure the loop once the alarm has ended")]
    AlarmPresent,
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::breath::Breath;
    use crate::settings::{FieldIndex, Settings};
    use proptest::prelude::*;
    use std::string::ToString;

    #[test]
    fn a_refusal_contains_the_text_of_the_settings_error() {
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
