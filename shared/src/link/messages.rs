//! The messages between host and device.
//!
//! **The order of variants and fields in this file, and in the types used here, is the protocol**: postcard
//! writes a variant as its number, and fields without names. Append variants at the end; any other change needs a
//! new [`PROTOCOL`] version. Tests pin the bytes of every message.
//!
//! Two things never change, so that each side can recognise another version: [`Request::Identify`] is variant 0, and
//! its answer begins with the protocol version ([`greeted_protocol`]).

use heapless::{String, Vec};
use serde::{Deserialize, Serialize};
use thiserror::Error;

use super::PROTOCOL;
use super::host_name::HostName;
use super::refusal::Refusal;
use super::self_test::{Check, Report};
use super::telemetry::{BreathSummary, TelemetryBatch};
use crate::calibration::Calibration;
use crate::control::pid::PidGains;
use crate::explore::Exploration;
use crate::explore::sines::SineSweep;
use crate::recorder::{Page, RecorderPart, RecorderStatus};
use crate::reset::ResetCause;
use crate::safety::alarms::{Fault, Priority};
use crate::safety::indications::FaultSet;
use crate::safety::ladder::Level;
use crate::settings::Settings;
use crate::timing::TickTimes;
use crate::ventilator::Mode;
use crate::weights::slots::{Slot, SlotState};
use crate::weights::trust::KeyId;

/// Most image bytes in one chunk.
pub const CHUNK_BYTES: usize = 128;
/// Longest failure message, bytes.
pub const FAILURE_BYTES: usize = 120;

/// Message from host to device.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ToDevice {
    /// Chosen by the host and repeated in the answer.
    pub sequence: u16,
    /// The request.
    pub request: Request,
    /// Random number that identifies the host, for the lease; not sent by a host that only reads.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub host: Option<u32>,
}

/// A request of the host.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum Request {
    /// Report the identity. Answered by [`Response::Identity`].
    Identify,
    /// Reports the settings; answered by [`Response::Settings`].
    GetSettings,
    /// Sets the settings of the next breath; answered by [`Response::Settings`].
    ApplySettings(Settings),
    /// Starts ventilation; answered by [`Response::Mode`].
    Start,
    /// Stops ventilation; answered by [`Response::Mode`].
    Stop,
    /// Acknowledges all alarms, and leaves the latched safe state for standby; answered by [`Response::Mode`].
    Acknowledge,
    /// Sets the controller from the next breath on; answered by [`Response::Controller`].
    SetController(ControllerChoice),
    /// Sets the exploration from the next breath on; answered by [`Response::Exploration`].
    SetExploration(Option<Exploration>),
    /// Switches telemetry; answered by [`Response::Telemetry`].
    Telemetry {
        /// Whether to send batches.
        on: bool,
    },
    /// Begins an upload, of weights or of the description of a bench; answered by [`Response::Progress`]. Not while ventilating.
    BeginWeights {
        /// Length, bytes; that of weights is [`IMAGE_BYTES`](crate::weights::IMAGE_BYTES), others are shorter.
        length: u32,
        /// Id: the checksum at the end of the image, or that of a description.
        id: u32,
    },
    /// Transfers the next bytes of the image; answered by [`Response::Progress`].
    WeightsChunk {
        /// Offset of the first byte in the image.
        offset: u32,
        /// Bytes of the image.
        bytes: Vec<u8, CHUNK_BYTES>,
    },
    /// Validates and stores the image; answered by [`Response::Weights`]. Not while ventilating.
    CommitWeights,
    /// Restarts the device, which answers [`Response::Done`] first. Not while ventilating.
    Reset,
    /// Queues settings: each breath that starts takes the oldest entry, and the last entry stays in force. So a
    /// sequence of breaths does not depend on the speed of the host. Answered by [`Response::Queued`].
    QueueSettings(Settings),
    /// Reports the statistics of the control ticks; answered by [`Response::Timing`].
    GetTiming {
        /// Whether to clear them afterwards.
        clear: bool,
    },
    /// Restarts the plant with this random seed at the next start of ventilation; answered by [`Response::Done`]. Not
    /// on a device with real valves.
    ResetPlant {
        /// Random seed.
        seed: u64,
    },
    /// Reports the status of the flight recorder; answered by [`Response::Recorder`].
    GetRecorder,
    /// Reads entries of the flight recorder; answered by [`Response::Recorded`].
    ReadRecorder {
        /// Part of the recorder.
        part: RecorderPart,
        /// Number of the first entry.
        from: u32,
    },
    /// Clears the flight recorder's ticks in the next control tick; the log stays. Answered by [`Response::Done`].
    ClearRecorder,
    /// Reports the alarms and the level of the ladder; answered by [`Response::Alarms`].
    GetAlarms,
    /// Pauses the sounder; the lamps stay. Answered by [`Response::Audio`].
    PauseAudio {
        /// Length of the pause, s, at most [`AUDIO_PAUSE_MAX`](super::refusal::AUDIO_PAUSE_MAX); 0 ends a pause.
        seconds: u16,
    },
    /// Reports the state of the sounder; answered by [`Response::Audio`].
    GetAudio,
    /// Reports the results of the self-test; answered by [`Response::SelfTest`].
    GetSelfTest,
    /// Begins a check of the self-test, in standby; answered by [`Response::SelfTest`].
    RunSelfTest(Check),
    /// Acquires the lease, without which no host changes anything ([`crate::device::lease`]); answered by
    /// [`Response::Lease`].
    AcquireLease {
        /// The host's name, which other hosts are told.
        name: HostName,
        /// Whether to take it from another host: only if a person asks for that.
        take_over: bool,
    },
    /// Gives the lease back; answered by [`Response::Lease`].
    ReleaseLease,
    /// Reports who steers; answered by [`Response::Lease`].
    GetLease,
    /// Stores a calibration, which corrects the readings from the next start of ventilation on; answered by
    /// [`Response::Calibration`]. Only in standby.
    StoreCalibration(Calibration),
    /// Reports a stored calibration; answered by [`Response::Calibration`].
    GetCalibration {
        /// 0 for the newest, 1 for the one before, and so on.
        back: u16,
    },
    /// Simulates the bench whose description was uploaded; its id is the CRC-32 of the bytes. Answered by [`Response::Done`]. Only on
    /// a [`DeviceKind::Desk`], in standby.
    CommitBench,
    /// Sets the sweep of sines from the next breath on, in place of the exploration; answered by [`Response::Sweep`].
    SetSweep(Option<SineSweep>),
}

