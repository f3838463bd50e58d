//! The wire format between server and page, version 1: text messages are JSON with a `type`, binary ones are samples
//! ([`frame`]).

mod figures;
pub mod frame;
mod from_page;
mod margins;
mod state;
mod to_page;
mod verdict;

pub use figures::{BreathFigures, Course, History};
pub use from_page::{DemoFault, FromPage, Secret, Triggers};
pub use margins::{Chart, Choice, Curve, LoopAdvice, Margin, Margins, MeasureInfo, MeasuringInfo, Sines};
pub use state::{Adaptation, AlarmInfo, Audio, LineInfo, Missing, RecordingInfo, State, Ticks};
pub use to_page::{
    Answer, DeviceInfo, EventKind, FlightRecorder, Hello, Kind, Limits, LogLine, Recorded, SettingInfo,
    ToPage,
};
pub use verdict::{LimitCheck, Tolerance, Verdict};

/// Version of the format.
pub const VERSION: u32 = 1;
/// Shortest interval between states of a device, and longest one, ms: well below the 900 ms after which a page shows that it has no data.
pub const STATE_EVERY_MS: (u64, u64) = (100, 250);
/// Longest message from a page, bytes.
pub const REQUEST_BYTES: usize = 4096;
/// Most messages from a page in a second.
pub const REQUESTS_PER_SECOND: u32 = 50;
