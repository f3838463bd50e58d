//! The half of a device that serves the host: it answers requests, batches telemetry and receives uploads.
//!
//! It stores and reads in the flash through a [`Store`], and waits for nothing else: [`Server::receive`] returns a
//! [`NextStep`], and the caller passes requests to the control half until the step is an answer. [`Server::serve`] does that
//! where the control half answers at once. The server handles one request at a time.
//!
//! A host that gets no answer repeats its request with the same sequence number. The server stores its last answer and
//! sends it again, so that no request is executed twice.
//!
//! Every new request passes the control half, with the role of its host, so that the control half knows who is silent; only one
//! that cannot break a silence is answered without it.

use heapless::{String, Vec};

use super::control::Control;
use super::lease::Lease;
use super::upload::Upload;
use super::{ControlReply, ControlReport, ControlRequest, HostRole, Status};
use crate::breath::DEFAULT_PERIOD_US;
use crate::calibration::{Calibration, SensorCorrection};
use crate::link::PROTOCOL;
use crate::link::messages::{
    DeviceIdentity, DeviceKind, Event, FAILURE_BYTES, Request, Response, ToDevice, ToHost,
};
use crate::link::refusal::Refusal;
use crate::link::telemetry::{Batcher, Counters};
use crate::recorder::RecorderMemory;
use crate::recorder::keeper::Leave;
use crate::reset::ResetCause;
use crate::safety::alarms::Fault;
use crate::ventilator::Mode;
use crate::weights::IMAGE_BYTES;
use crate::weights::slots::{Slot, SlotState, StoreError};
use crate::weights::trust::Trust;

/// The part of the greeting that is fixed until the device restarts, except the slots, which a store changes.
#[derive(Clone, Debug, PartialEq)]
pub struct DeviceFacts {
    /// Version of the firmware: major, minor, patch.
    pub firmware: [u16; 3],
    /// Kind of the device.
    pub device: DeviceKind,
    /// Control period, microseconds.
    pub period_us: u32,
    /// Content of each weights slot.
    pub slots: [SlotState; 2],
    /// Slot from which the weights were loaded at the start.
    pub running: Option<Slot>,
    /// Cause of the start.
    pub reset: ResetCause,
    /// Message of the failure that caused the restart, if there was one.
    pub failure: Option<String<FAILURE_BYTES>>,
    /// Whose weights the device runs.
    pub trust: Trust,
}

impl DeviceFacts {
    /// A device after power-up, at the default control period, that holds no weights and runs any.
    pub const fn blank(device: DeviceKind) -> Self {
        Self {
            firmware: [0; 3],
            device,
            period_us: DEFAULT_PERIOD_US,
            slots: [SlotState::Empty; 2],
            running: None,
            reset: ResetCause::PowerOn,
            failure: None,
            trust: Trust::Development,
        }
    }
}

/// A device's flash, as far as a host can use it.
pub trait Store {
    /// Stores a validated image; returns its slot, and then the state of both slots.
    fn store_weights(&mut self, image: &[u8; IMAGE_BYTES]) -> (Result<Slot, StoreError>, [SlotState; 2]);

    /// Stores a calibration; returns the number of stored ones.
    ///
    /// # Errors
    /// The reason for which it was not stored.
    fn store_calibration(&mut self, calibration: &Calibration) -> Result<u16, Refusal>;

    /// Makes the simulated bench one of this description ([`Request::CommitBench`]).
    ///
    /// # Errors
    /// [`Refusal::BadBench`]; [`Refusal::NoBench`] from a device that simulates none.
    fn set_bench(&mut self, _description: &[u8]) -> Result<(), Refusal> {
        Err(Refusal::NoBench)
    }

    /// The number of stored calibrations, and one of them: 0 for the newest, 1 for the one before, and so on.
    fn calibration(&mut self, back: u16) -> (u16, Option<Calibration>);
}

/// Next step of the caller.
#[derive(Clone, Debug, PartialEq)]
#[expect(
    clippy::large_enum_variant,
    reason = "a chip has no allocator, and every request ends with the larger one"
)]
pub enum NextStep {
    /// Let the control half execute this request of a host in this role, then call [`Server::control_replied`].
    Control(ControlRequest, HostRole),
    /// Send this answer.
    Answer(Answer),
}

/// The answer to a request.
#[derive(Clone, Debug, PartialEq)]
pub struct Answer {
    /// The message to send.
    pub message: ToHost,
    /// Whether to restart once it is sent completely.
    pub restart: bool,
}

