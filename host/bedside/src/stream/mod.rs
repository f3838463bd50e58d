//! The wire format between server and page, version 1: text messages are JSON with a `type`, binary ones are samples
//! ([`frame`]).

pub mod frame;

use std::collections::BTreeMap;
use std::fmt;

use serde::{Deserialize, Serialize};
use shared::device::annunciator::AUDIO_PAUSE_MAX;
use shared::link::messages::DeviceKind;
use shared::settings::{FIELDS, Settings};

/// Version of the format.
pub const VERSION: u32 = 1;
/// Longest message from a page, bytes.
pub const REQUEST_BYTES: usize = 4096;
/// Most messages from a page in a second.
pub const REQUESTS_PER_SECOND: u32 = 50;

/// A text message to the page.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[serde(tag = "type", rename_all = "snake_case")]
pub enum ToPage {
    /// The first message.
    Hello(Hello),
    /// The state of a device, at each change and at least twice a second.
    State(Box<State>),
    /// The figures of a breath that has ended.
    Breath {
        /// The device.
        device: u8,
        /// When it ended, ms since 1970.
        time_ms: u64,
        /// Its figures.
        #[serde(flatten)]
        figures: BreathFigures,
    },
    /// Who steers a device from a page.
    Steerer {
        /// The device.
        device: u8,
        /// The page that steers, in words.
        who: Option<String>,
        /// Whether it is the page that gets this message.
        yours: bool,
    },
    /// The answer to a request with an id.
    Answer(Answer),
    /// Something that happened.
    Event {
        /// The device.
        device: u8,
        /// When, ms since 1970.
        time_ms: u64,
        /// What kind of thing.
        kind: EventKind,
        /// In words.
        text: String,
        /// The device's newest tick then; null before its first sample.
        tick: Option<u64>,
    },
    /// The trends so far, when a page opens.
    History {
        /// The device.
        device: u8,
        /// Its trends.
        #[serde(flatten)]
        history: History,
    },
    /// The verdict on a recording, when a page opens.
    Verdict {
        /// The device.
        device: u8,
        /// The verdict.
        #[serde(flatten)]
        verdict: Verdict,
    },
    /// The event log of a flight recorder, when a page opens or asks for it.
    Log {
        /// The device.
        device: u8,
        /// The log.
        #[serde(flatten)]
        log: Log,
    },
}

impl ToPage {
    /// The message as JSON. A number that is not finite becomes null.
    pub fn to_json(&self) -> String {
        // Strings, numbers and maps with text keys: nothing here can fail.
        serde_json::to_string(self).unwrap_or_default()
    }
}

/// The greeting of a page.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Hello {
    /// [`VERSION`].
    pub version: u32,
    /// Whether pages may steer.
    pub steer: bool,
    /// Whether this is the demonstration, with faults at a button.
    pub demo: bool,
    /// All settings with units and bounds.
    pub settings: Vec<SettingInfo>,
    /// Limits of requests.
    pub limits: Limits,
    /// The devices.
    pub devices: Vec<DeviceInfo>,
}

/// Limits of requests, as `shared` defines them.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub struct Limits {
    /// Longest audio pause, s.
    pub audio_pause_s: u16,
}

impl Default for Limits {
    fn default() -> Self {
        Self { audio_pause_s: AUDIO_PAUSE_MAX }
    }
}

/// A setting, as `shared` defines it.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct SettingInfo {
    name: &'static str,
    description: &'static str,
    unit: &'static str,
    min: f32,
    max: f32,
    default: f32,
}

impl SettingInfo {
    /// All settings.
    pub fn all() -> Vec<Self> {
        FIELDS
            .iter()
            .map(|field| Self {
                name: field.name,
                description: field.description,
                unit: field.unit,
                min: field.min,
                max: field.max,
                default: field.default,
            })
            .collect()
    }
}

/// A watched device.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct DeviceInfo {
    /// Its number in all messages.
    pub id: u8,
    /// Name to show.
    pub name: String,
    /// What it is.
    pub kind: Kind,
    /// Control period, microseconds.
    pub period_us: u32,
}

/// What is watched.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Kind {
    /// A ventilator.
    Board,
    /// A board with hardware in the loop.
    Hil,
    /// A simulated device.
    Simulated,
    /// A replay of a recording.
    Recording,
}

impl Kind {
    /// The kind of a connected device.
    pub fn of(device: DeviceKind) -> Self {
        match device {
            DeviceKind::Ventilator => Self::Board,
            DeviceKind::HardwareInTheLoop => Self::Hil,
            DeviceKind::Simulated => Self::Simulated,
        }
    }
}

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
    /// Whether it ventilates.
    pub ventilating: bool,
    /// The chosen controller in words.
    pub controller: String,
    /// What commands the inspiratory valve: learned, pid, capped, backup; empty if unknown.
    pub level: &'static str,
    /// Present alarms because of which the ventilator does not trust a controller or a reading, in words.
    pub distrust: Vec<&'static str>,
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
    /// The page that started it, in words.
    pub by: String,
}

