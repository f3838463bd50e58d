//! What reaches a monitor from its device.

use shared::link::messages::{Event, Request, Response};

use device::LineCounters;

/// One piece of news.
#[derive(Clone, Debug, PartialEq)]
pub enum News {
    /// The device told it unasked.
    Event(Event),
    /// A request was answered; a refusal and a failure are text.
    Answer {
        /// What was asked.
        request: Request,
        /// What came.
        result: Result<Response, String>,
    },
    /// State of the line's counters.
    Traffic(LineCounters),
    /// There is no connection, and why; it is tried again.
    Lost(String),
}
