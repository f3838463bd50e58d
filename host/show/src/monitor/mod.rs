//! `trainer monitor`: shows an operator the state of a running device, and turns keys into requests.
//!
//! A view neither talks to a device nor reads a clock: it takes [`News`] and returns requests. The same news always
//! give the same picture, so pictures can be tested.

pub mod capture;
pub mod draw;
pub mod plain;
pub mod session;
pub mod terminal;
pub mod view;
pub mod window;
pub mod words;

#[cfg(test)]
mod tests;

use shared::link::messages::{Event, Request, Response};

use device::LineCounters;

/// Information from the device for a monitor.
#[derive(Clone, Debug, PartialEq)]
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
