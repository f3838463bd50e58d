//! `trainer monitor`: what an operator sees of a device that runs, and what a key asks of it.
//!
//! A view never talks to a device and knows no clock: it takes in [`News`] and gives requests. So it shows the
//! same for the same news, and each picture can be tested.

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

/// What reaches a monitor from its device.
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