/// Figures of a breath; null where unknown. Pressures in cmH2O.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct BreathFigures {
    /// Number of the breath since the start of ventilation.
    pub number: u32,
    /// Highest pressure.
    pub pip: Option<f32>,
    /// Mean pressure at the end of the inspiration.
    pub plateau: Option<f32>,
    /// Mean pressure at the end of the breath.
    pub peep: Option<f32>,
    /// Inspired volume, mL.
    pub tidal_volume: Option<f32>,
    /// Inspired volume in a minute, L/min.
    pub minute_volume: Option<f32>,
    /// Rate of this breath, 1/min.
    pub rate: Option<f32>,
    /// Set rate, 1/min.
    pub rate_set: Option<f32>,
    /// Time of the expiration, relative to that of the inspiration.
    pub ie: Option<f32>,
    /// Resistance, cmH2O/(L/s).
    pub resistance: Option<f32>,
    /// Compliance, mL/cmH2O.
    pub compliance: Option<f32>,
    /// Leak, L/min.
    pub leak: Option<f32>,
    /// Mean absolute error over the inspiration.
    pub error: Option<f32>,
    /// Time from 10 to 90 % of the way from PEEP to PIP, ms.
    pub rise_ms: Option<f32>,
    /// Highest pressure above PIP.
    pub overshoot: Option<f32>,
    /// Whether flow and volumes are estimated.
    pub estimated: bool,
    /// Whether an effort of the patient has started the breath.
    pub triggered: bool,
}

/// Figures of the breaths in the last 72 hours, minute by minute; minutes without a breath are left out.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct History {
    /// Numbers of the minutes since 1970, ascending.
    pub minutes: Vec<u64>,
    /// Breaths in each.
    pub breaths: Vec<u16>,
    /// The figures by name, in the units of [`BreathFigures`].
    pub figures: BTreeMap<&'static str, Course>,
}

/// One figure, minute by minute; null where it is not known.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Course {
    /// Lowest value of the minute.
    pub low: Vec<f32>,
    /// Mean value.
    pub mean: Vec<f32>,
    /// Highest value.
    pub high: Vec<f32>,
}

/// The verdict on a recording.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Verdict {
    /// Why there is none.
    pub refused: Option<String>,
    /// Judged breaths.
    pub breaths: usize,
    /// Breaths that cannot be judged.
    pub unjudged: usize,
    /// Breaths that violate a limit.
    pub violating: usize,
    /// Mean absolute error over the inspirations, cmH2O.
    pub error: Option<f64>,
    /// Share of the inspiratory ticks with a random perturbation, 0 to 1.
    pub explored: f64,
    /// Accuracy at the end of the inspiration.
    pub inspiration: Option<Tolerance>,
    /// Accuracy at the end of the expiration.
    pub expiration: Option<Tolerance>,
    /// Each limit.
    pub limits: Vec<LimitCheck>,
    /// What is wrong most, in words, the most severe first.
    pub sore_spots: Vec<String>,
}

/// A tolerance: fixed, plus a percentage of the set pressure.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Tolerance {
    /// Fixed part, in the unit of what it limits.
    pub fixed: f64,
    /// Percent of the set pressure.
    pub percent: f64,
}

/// One limit on all breaths of a recording.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct LimitCheck {
    /// What is limited.
    pub name: &'static str,
    /// Its unit.
    pub unit: &'static str,
    /// The limit.
    pub limit: Tolerance,
    /// Breaths whose value is known.
    pub checked: usize,
    /// Breaths that violate it.
    pub violations: usize,
    /// The largest value that violates it, and its breath.
    pub worst: Option<f64>,
    /// Number of that breath in the recording.
    pub worst_breath: Option<u32>,
}

/// The event log of a flight recorder.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Log {
    /// Its events, the oldest first.
    pub events: Vec<LogLine>,
}

/// An event of a flight recorder.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct LogLine {
    /// Number of the start from which its time counts.
    pub start: u16,
    /// Time since that start, s.
    pub seconds: f64,
    /// In words.
    pub text: String,
}

/// The answer to a request.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Answer {
    /// Id of the request; null for a message that could not be read.
    pub id: Option<u32>,
    /// Whether it was carried out.
    pub ok: bool,
    /// What was done, or why not.
    pub text: String,
    /// The settings as applied.
    pub settings: Option<Settings>,
}

impl Answer {
    /// A request that was carried out.
    pub fn done(id: u32, text: impl Into<String>) -> Self {
        Self { id: Some(id), ok: true, text: text.into(), settings: None }
    }