/// Use of the control half's reply.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Continuation {
    /// Forward the reply to the host.
    Forward,
    /// Send the last answer: the control half was only to hear the host.
    Answered,
    /// Complete the greeting with the reply.
    Greet,
    /// Begin an upload, unless the device ventilates.
    Begin { length: u32, id: u32 },
    /// Validate and store the upload, unless the device ventilates.
    Commit,
    /// Take over the upload as the description of a bench, in standby.
    CommitBench,
    /// Store a calibration in standby.
    StoreCalibration(Calibration),
    /// Report the calibration that the control half has taken over.
    Calibrated { stored: u16, calibration: Calibration },
    /// Restart, unless the device ventilates.
    Restart,
}

/// The server half of a device.
#[derive(Clone, Debug)]
pub struct Server<'a> {
    facts: DeviceFacts,
    recorder: &'a RecorderMemory,
    telemetry: bool,
    batcher: Batcher,
    counters: Counters,
    upload: Upload,
    lease: Lease,
    /// Token of the host that has started the exploration or the sweep.
    explorer: Option<u32>,
    sequence: u16,
    continuation: Continuation,
    /// Sequence number, host and answer of the last request.
    last: Option<(u16, Option<u32>, Response)>,
    host: Option<u32>,
}

impl<'a> Server<'a> {
    /// A server before the first request; `recorder` is the flight recorder's memory, which the host can read.
    pub fn new(facts: DeviceFacts, recorder: &'a RecorderMemory) -> Self {
        Self {
            lease: Lease::new(facts.period_us),
            facts,
            recorder,
            telemetry: false,
            batcher: Batcher::default(),
            counters: Counters::default(),
            upload: Upload::new(),
            explorer: None,
            sequence: 0,
            continuation: Continuation::Forward,
            last: None,
            host: None,
        }
    }

    /// Sets the number of corrupt frames from the host, for the telemetry.
    pub fn corrupt_frames(&mut self, count: u32) {
        self.counters.corrupt_frames = count;
    }

    /// Handles a request up to its answer, with a control half that answers at once. Arguments as in [`Self::receive`].
    pub fn serve(
        &mut self,
        message: &ToDevice,
        tick: u32,
        control: &mut Control,
        store: &mut impl Store,
    ) -> Answer {
        let mut step = self.receive(message, tick, store);
        loop {
            step = match step {
                NextStep::Control(request, role) => {
                    self.control_replied(control.execute_for(&request, role), store)
                }
                NextStep::Answer(answer) => return answer,
            };
        }
    }

    /// Handles a request that arrives at a control tick; the number of the tick may wrap.
    pub fn receive(&mut self, message: &ToDevice, tick: u32, store: &mut impl Store) -> NextStep {
        let ToDevice { sequence, request, host } = message;
        self.lease.heard(*host, tick);
        let is_repeated = self.last.as_ref().is_some_and(|last| (last.0, last.1) == (*sequence, *host));
        if is_repeated && *request != Request::Identify {
            return self.answer_again();
        }
        (self.sequence, self.host) = (*sequence, *host);
        let step = self.begin(request, tick, store);
        match (step, self.role()) {
            (NextStep::Answer(_), role @ (HostRole::Steers | HostRole::Attends)) => {
                self.continuation = Continuation::Answered;
                NextStep::Control(ControlRequest::Status, role)
            }
            (step, _) => step,
        }
    }

