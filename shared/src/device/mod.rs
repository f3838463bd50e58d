//! A ventilator as a device at the end of a link: everything between the link's bytes, the ventilator and the
//! weights slots that is not tied to a chip.
//!
//! Two halves, which a microcontroller runs at two priorities:
//!
//! | half | runs | holds |
//! |---|---|---|
//! | [`control`] | once per control tick | ventilator, breaths that wait, breath meter, tick statistics |
//! | [`server`] | when bytes or reports are there | requests and their answers, telemetry batches, uploads |
//!
//! The server sends the control half one [`ControlRequest`] at a time and gets a [`ControlReply`] to each; unasked, the control
//! half sends [`ControlReport`]s. Neither half waits: the caller moves requests, replies and reports between them.

pub mod control;
pub mod server;
mod upload;

#[cfg(test)]
mod tests;

use crate::control::pid::PidGains;
use crate::explore::Exploration;
use crate::link::messages::{ControllerChoice, Response};
use crate::link::telemetry::{BreathSummary, Counters};
use crate::safety::alarms::Fault;
use crate::settings::Settings;
use crate::ventilator::{Mode, Sample};

/// Gains of a device that was told none and holds no weights: good on a lung of R 20 cmH2O/(L/s) and C 20 mL/cmH2O, and safe
/// to explore around; on a stiff lung of low resistance they ring.
pub const KNOWN_GOOD: PidGains = PidGains { p: 3.0, i: 30.0, d: 0.0 };

/// A request of the server to the control half.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum ControlRequest {
    /// Report the status. Answered by [`ControlReply::Status`].
    Status,
    /// Report the settings in force and those that wait.
    Settings,
    /// Settings for the next breath, in place of all that wait.
    Apply(Settings),
    /// Settings for one of the next breaths.
    Queue(Settings),
    /// Start ventilation.
    Start,
    /// Stop ventilation.
    Stop,
    /// Leave the latched safe state.
    Acknowledge,
    /// Another controller from the next breath on.
    Controller(ControllerChoice),
    /// Other exploration from the next breath on.
    Exploration(Option<Exploration>),
    /// Statistics of the ticks.
    Timing {
        /// Clear them?
        clear: bool,
    },
    /// At the next start the plant restarts with this seed.
    ResetPlant(u64),
}

/// The control half's answer to a request.
#[derive(Clone, Debug, PartialEq)]
pub enum ControlReply {
    /// For the host, as it is.
    Response(Response),
    /// For the server.
    Status(Status),
}

/// Status of the control half.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Status {
    /// Mode of the ventilator.
    pub mode: Mode,
    /// The controller that runs, or will from the next breath on.
    pub controller: ControllerChoice,
    /// The exploration in force, or from the next breath on.
    pub exploration: Option<Exploration>,
}

/// An unasked report of the control half.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum ControlReport {
    /// A tick of a breath.
    Sample {
        /// Control tick since power-up.
        tick: u64,
        /// Its sample.
        sample: Sample,
    },
    /// A breath has ended.
    Breath(BreathSummary),
    /// A monitor has raised an alarm; [`crate::safety::alarms::ALARMS`] lists the response to each.
    Alarm {
        /// Which.
        fault: Fault,
        /// Control tick since power-up.
        tick: u64,
    },
    /// Ventilation has stopped.
    Stopped,
    /// The counters of the control half; `corrupt_frames` is the server's to fill in.
    Counters(Counters),
}
