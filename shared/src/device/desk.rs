//! The half of a device that talks: requests and their answers, telemetry batches, uploads.
//!
//! Nothing here waits. [`Desk::receive`] gives a [`Step`]; whoever runs the desk carries it out and comes back with the
//! result until the step is an answer. One request is dealt with at a time.
//!
//! A host that got no answer asks again under the same sequence number. The desk remembers its last answer and repeats
//! it, so that nothing is done twice.

use heapless::{String, Vec};

use super::{Answer, Order, Report, Status};
use crate::link::PROTOCOL;
use crate::link::messages::{
    DeviceIdentity, DeviceKind, Event, FAILURE_BYTES, Request, ResetCause, Response, Slot, SlotState,
    ToDevice, ToHost,
};
use crate::link::refusal::Refusal;
use crate::link::telemetry::{Batcher, Counters};
use crate::link::upload::Upload;
use crate::recorder::Look;
use crate::ventilator::Mode;
use crate::weights::IMAGE_BYTES;

/// What does not change until the device starts anew, but for the slots.
#[derive(Clone, Debug, PartialEq)]
pub struct Facts {
    /// Version of the firmware: major, minor, patch.
    pub firmware: [u16; 3],
    /// What it runs on.
    pub device: DeviceKind,
    /// Control period, microseconds.
    pub period_us: u32,
    /// What each weights slot holds.
    pub slots: [SlotState; 2],
    /// The slot that was loaded.
    pub running: Option<Slot>,
    /// Why the device started.
    pub reset: ResetCause,
    /// What it failed with before.
    pub failure: Option<String<FAILURE_BYTES>>,
}

/// What to do next.
#[derive(Clone, Debug, PartialEq)]
pub enum Step {
    /// Send this.
    Send(ToHost),
    /// Have the control half carry out this order, then call [`Desk::answered`].
    Ask(Order),
    /// Look into the flight recorder's memory, then call [`Desk::looked`].
    Look(Look),
    /// Store [`Desk::image`] in a slot that does not run, then call [`Desk::stored`].
    Store,
    /// Send this, wait until it is out, and start anew.
    Restart(ToHost),
}

/// What happens with the control half's answer.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Purpose {
    /// It is the host's.
    Pass,
    /// It completes the greeting.
    Greet,
    /// It says whether an upload may begin.
    Begin { length: u32, id: u32 },
    /// It says whether the flash may be written.
    Commit,
    /// It says whether the device may start anew.
    Restart,
}

/// The desk.
#[derive(Clone, Debug)]
pub struct Desk {
    facts: Facts,
    telemetry: bool,
    batcher: Batcher,
    counters: Counters,
    upload: Upload,
    /// Id of the image on its way into a slot.
    committed: u32,
    sequence: u16,
    purpose: Purpose,
    last: Option<(u16, Response)>,
}

impl Desk {
    /// A desk that nobody has spoken to.
    pub const fn new(facts: Facts) -> Self {
        Self {
            facts,
            telemetry: false,
            batcher: Batcher::new(),
            counters: Counters::ZERO,
            upload: Upload::new(),
            committed: 0,
            sequence: 0,
            purpose: Purpose::Pass,
            last: None,
        }
    }

    /// The validated image that [`Step::Store`] is about.
    pub fn image(&self) -> &[u8; IMAGE_BYTES] {
        self.upload.bytes()
    }

    /// How many frames from the host were refused so far, for the telemetry.
    pub fn corrupt_frames(&mut self, count: u32) {
        self.counters.corrupt_frames = count;
    }

    /// Refuses a frame that holds no request of this version.
    pub fn unreadable(&mut self, sequence: u16) -> ToHost {
        ToHost::Response { sequence, response: Response::Refused(Refusal::UnknownRequest) }
    }

