//! What a device reports, for every display of it: news, the state that they have [`reported`], [`words`], how evenly it [`ticks`],
//! and the [`curve`] of an inspiration.
//!
//! Neither clock nor port nor thread: it compiles for a browser, too.
#![forbid(unsafe_code)]

pub mod curve;
pub mod reported;
pub mod ticks;
pub mod words;

use serde::Serialize;
use shared::link::messages::{Event, Request, Response};
use shared::link::telemetry::Counters;

/// Requests of a poll, which a display makes once a second. Their answers also reveal restarts; the greeting comes first and gives the
/// cause.
pub const POLLED: [Request; 7] = [
    Request::Identify,
    Request::Telemetry { on: true },
    Request::GetSettings,
    Request::GetAlarms,
    Request::GetAudio,
    Request::GetLease,
    Request::GetTiming { clear: false },
];

/// Counters of a line.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct LineCounters {
    /// Valid frames received.
    pub frames: u64,
    /// Received frames that were damaged.
    pub corrupt: u64,
    /// Number of missing telemetry batches.
    pub lost_batches: u64,
    /// The device's counters.
    pub device: Counters,
}

/// Information from the device for a monitor.
#[derive(Clone, Debug, PartialEq)]
#[expect(clippy::large_enum_variant, reason = "an event is most often a batch of samples, the largest one")]
pub enum News {
    /// An event that the device sent on its own.
    Event(Event),
    /// The answer to a request; a refusal or failure is text.
    Answer {
        /// The request.
        request: Request,
        /// Its result.
        result: Result<Response, String>,
    },
    /// State of the line's counters.
    Traffic(LineCounters),
    /// The connection was lost, with the reason; it is retried.
    Lost(String),
}