    /// Begins a new request.
    fn begin(&mut self, request: &Request, tick: u32, store: &mut impl Store) -> NextStep {
        if let Err(refusal) = self.permits(request) {
            return self.send(Err(refusal));
        }
        let (continuation, control_request) = match request {
            Request::Identify => (Continuation::Greet, ControlRequest::Status),
            Request::GetSettings => (Continuation::Forward, ControlRequest::Settings),
            Request::ApplySettings(settings) => (Continuation::Forward, ControlRequest::Apply(*settings)),
            Request::QueueSettings(settings) => (Continuation::Forward, ControlRequest::Queue(*settings)),
            Request::Start => (Continuation::Forward, ControlRequest::Start),
            Request::Stop => (Continuation::Forward, ControlRequest::Stop),
            Request::Acknowledge => (Continuation::Forward, ControlRequest::Acknowledge),
            Request::GetAlarms => (Continuation::Forward, ControlRequest::Alarms),
            Request::PauseAudio { seconds } => (Continuation::Forward, ControlRequest::PauseAudio(*seconds)),
            Request::GetAudio => (Continuation::Forward, ControlRequest::Audio),
            Request::GetSelfTest => (Continuation::Forward, ControlRequest::SelfTest(None)),
            Request::RunSelfTest(check) => (Continuation::Forward, ControlRequest::SelfTest(Some(*check))),
            Request::SetController(choice) => (Continuation::Forward, ControlRequest::Controller(*choice)),
            Request::SetExploration(choice) => (Continuation::Forward, ControlRequest::Exploration(*choice)),
            Request::SetSweep(sweep) => (Continuation::Forward, ControlRequest::Sweep(*sweep)),
            Request::GetTiming { clear } => (Continuation::Forward, ControlRequest::Timing { clear: *clear }),
            Request::ResetPlant { seed } => (Continuation::Forward, ControlRequest::ResetPlant(*seed)),
            Request::BeginWeights { length, id } => {
                (Continuation::Begin { length: *length, id: *id }, ControlRequest::Status)
            }
            Request::CommitWeights => (Continuation::Commit, ControlRequest::Status),
            Request::CommitBench => (Continuation::CommitBench, ControlRequest::Status),
            Request::StoreCalibration(calibration) => {
                (Continuation::StoreCalibration(*calibration), ControlRequest::Status)
            }
            Request::GetCalibration { back } => {
                let (stored, calibration) = store.calibration(*back);
                return self.send(Ok(Response::Calibration { stored, calibration }));
            }
            Request::Reset => (Continuation::Restart, ControlRequest::Status),
            Request::GetRecorder => return self.send(Ok(Response::Recorder(self.recorder.status()))),
            Request::ReadRecorder { part, from } => {
                return self.send(Ok(Response::Recorded(self.recorder.page(*part, *from))));
            }
            Request::ClearRecorder => {
                self.recorder.request_clear();
                return self.send(Ok(Response::Done));
            }
            Request::WeightsChunk { offset, bytes } => {
                let progress = self.upload.chunk(*offset, bytes).map(|offset| Response::Progress { offset });
                return self.send(progress);
            }
            Request::Telemetry { on } => {
                self.telemetry = *on;
                return self.send(Ok(Response::Telemetry { on: *on }));
            }
            Request::AcquireLease { name, take_over } => {
                let status = self.lease.acquire(self.host, *name, *take_over, tick);
                return self.send(status.map(Response::Lease));
            }
            Request::ReleaseLease => {
                let status = self.lease.release(self.host);
                return self.send(Ok(Response::Lease(status)));
            }
            Request::GetLease => return self.send(Ok(Response::Lease(self.lease.status(self.host)))),
        };
        self.continuation = continuation;
        NextStep::Control(control_request, self.role())
    }

    /// What the host of the request is to the ventilation.
    fn role(&self) -> HostRole {
        let explores = self.host.is_some() && self.host == self.explorer;
        if explores { HostRole::Steers } else { self.lease.role(self.host) }
    }

    /// Whether the lease allows a request of the host.
    fn permits(&self, request: &Request) -> Result<(), Refusal> {
        match (self.lease.permits(self.host), request) {
            _ if !request.changes() => Ok(()),
            // Nobody else reads the telemetry.
            (Err(Refusal::NoLease), Request::Telemetry { .. }) => Ok(()),
            (permitted, _) => permitted,
        }
    }

    /// Continues after [`NextStep::Control`] with the control half's reply.
    pub fn control_replied(&mut self, reply: ControlReply, store: &mut impl Store) -> NextStep {
        let status = match reply {
            ControlReply::Response(response) => {
                let explores = match &response {
                    Response::Exploration(exploration) => Some(exploration.is_some()),
                    Response::Sweep(sweep) => Some(sweep.is_some()),
                    _ => None,
                };
                if let Some(explores) = explores {
                    self.explorer = self.host.filter(|_| explores);
                }
                return self.send(Ok(response));
            }
            ControlReply::Status(status) => status,
        };
        // A ventilation that waits to resume is not to be delayed, nor lost by a restart that nobody meant to end it.
        let ventilates = status.mode == Mode::Ventilating || status.resumes;
        let idle = if ventilates { Err(Refusal::Ventilating) } else { Ok(()) };
        match self.continuation {
            Continuation::Forward => self.send(Ok(Response::Mode(status.mode))),
            Continuation::Answered => self.answer_again(),
            Continuation::Greet => {
                let identity = self.identity(&status);
                self.send(Ok(Response::Identity(identity)))
            }
            Continuation::Begin { length, id } => {
                let begun = idle.and_then(|()| self.upload.begin(length, id));
                self.send(begun.map(|offset| Response::Progress { offset }))
            }
            Continuation::Commit => {
                match may_erase(&status).and_then(|()| self.upload.commit(&self.facts.trust)) {
                    Ok(id) => self.store_weights(id, store),
                    Err(refusal) => self.send(Err(refusal)),
                }
            }
            Continuation::CommitBench => {
                let description = may_erase(&status).and_then(|()| self.upload.description());
                let set = description.and_then(|bytes| store.set_bench(bytes));
                self.send(set.map(|()| Response::Done))
            }
            Continuation::StoreCalibration(calibration) => {
                let valid = may_erase(&status).and_then(|()| Ok(calibration.validate()?));
                let stored = valid.and_then(|()| store.store_calibration(&calibration));
                self.calibration_stored(&calibration, stored)
            }
            Continuation::Calibrated { stored, calibration } => {
                self.send(Ok(Response::Calibration { stored, calibration: Some(calibration) }))
            }
            Continuation::Restart if idle.is_ok() => {
                NextStep::Answer(Answer { message: self.answer(Response::Done), restart: true })
            }
            Continuation::Restart => self.send(Err(Refusal::Ventilating)),
        }
    }

