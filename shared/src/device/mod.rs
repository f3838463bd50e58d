//! A ventilator as a device on a link: the chip-independent code between the link's bytes, the ventilator and the
//! weights slots.
//!
//! It has two halves, which a microcontroller runs at different priorities:
//!
//! | half | runs | contains |
//! |---|---|---|
//! | [`control`] | once per control tick | ventilator, queued breaths, breath meter, tick statistics |
//! | [`server`] | when bytes or reports arrive | requests and their answers, telemetry batches, uploads |
//!
//! [`lease`] decides which host may change the device, and [`self_test`] whether ventilation may start. [`annunciator`] drives
//! sounder and lamps. [`prescription`] keeps the settings of a running ventilation through a reset or a power cut, and [`absence`]
//! measures how long the latter was.
//!
//! The server sends one [`ControlRequest`] at a time to the control half and gets one [`ControlReply`]; the control half also
//! sends unrequested [`ControlReport`]s. Neither half blocks: the caller passes requests, replies and reports between them.

pub mod absence;
mod alarm_events;
pub mod annunciator;
pub mod control;
pub mod lease;
pub mod prescription;
pub mod self_test;
pub mod server;
mod upload;

#[cfg(test)]
mod tests;

use crate::calibration::SensorCorrection;
pub use crate::control::pid::KNOWN_GOOD;
use crate::explore::Exploration;
use crate::explore::sines::SineSweep;
use crate::link::messages::{ControllerChoice, Response};
use crate::link::telemetry::{BreathSummary, Counters};
use crate::recorder::keeper::Leave;
use crate::safety::alarms::Fault;
use crate::settings::Settings;
use crate::ventilator::{Mode, Sample};
pub use alarm_events::REPEAT_TIME;
use self_test::Check;

/// A request from the server to the control half.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum ControlRequest {
    /// Report the status. Answered by [`ControlReply::Status`].
    Status,
    /// Report the settings in force and the pending ones.
    Settings,
    /// Use these settings from the next breath on; they replace all pending ones.
    Apply(Settings),
    /// Append settings to the queue: each breath that starts takes one entry.
    Queue(Settings),
    /// Start ventilation.
    Start,
    /// Stop ventilation.
    Stop,
    /// Acknowledge all alarms, and leave the latched safe state.
    Acknowledge,
    /// Use this controller from the next breath on.
    Controller(ControllerChoice),
    /// Use this exploration from the next breath on.
    Exploration(Option<Exploration>),
    /// Report the statistics of the ticks.
    Timing {
        /// Whether to clear them afterwards.
        clear: bool,
    },
    /// Restart the plant with this seed at the next start of ventilation.
    ResetPlant(u64),
    /// Report the alarms and the level of the ladder.
    Alarms,
    /// Pause the sounder for this many seconds; 0 ends the pause.
    PauseAudio(u16),
    /// Report the state of the sounder.
    Audio,
    /// Begin a check of the self-test, if one is named, and report its results.
    SelfTest(Option<Check>),
    /// Correct the airway sensor's readings from the next start of ventilation on. Answered by [`ControlReply::Status`].
    Calibrate(SensorCorrection),
    /// Add this sweep of sines from the next breath on.
    Sweep(Option<SineSweep>),
}

/// What the host that sends a request is to the running ventilation, for the watch that finds it silent.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum HostRole {
    /// It holds the lease or held it last, or it has started the exploration.
    Steers,
    /// It only reads, and no host is missing: none has steered yet, or the last one has given the lease back.
    Attends,
    /// It only reads; another host steers, or has fallen silent.
    Reads,
}

/// The control half's answer to a request.
#[derive(Clone, Debug, PartialEq)]
pub enum ControlReply {
    /// An answer for the host.
    Response(Response),
    /// The status, which the server needs for its own answer.
    Status(Status),
}

/// Status of the control half.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Status {
    /// Mode of the ventilator.
    pub mode: Mode,
    /// Whether a check of the self-test moves the valves.
    pub moves_valves: bool,
    /// Whether a ventilation that a reset has interrupted waits to resume.
    pub resumes: bool,
    /// The controller that runs, at the latest from the next breath on.
    pub controller: ControllerChoice,
    /// The exploration in force, at the latest from the next breath on.
    pub exploration: Option<Exploration>,
    /// The same of a sweep of sines, which takes the exploration's place.
    pub sweep: Option<SineSweep>,
}

impl Status {
    /// What may be done to the flash: nothing while the device ventilates or is about to, or a check moves its valves, and no
    /// erase in the safe state, which an operator wants to leave without delay.
    #[inline]
    pub fn leave(&self) -> Leave {
        match self.mode {
            Mode::Ventilating => Leave::Nothing,
            _ if self.moves_valves || self.resumes => Leave::Nothing,
            Mode::Fault(_) => Leave::Write,
            Mode::Standby => Leave::Erase,
        }
    }
}

/// An unrequested report of the control half.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum ControlReport {
    /// The sample of a tick of a breath.
    Sample {
        /// Control tick since the device started.
        tick: u64,
        /// The sample.
        sample: Sample,
    },
    /// A breath has ended.
    Breath(BreathSummary),
    /// A monitor has raised an alarm; [`crate::safety::alarms::ALARMS`] lists the response to each.
    Alarm {
        /// The alarm's fault.
        fault: Fault,
        /// Control tick since the device started.
        tick: u64,
    },
    /// An alarm has not been acknowledged yet; repeated after its [`ControlReport::Alarm`].
    Unacknowledged {
        /// The alarm's fault.
        fault: Fault,
        /// Control tick at which it began.
        tick: u64,
    },
    /// Ventilation has stopped.
    Stopped,
    /// The counters of the control half; the server fills in `corrupt_frames`.
    Counters(Counters),
}
