//! A device at the other end of a port: requests and answers, events, uploads.
//!
//! A thread reads the line and sorts what comes. A request is sent again under the same sequence number while its answer
//! is missing; the device does nothing twice. After a connection the host only reads; nothing is pushed unasked.

#![forbid(unsafe_code)]

pub mod blackbox;
mod line;
pub mod port;
pub mod simulated;
pub mod upload;

use std::sync::atomic::Ordering;
use std::sync::mpsc::{Receiver, RecvTimeoutError};
use std::time::{Duration, Instant};

use shared::explore::Exploration;
use shared::link::PROTOCOL;
use shared::link::messages::{ControllerChoice, DeviceIdentity, Event, Request, Response, ToDevice};
use shared::link::refusal::Refusal;
use shared::settings::Settings;
use shared::timing::TickTimes;
use shared::ventilator::Mode;
use thiserror::Error;

pub use line::LineCounters;
use line::{Answer, Line};
use port::{Address, Port, PortError};

/// How long an answer may take before the request is sent again.
const ANSWER_TIME: Duration = Duration::from_millis(1500);
/// How often a request is sent.
const ATTEMPTS: usize = 4;
/// How long a device may take to come back after a restart.
const RESTART_TIME: Duration = Duration::from_secs(20);

/// Why a device did not do what was asked.
#[derive(Debug, Error)]
pub enum DeviceError {
    /// The port cannot be opened.
    #[error(transparent)]
    Port(#[from] PortError),
    /// No answer.
    #[error("{0} does not answer; check cable, power and firmware (`trainer flash --firmware` loads it)")]
    Silent(Address),
    /// The line broke.
    #[error("the connection to {0} is lost; plug it in again and repeat the command")]
    Gone(Address),
    /// Another version.
    #[error("the device speaks protocol {0}, this program {PROTOCOL}; update the older side")]
    Protocol(u16),
    /// It says no.
    #[error("the device refused: {0}")]
    Refused(#[from] Refusal),
    /// The caller's progress asked to stop.
    #[error("stopped; nothing on the device has changed: repeat the command")]
    Stopped,
    /// It answered something else.
    #[error("the device gave an answer that does not belong to the request; update the older side")]
    Unexpected,
}

/// A connected device.
pub struct Device {
    address: Address,
    line: Line,
    sequence: u16,
}

impl Device {
    /// Opens a port. Nothing is sent.
    ///
    /// # Errors
    /// [`DeviceError::Port`].
    pub fn connect(address: &Address) -> Result<Self, DeviceError> {
        let line = Line::start(Port::open(address)?);
        Ok(Self { address: address.clone(), line, sequence: 0 })
    }

    /// Where it is.
    pub fn address(&self) -> &Address {
        &self.address
    }

    /// Opens the port again after the line broke.
    ///
    /// # Errors
    /// [`DeviceError::Port`].
    pub fn reconnect(&mut self) -> Result<(), DeviceError> {
        // The old line first: a serial port can be open once.
        self.line.end();
        self.line = Line::start(Port::open(&self.address)?);
        Ok(())
    }

    /// What came over the line so far.
    pub fn counters(&self) -> LineCounters {
        self.line.counters()
    }

    /// What the device tells unasked.
    pub fn events(&self) -> &Receiver<Event> {
        &self.line.events
    }

    /// Sends bytes as they are, sound or not: for tests of what a device does with them.
    ///
    /// # Errors
    /// [`DeviceError::Gone`].
    pub fn send_raw(&mut self, bytes: &[u8]) -> Result<(), DeviceError> {
        self.line.send_raw(bytes).map_err(|_| DeviceError::Gone(self.address.clone()))
    }

    /// Asks and waits for the answer.
    ///
    /// # Errors
    /// [`DeviceError`]; a refusal is [`DeviceError::Refused`].
    pub fn request(&mut self, request: &Request) -> Result<Response, DeviceError> {
        self.sequence = self.sequence.wrapping_add(1);
        let message = ToDevice { sequence: self.sequence, request: request.clone() };
        for _ in 0..ATTEMPTS {
            self.line.send(&message).map_err(|_| DeviceError::Gone(self.address.clone()))?;
            match self.answer()? {
                Some(Response::Refused(refusal)) => return Err(refusal.into()),
                Some(response) => return Ok(response),
                None => tracing::debug!(?request, "no answer, asking again"),
            }
        }
        Err(DeviceError::Silent(self.address.clone()))
    }

    /// The answer to the last request; none if it does not come in time.
    fn answer(&self) -> Result<Option<Response>, DeviceError> {
        let deadline = Instant::now() + ANSWER_TIME;
        loop {
            let left = deadline.saturating_duration_since(Instant::now());
            match self.line.answers.recv_timeout(left) {
                Ok(Answer::Response { sequence, response }) if sequence == self.sequence => {
                    return Ok(Some(*response));
                }
                // An answer that was given up on.
                Ok(Answer::Response { .. }) => {}
                Ok(Answer::OtherProtocol(device)) => return Err(DeviceError::Protocol(device)),
                Err(RecvTimeoutError::Timeout) => return Ok(None),
                Err(RecvTimeoutError::Disconnected) => return Err(DeviceError::Gone(self.address.clone())),
            }
        }
    }
}

/// What a device can be asked. Each of these fails as [`Device::request`] does, or with [`DeviceError::Unexpected`].
#[expect(clippy::missing_errors_doc, reason = "said once for all of them")]
impl Device {
    /// Who are you?
    pub fn identify(&mut self) -> Result<DeviceIdentity, DeviceError> {
        match self.request(&Request::Identify)? {
            Response::Identity(identity) if identity.protocol == PROTOCOL => Ok(identity),
            Response::Identity(identity) => Err(DeviceError::Protocol(identity.protocol)),
            _ => Err(DeviceError::Unexpected),
        }
    }

    /// Settings in force, and those that wait.
    pub fn settings(&mut self) -> Result<(Settings, Option<Settings>), DeviceError> {
        self.expect_settings(&Request::GetSettings)
    }

    /// Settings for the next breath.
    pub fn apply(&mut self, settings: Settings) -> Result<(Settings, Option<Settings>), DeviceError> {
        self.expect_settings(&Request::ApplySettings(settings))
    }

    fn expect_settings(&mut self, request: &Request) -> Result<(Settings, Option<Settings>), DeviceError> {
        match self.request(request)? {
            Response::Settings { in_force, pending } => Ok((in_force, pending)),
            _ => Err(DeviceError::Unexpected),
        }
    }

    /// Settings for one of the next breaths; gives how many more find room.
    pub fn queue(&mut self, settings: Settings) -> Result<usize, DeviceError> {
        match self.request(&Request::QueueSettings(settings))? {
            Response::Queued { free } => Ok(free.into()),
            _ => Err(DeviceError::Unexpected),
        }
    }

    /// Starts ventilation.
    pub fn start(&mut self) -> Result<Mode, DeviceError> {
        self.expect_mode(&Request::Start)
    }

    /// Stops ventilation.
    pub fn stop(&mut self) -> Result<Mode, DeviceError> {
        self.expect_mode(&Request::Stop)
    }

    /// Leaves the latched safe state.
    pub fn acknowledge(&mut self) -> Result<Mode, DeviceError> {
        self.expect_mode(&Request::Acknowledge)
    }

    fn expect_mode(&mut self, request: &Request) -> Result<Mode, DeviceError> {
        match self.request(request)? {
            Response::Mode(mode) => Ok(mode),
            _ => Err(DeviceError::Unexpected),
        }
    }

    /// For requests whose answer says no more than that it was done.
    fn expect(&mut self, request: &Request, done: impl Fn(&Response) -> bool) -> Result<(), DeviceError> {
        if done(&self.request(request)?) { Ok(()) } else { Err(DeviceError::Unexpected) }
    }

    /// Another controller from the next breath on.
    pub fn choose(&mut self, choice: ControllerChoice) -> Result<(), DeviceError> {
        self.expect(&Request::SetController(choice), |answer| matches!(answer, Response::Controller(_)))
    }

    /// Other exploration from the next breath on.
    pub fn explore(&mut self, exploration: Option<Exploration>) -> Result<(), DeviceError> {
        self.expect(&Request::SetExploration(exploration), |answer| {
            matches!(answer, Response::Exploration(_))
        })
    }

    /// Switches telemetry.
    pub fn telemetry(&mut self, on: bool) -> Result<(), DeviceError> {
        self.expect(&Request::Telemetry { on }, |answer| matches!(answer, Response::Telemetry { .. }))
    }

    /// Statistics of the control ticks; counts anew if asked to.
    pub fn timing(&mut self, clear: bool) -> Result<TickTimes, DeviceError> {
        match self.request(&Request::GetTiming { clear })? {
            Response::Timing(times) => Ok(times),
            _ => Err(DeviceError::Unexpected),
        }
    }

    /// At the next start the plant starts anew with this seed.
    pub fn reset_plant(&mut self, seed: u64) -> Result<(), DeviceError> {
        self.expect(&Request::ResetPlant { seed }, |answer| matches!(answer, Response::Done))
    }

    /// Restarts the device and waits until it greets again.
    pub fn restart(&mut self) -> Result<DeviceIdentity, DeviceError> {
        self.expect(&Request::Reset, |answer| matches!(answer, Response::Done))?;
        let deadline = Instant::now() + RESTART_TIME;
        loop {
            // The line may break with the device, as that of a USB port does.
            let gone = self.line.broken.load(Ordering::Relaxed);
            let greeting =
                if gone { self.reconnect().and_then(|()| self.identify()) } else { self.identify() };
            match greeting {
                Err(DeviceError::Port(_) | DeviceError::Gone(_) | DeviceError::Silent(_))
                    if Instant::now() < deadline =>
                {
                    std::thread::sleep(Duration::from_millis(100));
                }
                other => return other,
            }
        }
    }
}