impl Request {
    /// Whether the request changes something, and therefore needs the lease. Every kind that is not named here does.
    pub fn changes(&self) -> bool {
        !matches!(
            self,
            Self::Identify
                | Self::GetSettings
                | Self::GetAlarms
                | Self::GetAudio
                | Self::GetSelfTest
                | Self::GetTiming { clear: false }
                | Self::GetRecorder
                | Self::ReadRecorder { .. }
                | Self::Telemetry { on: true }
                | Self::AcquireLease { .. }
                | Self::ReleaseLease
                | Self::GetLease
                | Self::GetCalibration { .. }
        )
    }
}

/// Choice of the controller.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub enum ControllerChoice {
    /// PID with these gains.
    Pid(PidGains),
    /// The learned controller, with the weights loaded at the start.
    Learned,
}

/// Message from device to host.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[expect(clippy::large_enum_variant, reason = "a batch is most of the traffic, and nothing may allocate")]
pub enum ToHost {
    /// Answer to a request.
    Response {
        /// Sequence number of the request.
        sequence: u16,
        /// The answer.
        response: Response,
    },
    /// Unrequested message.
    Event(Event),
}

/// Answer of a device: the value in force after the request.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum Response {
    /// Identity of the device and its state.
    Identity(DeviceIdentity),
    /// Settings in force and pending.
    Settings {
        /// Settings of the running breath.
        in_force: Settings,
        /// Settings that wait for the next breath, if any.
        pending: Option<Settings>,
    },
    /// Mode of the ventilator.
    Mode(Mode),
    /// The controller, in force from the next breath on.
    Controller(ControllerChoice),
    /// The exploration, in force from the next breath on.
    Exploration(Option<Exploration>),
    /// Whether telemetry is sent.
    Telemetry {
        /// Whether batches are sent.
        on: bool,
    },
    /// Progress of an upload.
    Progress {
        /// Offset of the first missing byte.
        offset: u32,
    },
    /// Weights are stored; they are loaded at the next start.
    Weights {
        /// Id of the weights.
        id: u32,
        /// Slot in which they are stored.
        slot: Slot,
    },
    /// Done; there is no value to return.
    Done,
    /// Refused; nothing has changed.
    Refused(Refusal),
    /// Settings are queued.
    Queued {
        /// Number of free places in the queue.
        free: u8,
    },
    /// Statistics of the control ticks.
    Timing(TickTimes),
    /// Status of the flight recorder.
    Recorder(RecorderStatus),
    /// Entries of the flight recorder.
    Recorded(Page),
    /// Alarms, and the level of the ladder.
    Alarms(AlarmStatus),
    /// State of the sounder.
    Audio(AudioStatus),
    /// Results of the self-test.
    SelfTest(Report),
    /// Who steers.
    Lease(LeaseStatus),
    /// A stored calibration.
    Calibration {
        /// Number of stored calibrations.
        stored: u16,
        /// The calibration; none if there are fewer.
        calibration: Option<Calibration>,
    },
    /// The sweep of sines, in force from the next breath on; an alarm ends it.
    Sweep(Option<SineSweep>),
}

/// Who steers a device.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct LeaseStatus {
    /// The host that holds the lease, if any.
    pub holder: Option<HostName>,
    /// Whether that is the host that asks.
    pub yours: bool,
}

/// The alarms of a device, and what commands its inspiratory valve because of them.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct AlarmStatus {
    /// Alarms whose condition holds.
    pub present: FaultSet,
    /// Alarms that are indicated: present, or not yet acknowledged.
    pub indicated: FaultSet,
    /// Level of the ladder of trust.
    pub level: Level,
}