    /// Stores the uploaded image, which has this id.
    fn store_weights(&mut self, id: u32, store: &mut impl Store) -> NextStep {
        let (slot, slots) = store.store_weights(self.upload.bytes());
        self.facts.slots = slots;
        let refusal = |error| match error {
            StoreError::NotNewer { version, stored } => Refusal::OldWeights { version, stored },
            StoreError::Flash(_) => Refusal::Storage,
        };
        self.send(slot.map(|slot| Response::Weights { id, slot }).map_err(refusal))
    }

    /// Lets the control half take over a calibration that was stored, as one of this number.
    fn calibration_stored(&mut self, calibration: &Calibration, stored: Result<u16, Refusal>) -> NextStep {
        let correction = SensorCorrection::new(calibration).map_err(Refusal::from);
        match stored.and_then(|stored| Ok((stored, correction?))) {
            Ok((stored, correction)) => {
                self.continuation = Continuation::Calibrated { stored, calibration: *calibration };
                NextStep::Control(ControlRequest::Calibrate(correction), self.role())
            }
            Err(refusal) => self.send(Err(refusal)),
        }
    }

    fn send(&mut self, result: Result<Response, Refusal>) -> NextStep {
        let message = self.answer(result.unwrap_or_else(Response::Refused));
        NextStep::Answer(Answer { message, restart: false })
    }

    /// Not inlined: it copies an answer, and each inlined instance takes a kilobyte of flash.
    #[inline(never)]
    fn answer(&mut self, response: Response) -> ToHost {
        self.last = Some((self.sequence, self.host, response.clone()));
        ToHost::Response { sequence: self.sequence, response }
    }

    /// Sends the last answer again.
    fn answer_again(&self) -> NextStep {
        // There is one: the callers have looked, or just made it.
        let (sequence, _, response) = self.last.clone().unwrap_or((self.sequence, self.host, Response::Done));
        let message = ToHost::Response { sequence, response };
        NextStep::Answer(Answer { message, restart: false })
    }

    fn identity(&self, status: &Status) -> DeviceIdentity {
        let DeviceFacts { firmware, device, period_us, slots, running, reset, ref failure, trust } =
            self.facts;
        let Status { mode, controller, exploration, .. } = *status;
        DeviceIdentity {
            protocol: PROTOCOL,
            firmware,
            device,
            period_us,
            mode,
            controller,
            exploration,
            slots,
            running,
            reset,
            failure: failure.clone(),
            weights_key: trust.key(),
        }
    }

    /// Handles a report of the control half; returns the messages to send, in this order.
    pub fn report(&mut self, report: &ControlReport) -> Vec<ToHost, 2> {
        let mut events = Vec::new();
        let (batch, event) = match *report {
            ControlReport::Sample { tick, sample } if self.telemetry => {
                (self.batcher.push(tick, &sample, &self.counters), None)
            }
            ControlReport::Sample { .. } => (None, None),
            ControlReport::Counters(counters) => {
                let corrupt_frames = self.counters.corrupt_frames;
                self.counters = Counters { corrupt_frames, ..counters };
                (None, None)
            }
            ControlReport::Breath(summary) => (None, Some(Event::Breath(summary))),
            ControlReport::Stopped => (self.batcher.flush(&self.counters), None),
            ControlReport::Alarm { fault, tick } => {
                if fault == Fault::HostSilent {
                    // This alarm has ended the exploration.
                    self.explorer = None;
                }
                (None, Some(Event::Alarm { fault, tick }))
            }
            ControlReport::Unacknowledged { fault, tick } => {
                (None, Some(Event::Unacknowledged { fault, tick }))
            }
        };
        events.extend(batch.map(Event::Telemetry).into_iter().chain(event).map(ToHost::Event));
        events
    }
}

/// Whether something may be stored, as [`Status::leave`] says. A store may erase a sector, which stalls the chip. Fulfils: store-refused.
fn may_erase(status: &Status) -> Result<(), Refusal> {
    match (status.leave(), status.mode) {
        (Leave::Erase, _) => Ok(()),
        (_, Mode::Fault(_)) => Err(Refusal::FaultLatched),
        (_, Mode::Standby) if status.moves_valves => Err(Refusal::SelfTestRuns),
        (_, Mode::Standby | Mode::Ventilating) => Err(Refusal::Ventilating),
    }
}