    /// A request that was not carried out.
    pub fn refused(id: Option<u32>, why: impl Into<String>) -> Self {
        Self { id, ok: false, text: why.into(), settings: None }
    }
}

/// Kinds of events.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum EventKind {
    /// A page has marked the moment.
    Marker,
    /// A triggered capture was written.
    Capture,
    /// An alarm has begun.
    Alarm,
    /// The connection was lost.
    Lost,
    /// The device has restarted.
    Restarted,
}

/// A text that must not reach a log.
#[derive(Clone, PartialEq, Eq, Deserialize)]
#[serde(transparent)]
pub struct Secret(pub String);

impl fmt::Debug for Secret {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("(hidden)")
    }
}

/// A message of a page.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(tag = "type", rename_all = "snake_case", deny_unknown_fields)]
pub enum FromPage {
    /// The token of the address, as the first message.
    Token {
        /// The token.
        token: Secret,
    },
    /// The devices whose samples the page wants.
    Watch {
        /// Their numbers.
        devices: Vec<u8>,
    },
    /// Steer a device from this page.
    Take {
        /// The device.
        device: u8,
        /// Whether to take it from another page, which only a person may decide.
        #[serde(default)]
        take_over: bool,
    },
    /// Stop steering it.
    Release {
        /// The device.
        device: u8,
    },
    /// The first tick that the page has newly drawn since its last report, for the latency: the one that waited longest.
    Drawn {
        /// The device.
        device: u8,
        /// The tick.
        tick: u64,
    },
    /// Change settings from the next breath on.
    Apply {
        /// For the answer.
        id: u32,
        /// The device.
        device: u8,
        /// The settings to change, by name.
        settings: BTreeMap<String, f32>,
    },
    /// Start ventilation.
    Start {
        /// For the answer.
        id: u32,
        /// The device.
        device: u8,
    },
    /// Stop ventilation.
    Stop {
        /// For the answer.
        id: u32,
        /// The device.
        device: u8,
    },
    /// Acknowledge all alarms.
    Acknowledge {
        /// For the answer.
        id: u32,
        /// The device.
        device: u8,
    },
    /// Pause the sounder.
    PauseAudio {
        /// For the answer.
        id: u32,
        /// The device.
        device: u8,
        /// Length of the pause, s; 0 ends it.
        seconds: u16,
    },
    /// Mark this moment.
    Mark {
        /// For the answer.
        id: u32,
        /// The device.
        device: u8,
        /// The marker's text.
        text: String,
    },
    /// Start or end a recording.
    Record {
        /// For the answer.
        id: u32,
        /// The device.
        device: u8,
        /// Whether to record.
        on: bool,
    },
    /// Arm the triggered capture.
    Capture {
        /// For the answer.
        id: u32,
        /// The device.
        device: u8,
        /// What triggers it; nothing disarms it.
        triggers: Triggers,
    },
    /// Read the event log of the device's flight recorder.
    Recorder {
        /// For the answer.
        id: u32,
        /// The device.
        device: u8,
    },
    /// Inject a fault into a device of the demonstration.
    Fault {
        /// For the answer.
        id: u32,
        /// The device.
        device: u8,
        /// The fault.
        fault: DemoFault,
    },
}

impl FromPage {
    /// Id for the answer; none for a message that gets none.
    pub fn id(&self) -> Option<u32> {
        match self {
            Self::Apply { id, .. }
            | Self::Start { id, .. }
            | Self::Stop { id, .. }
            | Self::Acknowledge { id, .. }
            | Self::PauseAudio { id, .. }
            | Self::Mark { id, .. }
            | Self::Record { id, .. }
            | Self::Capture { id, .. }
            | Self::Recorder { id, .. }
            | Self::Fault { id, .. } => Some(*id),
            Self::Token { .. }
            | Self::Watch { .. }
            | Self::Take { .. }
            | Self::Release { .. }
            | Self::Drawn { .. } => None,
        }
    }

    /// The device that it is about.
    pub fn device(&self) -> Option<u8> {
        match self {
            Self::Apply { device, .. }
            | Self::Start { device, .. }
            | Self::Stop { device, .. }
            | Self::Acknowledge { device, .. }
            | Self::PauseAudio { device, .. }
            | Self::Mark { device, .. }
            | Self::Record { device, .. }
            | Self::Capture { device, .. }
            | Self::Recorder { device, .. }
            | Self::Fault { device, .. }
            | Self::Take { device, .. }
            | Self::Release { device }
            | Self::Drawn { device, .. } => Some(*device),
            Self::Token { .. } | Self::Watch { .. } => None,
        }
    }

    /// Reads a message.
    ///
    /// # Errors
    /// Why it is not one.
    pub fn parse(text: &str) -> Result<Self, serde_json::Error> {
        serde_json::from_str(text)
    }
}

