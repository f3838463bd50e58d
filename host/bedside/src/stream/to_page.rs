//! Messages to a page.

use serde::Serialize;
use shared::device::annunciator::AUDIO_PAUSE_MAX;
use shared::link::messages::DeviceKind;
use shared::settings::{FIELDS, Settings};

use super::{BreathFigures, History, Margins, MeasureInfo, State, Verdict};

/// A text message to the page.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[serde(tag = "type", rename_all = "snake_case")]
pub enum ToPage {
    /// The first message.
    Hello(Hello),
    /// The state of a device, at each change and at least four times a second.
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
    /// The margins of a device, when they are measured and when a page opens.
    Margins {
        /// The device.
        device: u8,
        /// The result.
        #[serde(flatten)]
        margins: Box<Margins>,
    },
    /// The content of a flight recorder, when a page opens or asks for it.
    Recorder {
        /// The device.
        device: u8,
        /// The content.
        #[serde(flatten)]
        recorder: Box<FlightRecorder>,
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
    /// [`VERSION`](super::VERSION).
    pub version: u32,
    /// Whether pages may steer.
    pub steer: bool,
    /// Whether pages with the token may record.
    pub record: bool,
    /// Whether this is the demonstration, with faults at a button.
    pub demo: bool,
    /// All settings with units and bounds.
    pub settings: Vec<SettingInfo>,
    /// Limits of requests.
    pub limits: Limits,
    /// What a measurement of the margins may ask for; null if none can be made here.
    pub measure: Option<MeasureInfo>,
    /// The devices.
    pub devices: Vec<DeviceInfo>,
}

/// Change of a pressure above which a page asks the operator to confirm it, cmH2O.
const LARGE_CHANGE: f32 = 5.0;

/// Limits of requests.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Limits {
    /// Longest audio pause, s, as `shared` defines it.
    pub audio_pause_s: u16,
    /// Change of a pressure above which a page asks for a confirmation, cmH2O.
    pub large_change: f32,
}

impl Default for Limits {
    fn default() -> Self {
        Self { audio_pause_s: AUDIO_PAUSE_MAX, large_change: LARGE_CHANGE }
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
            DeviceKind::Ventilator | DeviceKind::ThirdParty => Self::Board,
            DeviceKind::HardwareInTheLoop => Self::Hil,
            DeviceKind::Simulated | DeviceKind::Desk => Self::Simulated,
        }
    }
}

/// The content of a flight recorder.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct FlightRecorder {
    /// Its events, the oldest first.
    pub events: Vec<LogLine>,
    /// Every control tick of the last 2 s; none for a file, whose ticks are replayed.
    pub fast: Option<Recorded>,
    /// Every 20th tick of the last 60 s, each with the highest pressure of the 20; none for a file.
    pub slow: Option<Recorded>,
}

/// Recorded ticks, the oldest first: columns of equal length. A row without a command is a gap, in which the recording was paused.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Recorded {
    /// Time, s: the newest tick is at 0, and gaps take no time.
    pub time: Vec<f64>,
    /// Pressure as read, cmH2O; not finite if the reading was not a number.
    pub pressure: Vec<f32>,
    /// Target, cmH2O; not finite outside a breath.
    pub target: Vec<f32>,
    /// Command of the inspiratory valve, percent.
    pub u_in: Vec<f32>,
    /// Command of the expiratory valve, percent: 0 or 100.
    pub u_out: Vec<f32>,
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
    /// The device does not report something, or sends what no device can.
    Device,
}

#[cfg(test)]
mod tests {
    use serde_json::{Value, json};

    use super::*;
    use crate::stream::VERSION;

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
            record: true,
            demo: false,
            settings: SettingInfo::all(),
            limits: Limits::default(),
            measure: None,
            devices: vec![],
        };
        let hello = value(&ToPage::Hello(hello));
        assert_eq!(hello["settings"].as_array().unwrap().len(), FIELDS.len());
        assert_eq!(hello["settings"][0]["name"], "pip");
        assert_eq!(hello["settings"][0]["unit"], "cmH2O");
        assert_eq!(hello["limits"]["audio_pause_s"], AUDIO_PAUSE_MAX);
    }
}
