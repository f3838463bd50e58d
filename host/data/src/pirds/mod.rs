//! PIRDS, the respiration data standard of Public Invention, in its JSON form: measurements of the airway as
//! scaled integers, one event for each reading.
//!
//! Types, locations and scales are those of version 0.3 of the standard. It has no events for breaths and
//! targets; this project writes them as message events, which other programs show or ignore ([`PhaseMark`]).

mod mark;
mod reader;

use serde::Serialize;

pub use mark::PhaseMark;
pub use reader::{EventFault, EventReader, is_logged};

/// Units of a pressure per cmH2O: the standard counts tenths.
pub const PER_CMH2O: f64 = 10.0;
/// Units of a flow per L/s: the standard counts thousandths of a standard litre per minute.
pub const PER_LITRE_PER_SECOND: f64 = 60_000.0;

/// Type of a pressure relative to the room (`Differential`): airway pressure as ventilation means it.
pub const GAUGE: char = 'D';
/// Type of an absolute pressure.
pub const ABSOLUTE: char = 'P';
/// Type of a flow.
pub const FLOW: char = 'F';
/// Location of the airway, at the patient.
pub const AIRWAY: char = 'A';
/// Location of the inspiratory manifold, in the ventilator.
pub const INSPIRATORY: char = 'I';
/// Location of the expiratory manifold, in the ventilator.
pub const EXPIRATORY: char = 'E';
/// Location of the ambient air.
pub const AMBIENT: char = 'B';
/// Location of a pressure difference that the standard leaves open.
pub const UNSPECIFIED: char = 'D';

/// A sensor: type of its readings, location and number.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub struct Sensor {
    /// Type of the readings, such as [`GAUGE`].
    pub kind: char,
    /// Location, such as [`AIRWAY`].
    pub location: char,
    /// Number of the sensor at its location.
    pub number: u8,
}

impl std::fmt::Display for Sensor {
    /// Such as `DA0`.
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Self { kind, location, number } = self;
        write!(f, "{kind}{location}{number}")
    }
}

/// A reading of a sensor.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Measurement {
    /// The sensor.
    pub sensor: Sensor,
    /// Time from any origin, ms.
    pub ms: u32,
    /// Value in the units of the sensor's type.
    pub value: i32,
    /// Whether the sensor marks the reading as beyond its range, by a negative time.
    pub beyond_range: bool,
}

/// An event of a file.
#[derive(Debug, Clone, PartialEq)]
pub enum Event {
    /// A reading.
    Measurement(Measurement),
    /// The start of a phase, at this time in ms.
    Phase(u32, PhaseMark),
    /// Any other event, by a name to count it by.
    Other(String),
}

/// A reading as the standard writes it.
#[derive(Debug, Serialize)]
struct MeasurementText {
    event: char,
    r#type: char,
    loc: char,
    num: u8,
    ms: u32,
    val: i32,
}

/// A message as the standard writes it.
#[derive(Debug, Serialize)]
struct MessageText<'a> {
    event: char,
    r#type: char,
    ms: u32,
    b_size: usize,
    buff: &'a str,
}

impl Measurement {
    /// The event as JSON, without a line's end.
    pub fn to_json(&self) -> String {
        let Sensor { kind, location, number } = self.sensor;
        let (ms, val) = (self.ms, self.value);
        json(&MeasurementText { event: 'M', r#type: kind, loc: location, num: number, ms, val })
    }
}

/// A message event as JSON, without a line's end.
pub fn message_json(ms: u32, text: &str) -> String {
    json(&MessageText { event: 'E', r#type: 'M', ms, b_size: text.len(), buff: text })
}

/// Neither kind of event can fail to be JSON.
fn json(event: &impl Serialize) -> String {
    serde_json::to_string(event).unwrap_or_default()
}
