//! The state of a device.

use serde::Serialize;
use shared::settings::Settings;

use super::{MeasuringInfo, Triggers};

/// The state of a device.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct State {
    /// The device.
    pub device: u8,
    /// Whether it answers.
    pub connected: bool,
    /// Why it does not.
    pub lost: Option<String>,
    /// What is missing then.
    pub missing: Option<Missing>,
    /// Mode in words.
    pub mode: String,
    /// Whether it is in its latched safe state.
    pub safe_state: bool,
    /// Whether it ventilates.
    pub ventilating: bool,
    /// The chosen controller in words.
    pub controller: String,
    /// What commands the inspiratory valve: learned, pid, capped, backup; empty if unknown.
    pub level: &'static str,
    /// Present alarms because of which the ventilator does not trust a controller or a reading, in words.
    pub distrust: Vec<&'static str>,
    /// How far the learned controller has adapted to the patient; null if another one is chosen, or before its first breath.
    pub adaptation: Option<Adaptation>,
    /// Settings in force; null before the first answer.
    pub settings: Option<Settings>,
    /// Settings that wait for the next breath.
    pub pending: Option<Settings>,
    /// Alarms, the most urgent first.
    pub alarms: Vec<AlarmInfo>,
    /// The sounder.
    pub audio: Audio,
    /// The page that steers, in words.
    pub steered_by: Option<String>,
    /// The program that holds the device's lease, in words; null if none does, or if that is unknown.
    pub lease: Option<String>,
    /// The measurement of the margins that runs.
    pub measuring: Option<MeasuringInfo>,
    /// Control ticks.
    pub ticks: Ticks,
    /// Losses on the way to the server.
    pub line: LineInfo,
    /// The recording that is being written.
    pub recording: Option<RecordingInfo>,
    /// The armed triggers of a capture; null if there are none.
    pub triggers: Option<Triggers>,
}

/// What is missing from a device that counts as lost.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Missing {
    /// The line to it.
    Line,
    /// Answers.
    Answers,
    /// Samples, although it ventilates.
    Samples,
}

/// How far the learned controller has adapted to the patient.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub struct Adaptation {
    /// Breaths that it has adopted since it last forgot all, at most `of`.
    pub breaths: u8,
    /// Breaths after which it has adapted.
    pub of: u8,
    /// What has become of the last breath, in words.
    pub last: &'static str,
}

/// An alarm that is present or not yet acknowledged.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct AlarmInfo {
    /// Stable name.
    pub id: &'static str,
    /// In words.
    pub text: &'static str,
    /// high, medium or low.
    pub priority: &'static str,
    /// Whether its condition holds.
    pub present: bool,
    /// Since when, ms since 1970; null if it was there before the server saw the device.
    pub since_ms: Option<u64>,
    /// Whether an operator has acknowledged it.
    pub acknowledged: bool,
}

/// The sounder of a device.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Audio {
    /// Priority of the most urgent alarm that nobody has acknowledged.
    pub priority: Option<&'static str>,
    /// Rest of an audio pause, s.
    pub pause_left: u16,
}

/// Control ticks since the device's start.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Ticks {
    /// Mean duration, us; null for a device that does not measure it.
    pub mean_us: Option<f32>,
    /// Longest duration, us; null for a device that does not measure it.
    pub worst_us: Option<f32>,
    /// Distance of the mean period from the one that is meant, us; null for a device that does not measure it.
    pub bias_us: Option<f32>,
    /// Largest distance of a period, us; null for a device that does not measure it.
    pub jitter_us: Option<f32>,
    /// Ticks that did not run.
    pub missed: u32,
}

/// Losses between device and server.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct LineInfo {
    /// Damaged frames.
    pub corrupt: u64,
    /// Lost batches of samples.
    pub lost_batches: u64,
    /// Reports that the device dropped.
    pub dropped: u32,
}

/// A recording that is being written.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct RecordingInfo {
    /// Its file.
    pub file: String,
    /// Samples so far.
    pub samples: u64,
    /// Samples that are not in it because the disk was too slow.
    pub lost: u64,
    /// The page that started it, in words.
    pub by: String,
}