/// What triggers a capture.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Triggers {
    /// Any alarm that begins.
    pub alarm: bool,
    /// A breath with more overshoot, cmH2O.
    pub overshoot: Option<f32>,
    /// A pressure above this, cmH2O.
    pub pressure: Option<f32>,
}

impl Triggers {
    /// Whether anything can trigger it.
    pub fn is_armed(&self) -> bool {
        self.alarm || self.overshoot.is_some() || self.pressure.is_some()
    }

    /// Checks the thresholds.
    ///
    /// # Errors
    /// A text that names the threshold that cannot trigger anything.
    pub fn check(&self) -> Result<(), String> {
        let wrong = [("overshoot", self.overshoot), ("pressure", self.pressure)]
            .into_iter()
            .find(|(_, limit)| limit.is_some_and(|limit| !(limit.is_finite() && limit > 0.0)));
        wrong.map_or(Ok(()), |(name, _)| {
            Err(format!("the threshold of the {name} must be a number above 0 cmH2O"))
        })
    }
}

/// A fault of the demonstration.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum DemoFault {
    /// The tube comes off.
    Disconnect,
    /// The patient coughs.
    Cough,
    /// The reading of the pressure sensor sticks.
    Stick,
    /// All faults end.
    None,
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use serde_json::{Value, json};

    fn value(message: &ToPage) -> Value {
        serde_json::from_str(&message.to_json()).unwrap()
    }

    #[test]
    fn a_message_names_its_type() {
        let steerer = ToPage::Steerer { device: 1, who: None, yours: false };
        assert_eq!(value(&steerer), json!({"type": "steerer", "device": 1, "who": null, "yours": false}));
        let state = value(&ToPage::State(Box::default()));
        assert_eq!((&state["type"], &state["settings"]), (&json!("state"), &Value::Null));
    }

    #[test]
    fn a_figure_that_is_not_known_or_not_finite_is_null() {
        let figures = BreathFigures { number: 3, pip: Some(f32::NAN), ..BreathFigures::default() };
        let breath = value(&ToPage::Breath { device: 0, time_ms: 5, figures });
        assert_eq!(
            (&breath["number"], &breath["pip"], &breath["leak"]),
            (&json!(3), &Value::Null, &Value::Null)
        );
        assert_eq!(breath["time_ms"], 5, "also for devices whose samples a page does not watch");
    }

    #[test]
    fn the_settings_of_the_greeting_are_those_of_the_core() {
        let hello = Hello {
            version: VERSION,
            steer: true,
            demo: false,
            settings: SettingInfo::all(),
            limits: Limits::default(),
            devices: vec![],
        };
        let hello = value(&ToPage::Hello(hello));
        assert_eq!(hello["settings"].as_array().unwrap().len(), FIELDS.len());
        assert_eq!(hello["settings"][0]["name"], "pip");
        assert_eq!(hello["settings"][0]["unit"], "cmH2O");
        assert_eq!(hello["limits"]["audio_pause_s"], AUDIO_PAUSE_MAX);
    }

    #[test]
    fn a_threshold_that_nothing_can_exceed_or_that_all_exceed_is_wrong() {
        let with = |pressure| Triggers { pressure: Some(pressure), ..Triggers::default() };
        assert_eq!(with(30.0).check(), Ok(()));
        for wrong in [0.0, -1.0, f32::NAN, f32::INFINITY] {
            assert!(with(wrong).check().unwrap_err().contains("pressure"), "{wrong}");
        }
    }

    #[test]
    fn a_page_takes_over_only_if_it_says_so() {
        let take = |text| FromPage::parse(text).unwrap();
        let plain = FromPage::Take { device: 1, take_over: false };
        assert_eq!(take(r#"{"type":"take","device":1}"#), plain);
        assert_ne!(take(r#"{"type":"take","device":1,"take_over":true}"#), plain);
    }

    #[test]
    fn a_request_is_read_and_an_unknown_one_is_not() {
        let apply = FromPage::parse(r#"{"type":"apply","id":7,"device":0,"settings":{"pip":25}}"#).unwrap();
        let settings = BTreeMap::from([("pip".to_owned(), 25.0)]);
        assert_eq!(apply, FromPage::Apply { id: 7, device: 0, settings });
        for wrong in [
            r#"{"type":"shell","id":7}"#,
            r#"{"type":"start","device":0}"#,
            r#"{"type":"start","id":1,"device":256}"#,
            r#"{"type":"start","id":1,"device":0,"force":true}"#,
            r#"{"type":"fault","id":1,"device":0,"fault":"fire"}"#,
            "[]",
            "",
        ] {
            assert!(FromPage::parse(wrong).is_err(), "{wrong}");
        }
    }

    proptest! {
        #[test]
        fn no_text_of_a_page_causes_a_panic(text in ".{0,200}") {
            let _ = FromPage::parse(&text);
        }
    }
}
