//! The messages between host and device.
//!
//! **The order of variants and fields in this file, and in the types it names, is the protocol**: postcard
//! writes a variant as its number and fields without names. Append variants at the end; any other change is a
//! new [`PROTOCOL`] version. The tests pin the bytes of every message.
//!
//! Two things never change, so that any two versions can tell each other apart: [`Request::Identify`] is
//! variant 0, and its answer begins with the protocol version ([`greeted_protocol`]).

use heapless::{String, Vec};
use serde::{Deserialize, Serialize};
use thiserror::Error;

use super::PROTOCOL;
use super::refusal::Refusal;
use super::telemetry::{BreathSummary, TelemetryBatch};
use crate::control::pid::PidGains;
use crate::explore::Exploration;
use crate::recorder::{Page, RecorderPart, RecorderStatus};
use crate::reset::ResetCause;
use crate::safety::alarms::Fault;
use crate::settings::Settings;
use crate::timing::TickTimes;
use crate::ventilator::Mode;
use crate::weights::slots::{Slot, SlotState};

/// Most bytes of an image in one chunk.
pub const CHUNK_BYTES: usize = 128;
/// Longest text about a failure, bytes.
pub const FAILURE_BYTES: usize = 120;

/// Host to device.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ToDevice {
    /// Chosen by the host, returned with the answer.
    pub sequence: u16,
    /// The request.
    pub request: Request,
}

/// A request of the host.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum Request {
    /// Report the identity. Answered by [`Response::Identity`].
    Identify,
    /// Answered by [`Response::Settings`].
    GetSettings,
    /// Settings for the next breath; answered by [`Response::Settings`].
    ApplySettings(Settings),
    /// Starts ventilation; answered by [`Response::Mode`].
    Start,
    /// Stops ventilation; answered by [`Response::Mode`].
    Stop,
    /// Leaves the latched safe state for standby; answered by [`Response::Mode`].
    Acknowledge,
    /// Answered by [`Response::Controller`].
    SetController(ControllerChoice),
    /// Answered by [`Response::Exploration`].
    SetExploration(Option<Exploration>),
    /// Switches telemetry; answered by [`Response::Telemetry`].
    Telemetry {
        /// Send batches?
        on: bool,
    },
    /// Begins an upload; answered by [`Response::Progress`]. Not while ventilating.
    BeginWeights {
        /// Bytes of the image.
        length: u32,
        /// The image's id: the checksum at its end.
        id: u32,
    },
    /// Next bytes of the image; answered by [`Response::Progress`].
    WeightsChunk {
        /// Place of the first byte in the image.
        offset: u32,
        /// The bytes.
        bytes: Vec<u8, CHUNK_BYTES>,
    },
    /// Validates and stores the image; answered by [`Response::Weights`].
    CommitWeights,
    /// Restarts the device; answered by [`Response::Done`] before it does. Not while ventilating.
    Reset,
    /// Settings for one of the next breaths: each breath that starts takes the oldest ones waiting, and the last ones
    /// stay in force. So a sequence of breaths does not depend on how fast the host is. Answered by
    /// [`Response::Queued`].
    QueueSettings(Settings),
    /// Statistics of the control ticks; answered by [`Response::Timing`].
    GetTiming {
        /// Clear them?
        clear: bool,
    },
    /// At the next start of ventilation the plant restarts with this seed of its random numbers; answered by
    /// [`Response::Done`]. Only with hardware in the loop.
    ResetPlant {
        /// The seed.
        seed: u64,
    },
    /// Status of the flight recorder; answered by [`Response::Recorder`].
    GetRecorder,
    /// Entries of the flight recorder; answered by [`Response::Recorded`].
    ReadRecorder {
        /// The part.
        part: RecorderPart,
        /// Number of the first entry.
        from: u32,
    },
    /// Empties the flight recorder's ticks with the next control tick; its log stays. Answered by [`Response::Done`].
    ClearRecorder,
}

/// Which controller to run.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub enum ControllerChoice {
    /// PID with these gains.
    Pid(PidGains),
    /// The stored weights.
    Learned,
}

/// Device to host.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[expect(clippy::large_enum_variant, reason = "a batch is most of the traffic, and nothing may allocate")]
pub enum ToHost {
    /// Answer to a request.
    Response {
        /// The request's.
        sequence: u16,
        /// The answer.
        response: Response,
    },
    /// Unasked.
    Event(Event),
}