    /// Takes in a request.
    pub fn receive(&mut self, message: &ToDevice) -> Step {
        let ToDevice { sequence, request } = message;
        if let Some((_, response)) = self.last.as_ref().filter(|last| last.0 == *sequence)
            && *request != Request::Identify
        {
            return Step::Send(ToHost::Response { sequence: *sequence, response: response.clone() });
        }
        self.sequence = *sequence;
        match request {
            Request::Identify => self.ask(Purpose::Greet, Order::Status),
            Request::GetSettings => self.ask(Purpose::Pass, Order::Settings),
            Request::ApplySettings(settings) => self.ask(Purpose::Pass, Order::Apply(*settings)),
            Request::QueueSettings(settings) => self.ask(Purpose::Pass, Order::Queue(*settings)),
            Request::Start => self.ask(Purpose::Pass, Order::Start),
            Request::Stop => self.ask(Purpose::Pass, Order::Stop),
            Request::Acknowledge => self.ask(Purpose::Pass, Order::Acknowledge),
            Request::SetController(choice) => self.ask(Purpose::Pass, Order::Controller(*choice)),
            Request::SetExploration(exploration) => self.ask(Purpose::Pass, Order::Exploration(*exploration)),
            Request::GetTiming { clear } => self.ask(Purpose::Pass, Order::Timing { clear: *clear }),
            Request::ResetPlant { seed } => self.ask(Purpose::Pass, Order::ResetPlant(*seed)),
            Request::BeginWeights { length, id } => {
                self.ask(Purpose::Begin { length: *length, id: *id }, Order::Status)
            }
            Request::CommitWeights => self.ask(Purpose::Commit, Order::Status),
            Request::Reset => self.ask(Purpose::Restart, Order::Status),
            Request::GetRecorder => Step::Look(Look::Status),
            Request::ReadRecorder { part, from } => Step::Look(Look::Page { part: *part, from: *from }),
            Request::ClearRecorder => Step::Look(Look::Clear),
            Request::WeightsChunk { offset, bytes } => {
                let progress = self.upload.chunk(*offset, bytes).map(|offset| Response::Progress { offset });
                self.send(progress)
            }
            Request::Telemetry { on } => {
                self.telemetry = *on;
                self.send(Ok(Response::Telemetry { on: *on }))
            }
        }
    }

    fn ask(&mut self, purpose: Purpose, order: Order) -> Step {
        self.purpose = purpose;
        Step::Ask(order)
    }

    /// Goes on with the control half's answer.
    pub fn answered(&mut self, answer: Answer) -> Step {
        let status = match answer {
            Answer::Host(response) => return self.send(Ok(response)),
            Answer::Status(status) => status,
        };
        let quiet = if status.mode == Mode::Ventilating { Err(Refusal::Ventilating) } else { Ok(()) };
        match self.purpose {
            Purpose::Pass => self.send(Ok(Response::Mode(status.mode))),
            Purpose::Greet => {
                let identity = self.identity(&status);
                self.send(Ok(Response::Identity(identity)))
            }
            Purpose::Begin { length, id } => {
                let begun = quiet.and_then(|()| self.upload.begin(length, id));
                self.send(begun.map(|offset| Response::Progress { offset }))
            }
            Purpose::Commit => match quiet.and_then(|()| self.upload.commit()) {
                Ok(image) => {
                    self.committed = image.id;
                    Step::Store
                }
                Err(refusal) => self.send(Err(refusal)),
            },
            Purpose::Restart => match quiet {
                Ok(()) => Step::Restart(self.answer(Response::Done)),
                Err(refusal) => self.send(Err(refusal)),
            },
        }
    }

    /// Goes on after [`Step::Look`] with what was found.
    pub fn looked(&mut self, found: Response) -> Step {
        self.send(Ok(found))
    }

    /// Goes on after [`Step::Store`]: the slot that took the image, if one did, and what both slots hold now.
    pub fn stored(&mut self, slot: Option<Slot>, slots: [SlotState; 2]) -> Step {
        self.facts.slots = slots;
        let id = self.committed;
        self.send(slot.map(|slot| Response::Weights { id, slot }).ok_or(Refusal::Storage))
    }

    fn send(&mut self, result: Result<Response, Refusal>) -> Step {
        Step::Send(self.answer(result.unwrap_or_else(Response::Refused)))
    }

    fn answer(&mut self, response: Response) -> ToHost {
        self.last = Some((self.sequence, response.clone()));
        ToHost::Response { sequence: self.sequence, response }
    }

    fn identity(&self, status: &Status) -> DeviceIdentity {
        let Facts { firmware, device, period_us, slots, running, reset, ref failure } = self.facts;
        let Status { mode, controller, exploration } = *status;
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
        }
    }

    /// Takes in a report; gives what is to be sent of it, in this order.
    pub fn report(&mut self, report: &Report) -> Vec<ToHost, 2> {
        let mut events = Vec::new();
        let (batch, event) = match *report {
            Report::Sample { tick, sample } if self.telemetry => {
                (self.batcher.push(tick, &sample, &self.counters), None)
            }
            Report::Sample { .. } => (None, None),
            Report::Counters(counters) => {
                let corrupt_frames = self.counters.corrupt_frames;
                self.counters = Counters { corrupt_frames, ..counters };
                (None, None)
            }
            Report::Breath(summary) => (None, Some(Event::Breath(summary))),
            Report::Stopped => (self.batcher.flush(&self.counters), None),
            Report::Alarm { fault, tick } => (None, Some(Event::Alarm { fault, tick })),
        };
        events.extend(batch.map(Event::Telemetry).into_iter().chain(event).map(ToHost::Event));
        events
    }
}