/// State of the sounder of a device.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct AudioStatus {
    /// Priority of the most urgent alarm that nobody has acknowledged; it sounds unless paused.
    pub priority: Option<Priority>,
    /// Rest of the audio pause, s, rounded up; 0 without one.
    pub pause_left: u16,
}

/// The greeting: identity and state of a device.
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
    /// The controller that runs, at the latest from the next breath on.
    pub controller: ControllerChoice,
    /// The exploration, in force at the latest from the next breath on.
    pub exploration: Option<Exploration>,
    /// Content of each weights slot, in the order of [`Slot`].
    pub slots: [SlotState; 2],
    /// Slot from which the weights were loaded at the start, if it was valid.
    pub running: Option<Slot>,
    /// Cause of the start.
    pub reset: ResetCause,
    /// Message of the failure that caused the restart, if there was one.
    pub failure: Option<String<FAILURE_BYTES>>,
    /// Id of the key with which weights must be signed; none for a development build, which accepts unsigned ones.
    pub weights_key: Option<KeyId>,
}

impl DeviceIdentity {
    /// Id of the valid weights in the slot that was loaded at the start.
    pub fn running_id(&self) -> Option<u32> {
        self.slots[self.running? as usize].id()
    }
}

/// Kind of a device.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum DeviceKind {
    /// A ventilator with real sensors and valves.
    Ventilator,
    /// A microcontroller with the [`super::plant_link`] in place of sensors and valves.
    HardwareInTheLoop,
    /// A program on a computer.
    Simulated,
    /// A ventilator with the firmware of a third party, which may know only a part of the requests.
    ThirdParty,
    /// A microcontroller that simulates sensors, valves and lung itself.
    Desk,
}

impl DeviceKind {
    /// Whether its plant is simulated, so that [`Request::ResetPlant`] restarts it.
    pub fn has_simulated_plant(self) -> bool {
        matches!(self, Self::HardwareInTheLoop | Self::Simulated | Self::Desk)
    }
}

/// An unrequested message of the device.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[expect(clippy::large_enum_variant, reason = "a batch is most of the traffic, and nothing may allocate")]
pub enum Event {
    /// A batch of samples.
    Telemetry(TelemetryBatch),
    /// A breath has ended.
    Breath(BreathSummary),
    /// A monitor has raised an alarm.
    Alarm {
        /// The alarm's fault.
        fault: Fault,
        /// Control tick since the device started.
        tick: u64,
    },
    /// An alarm that nobody has acknowledged; repeated for a host that missed its [`Event::Alarm`].
    Unacknowledged {
        /// The alarm's fault.
        fault: Fault,
        /// Control tick at which it began, as in its [`Event::Alarm`].
        tick: u64,
    },
}

/// An undamaged frame that contains no message of this version.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
#[error("the frame contains no message of protocol {PROTOCOL}; update the older side")]
pub struct Unreadable {
    /// Sequence number for the refusal, if it can be read.
    pub sequence: Option<u16>,
}

impl Unreadable {
    /// The refusal to send to the host, if the request's sequence number could be read.
    pub fn refusal(self) -> Option<ToHost> {
        let response = Response::Refused(Refusal::UnknownRequest);
        self.sequence.map(|sequence| ToHost::Response { sequence, response })
    }
}

/// Decodes a frame's content on the device.
///
/// # Errors
/// [`Unreadable`]; answer with [`Unreadable::refusal`].
pub fn read_request(content: &[u8]) -> Result<ToDevice, Unreadable> {
    request_of(content).ok_or_else(|| Unreadable {
        sequence: postcard::take_from_bytes(content).ok().map(|(sequence, _)| sequence),
    })
}

/// The request in a whole content, with or without the host's token.
fn request_of(content: &[u8]) -> Option<ToDevice> {
    let ((sequence, request), token) = postcard::take_from_bytes(content).ok()?;
    let host = if token.is_empty() { None } else { Some(whole::<Option<u32>>(token)??) };
    Some(ToDevice { sequence, request, host })
}

/// Decodes a frame's content on the host.
///
/// # Errors
/// [`Unreadable`]; [`greeted_protocol`] recognises a greeting of another version.
pub fn read_reply(content: &[u8]) -> Result<ToHost, Unreadable> {
    whole(content).ok_or(Unreadable { sequence: None })
}

/// Protocol version in a greeting of any version; none for any other content.
pub fn greeted_protocol(content: &[u8]) -> Option<u16> {
    let ((response, _, identity, protocol), _): ((u8, u16, u8, u16), _) =
        postcard::take_from_bytes(content).ok()?;
    (response == 0 && identity == 0).then_some(protocol)
}

/// Decodes a message that takes up the whole content.
fn whole<'a, M: Deserialize<'a>>(content: &'a [u8]) -> Option<M> {
    let (message, rest) = postcard::take_from_bytes(content).ok()?;
    rest.is_empty().then_some(message)
}

#[cfg(test)]
mod tests;