/// A device's answer: the value in force after the request.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum Response {
    /// Identity of the device and its state.
    Identity(DeviceIdentity),
    /// Settings.
    Settings {
        /// Of the running breath.
        in_force: Settings,
        /// Of the next breath, if different ones wait.
        pending: Option<Settings>,
    },
    /// Mode of the ventilator.
    Mode(Mode),
    /// The controller that runs.
    Controller(ControllerChoice),
    /// The device's exploration.
    Exploration(Option<Exploration>),
    /// Whether telemetry is sent.
    Telemetry {
        /// Sending?
        on: bool,
    },
    /// Progress of an upload.
    Progress {
        /// First byte that is missing.
        offset: u32,
    },
    /// Weights are stored, and run when they are chosen.
    Weights {
        /// Their id.
        id: u32,
        /// Their slot.
        slot: Slot,
    },
    /// Done, and there is no value to show for it.
    Done,
    /// Not done; everything is as it was.
    Refused(Refusal),
    /// Settings wait for their breath.
    Queued {
        /// Room left for this many more.
        free: u8,
    },
    /// Statistics of the control ticks.
    Timing(TickTimes),
    /// Status of the flight recorder.
    Recorder(RecorderStatus),
    /// Entries of the flight recorder.
    Recorded(Page),
}

/// The greeting.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct DeviceIdentity {
    /// [`PROTOCOL`] of the device.
    pub protocol: u16,
    /// Version of the firmware: major, minor, patch.
    pub firmware: [u16; 3],
    /// Kind of the device.
    pub device: DeviceKind,
    /// Control period, microseconds.
    pub period_us: u32,
    /// Mode of the ventilator.
    pub mode: Mode,
    /// The controller that runs.
    pub controller: ControllerChoice,
    /// Its exploration.
    pub exploration: Option<Exploration>,
    /// Content of each weights slot, in the order of [`Slot`].
    pub slots: [SlotState; 2],
    /// The slot whose weights run when they are chosen, if one holds valid ones.
    pub running: Option<Slot>,
    /// Cause of the start.
    pub reset: ResetCause,
    /// Message of the failure before the start, if there was one.
    pub failure: Option<String<FAILURE_BYTES>>,
}

impl DeviceIdentity {
    /// Id of the weights that were loaded at the start.
    pub fn running_id(&self) -> Option<u32> {
        self.slots[self.running? as usize].id()
    }
}

/// Kind of a device.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum DeviceKind {
    /// A ventilator: real sensor, real valves.
    Ventilator,
    /// A microcontroller whose sensor and valves are the [`super::plant_link`].
    HardwareInTheLoop,
    /// A program on a computer.
    Simulated,
}

/// An unasked message of the device.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[expect(clippy::large_enum_variant, reason = "a batch is most of the traffic, and nothing may allocate")]
pub enum Event {
    /// Samples.
    Telemetry(TelemetryBatch),
    /// A breath has ended.
    Breath(BreathSummary),
    /// A fault has latched.
    Alarm {
        /// Which.
        fault: Fault,
        /// Control tick since power-up.
        tick: u64,
    },
}

/// A frame that arrived whole but holds no message of this version.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
#[error("frame holds no message of protocol {PROTOCOL}; update the older side")]
pub struct Unreadable {
    /// Sequence number to refuse the request under, if it can be read.
    pub sequence: Option<u16>,
}

impl Unreadable {
    /// The answer to the host, if the request's sequence number could be read.
    pub fn refusal(self) -> Option<ToHost> {
        let response = Response::Refused(Refusal::UnknownRequest);
        self.sequence.map(|sequence| ToHost::Response { sequence, response })
    }
}

/// Reads a frame's content on the device.
///
/// # Errors
/// [`Unreadable`]; answer with [`Unreadable::refusal`].
pub fn read_request(content: &[u8]) -> Result<ToDevice, Unreadable> {
    whole(content).ok_or_else(|| Unreadable {
        sequence: postcard::take_from_bytes(content).ok().map(|(sequence, _)| sequence),
    })
}

/// Reads a frame's content on the host.
///
/// # Errors
/// [`Unreadable`]; [`greeted_protocol`] tells whether it is a greeting of another version.
pub fn read_reply(content: &[u8]) -> Result<ToHost, Unreadable> {
    whole(content).ok_or(Unreadable { sequence: None })
}

/// Protocol version in a greeting of any version; none if the content is something else.
pub fn greeted_protocol(content: &[u8]) -> Option<u16> {
    let ((response, _, identity, protocol), _): ((u8, u16, u8, u16), _) =
        postcard::take_from_bytes(content).ok()?;
    (response == 0 && identity == 0).then_some(protocol)
}

/// A message that fills its content exactly.
fn whole<'a, M: Deserialize<'a>>(content: &'a [u8]) -> Option<M> {
    let (message, rest) = postcard::take_from_bytes(content).ok()?;
    rest.is_empty().then_some(message)
}

#[cfg(test)]
mod tests;
