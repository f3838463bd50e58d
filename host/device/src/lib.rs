//! A device at a port: requests and answers, events, uploads.
//!
//! A thread reads the line and sorts incoming messages. A request without an answer is repeated with the same sequence
//! number; the device executes it only once. After connecting, the host only reads; it pushes nothing by itself.
//!
//! A request that changes the device needs its lease. The connection acquires it with the first such request, again if it has
//! lapsed meanwhile, and gives it back when it ends. If another host holds it, the request is refused with that host's name.

#![forbid(unsafe_code)]

mod answers;
pub mod blackbox;
mod error;
mod host;
pub mod keys;
mod line;
pub mod port;
pub mod simulated;
pub mod upload;

use std::collections::VecDeque;
use std::sync::atomic::Ordering;
use std::sync::mpsc::{Receiver, RecvTimeoutError};
use std::time::{Duration, Instant};

use shared::calibration::Calibration;
use shared::device::annunciator::AudioStatus;
use shared::device::self_test::{Check, Outcome, Report};
use shared::explore::Exploration;
use shared::explore::sines::SineSweep;
use shared::link::PROTOCOL;
use shared::link::messages::{
    AlarmStatus, ControllerChoice, DeviceIdentity, Event, LeaseStatus, Request, Response, ToDevice,
};
use shared::link::refusal::Refusal;
use shared::settings::Settings;
use shared::timing::TickTimes;
use shared::ventilator::Mode;

use answers::{kind, unexpected};
pub use error::DeviceError;
pub use host::name as host_name;
pub use line::Heard;
use line::{Answer, Line};
pub use monitoring::LineCounters;
use port::{Address, Port};

/// Longest time for an answer before the request is repeated.
const ANSWER_TIME: Duration = Duration::from_millis(1500);
/// Interval at which events are passed on meanwhile.
const PASS_EVERY: Duration = Duration::from_millis(10);
/// Number of times that a request is sent.
const ATTEMPTS: usize = 4;
/// Longest wait for the self-test before a start.
const SELF_TEST_TIME: Duration = Duration::from_secs(30);
/// Longest wait for a check of the self-test.
const CHECK_TIME: Duration = Duration::from_mins(5);
/// Longest time for a device to return after a restart.
const RESTART_TIME: Duration = Duration::from_secs(20);
/// Longest time that the end of a connection waits for the device to take its lease back.
const RELEASE_TIME: Duration = Duration::from_millis(250);

/// A connected device.
pub struct Device {
    address: Address,
    line: Line,
    /// Events that arrived while an answer was awaited, and may be younger than it.
    held: VecDeque<Event>,
    sequence: u16,
    /// Identifies this connection, for the lease.
    token: u32,
    /// Whether it held the lease at last.
    steers: bool,
}

impl Device {
    /// Opens a port. Sends nothing.
    ///
    /// # Errors
    /// [`DeviceError::Port`].
    pub fn connect(address: &Address) -> Result<Self, DeviceError> {
        let mut device = Self::at(address);
        device.line = Line::start(Port::open(address)?);
        Ok(device)
    }

    /// A device at a port that is not open yet: [`Self::reconnect`] opens it.
    pub fn at(address: &Address) -> Self {
        let line = Line::closed();
        let (held, token) = (VecDeque::new(), host::token());
        Self { address: address.clone(), line, held, sequence: 0, token, steers: false }
    }

    /// The device's address.
    pub fn address(&self) -> &Address {
        &self.address
    }

    /// Reopens the port after the line broke.
    ///
    /// # Errors
    /// [`DeviceError::Port`].
    pub fn reconnect(&mut self) -> Result<(), DeviceError> {
        // Close the old line first: a serial port can be open only once.
        self.line.end();
        self.held.clear();
        self.line = Line::start(Port::open(&self.address)?);
        Ok(())
    }

    /// Counters of the line so far.
    pub fn counters(&self) -> LineCounters {
        self.line.counters()
    }

    /// The next event that the device has sent on its own, if one has arrived.
    pub fn next_event(&mut self) -> Option<Event> {
        self.held.pop_front().or_else(|| self.line.events.try_recv().ok())
    }

    /// Events that the device sends on its own.
    pub fn events(&self) -> &Receiver<Event> {
        &self.line.events
    }

    /// Sends raw bytes, valid or not, to test the device's reaction.
    ///
    /// # Errors
    /// [`DeviceError::Gone`].
    pub fn send_raw(&mut self, bytes: &[u8]) -> Result<(), DeviceError> {
        self.line.send_raw(bytes).map_err(|_| DeviceError::Gone(self.address.clone()))
    }

    /// Sends a request as another host does, whose token this is, to test the device's reaction. Its answer is dropped.
    ///
    /// # Errors
    /// [`DeviceError::Gone`].
    pub fn send_as(&mut self, host: u32, request: &Request) -> Result<(), DeviceError> {
        let message = ToDevice { sequence: 0, request: request.clone(), host: Some(host) };
        self.line.send(&message).map_err(|_| DeviceError::Gone(self.address.clone()))
    }

    /// Sends a request and waits for the answer. If the device demands its lease for it, acquires the lease first.
    ///
    /// # Errors
    /// [`DeviceError`]; a refusal is [`DeviceError::Refused`].
    pub fn request(&mut self, request: &Request) -> Result<Response, DeviceError> {
        self.ask(request, None)
    }

    /// The same; passes events on while it waits, which may take seconds on a line that loses frames. Events that may be younger
    /// than the answer are left for [`Self::next_event`].
    ///
    /// # Errors
    /// [`DeviceError`]; a refusal is [`DeviceError::Refused`].
    pub fn request_passing(
        &mut self,
        request: &Request,
        pass: &mut dyn FnMut(Event),
    ) -> Result<Response, DeviceError> {
        self.ask(request, Some(pass))
    }

    fn ask(&mut self, request: &Request, mut pass: Pass<'_>) -> Result<Response, DeviceError> {
        let mut answer = self.exchange_passing(request, &mut pass);
        // On a line that damages bytes the lease can lapse again before the request gets through.
        for _ in 1..ATTEMPTS {
            if !(request.changes() && matches!(answer, Err(DeviceError::Refused(Refusal::NoLease)))) {
                break;
            }
            self.acquire_lease(false)?;
            answer = self.exchange_passing(request, &mut pass);
        }
        answer
    }

    /// Sends a request and waits for the answer.
    fn exchange(&mut self, request: &Request) -> Result<Response, DeviceError> {
        self.exchange_passing(request, &mut None)
    }

    fn exchange_passing(&mut self, request: &Request, pass: &mut Pass<'_>) -> Result<Response, DeviceError> {
        let message = self.message(request);
        let before = self.line.heard();
        for _ in 0..ATTEMPTS {
            self.line.send(&message).map_err(|_| DeviceError::Gone(self.address.clone()))?;
            match self.answer(ANSWER_TIME, pass)? {
                Some(Response::Refused(Refusal::UnknownRequest)) => {
                    return Err(DeviceError::Unknown(kind(request)));
                }
                Some(Response::Refused(refusal)) => return Err(refusal.into()),
                Some(response) => {
                    answers::check(request, &response)?;
                    if let Response::Lease(status) = &response {
                        self.steers = status.yours;
                    }
                    return Ok(response);
                }
                None => tracing::debug!(?request, "no answer, asking again"),
            }
        }
        let (address, heard) = (self.address.clone(), self.line.heard().since(&before));
        Err(if heard.bytes == 0 {
            DeviceError::Silent(address)
        } else {
            DeviceError::Babbles { address, heard }
        })
    }

    /// The next message to the device.
    fn message(&mut self, request: &Request) -> ToDevice {
        self.sequence = self.sequence.wrapping_add(1);
        ToDevice { sequence: self.sequence, request: request.clone(), host: Some(self.token) }
    }

    /// The answer to the last request; `None` if it does not arrive in time.
    fn answer(&mut self, patience: Duration, pass: &mut Pass<'_>) -> Result<Option<Response>, DeviceError> {
        let deadline = Instant::now() + patience;
        loop {
            let left = deadline.saturating_duration_since(Instant::now());
            let turn = if pass.is_some() { left.min(PASS_EVERY) } else { left };
            let mut found = self.line.answers.recv_timeout(turn);
            if let (Some(pass), Err(RecvTimeoutError::Timeout)) = (pass.as_mut(), &found) {
                self.held.extend(self.line.events.try_iter());
                // An answer that has arrived meanwhile may be older than these events.
                found = self.line.answers.recv_timeout(Duration::ZERO);
                if matches!(found, Err(RecvTimeoutError::Timeout)) {
                    self.held.drain(..).for_each(&mut **pass);
                }
            }
            match found {
                Ok(Answer::Response { sequence, response }) if sequence == self.sequence => {
                    return Ok(Some(*response));
                }
                // A late answer to an abandoned request.
                Ok(Answer::Response { .. }) => {}
                Ok(Answer::OtherProtocol(device)) => return Err(DeviceError::Protocol(device)),
                Err(RecvTimeoutError::Timeout) if turn < left => {}
                Err(RecvTimeoutError::Timeout) => return Ok(None),
                Err(RecvTimeoutError::Disconnected) => return Err(DeviceError::Gone(self.address.clone())),
            }
        }
    }
}

/// Takes the events that arrive while an answer is awaited.
type Pass<'a> = Option<&'a mut dyn FnMut(Event)>;

/// The requests of a device. Each fails like [`Device::request`], or with [`DeviceError::Unexpected`].
#[expect(clippy::missing_errors_doc, reason = "documented once for all of them")]
impl Device {
    /// The device's identity.
    pub fn identify(&mut self) -> Result<DeviceIdentity, DeviceError> {
        match self.request(&Request::Identify)? {
            Response::Identity(identity) if identity.protocol == PROTOCOL => Ok(identity),
            Response::Identity(identity) => Err(DeviceError::Protocol(identity.protocol)),
            other => Err(unexpected(&Request::Identify, &other)),
        }
    }

    /// Settings in force, and those that are pending.
    pub fn settings(&mut self) -> Result<(Settings, Option<Settings>), DeviceError> {
        self.expect_settings(&Request::GetSettings)
    }

    /// Sets the settings for the next breath.
    pub fn apply(&mut self, settings: Settings) -> Result<(Settings, Option<Settings>), DeviceError> {
        self.expect_settings(&Request::ApplySettings(settings))
    }

    fn expect_settings(&mut self, request: &Request) -> Result<(Settings, Option<Settings>), DeviceError> {
        match self.request(request)? {
            Response::Settings { in_force, pending } => Ok((in_force, pending)),
            other => Err(unexpected(request, &other)),
        }
    }

    /// Queues settings for a later breath; returns how many more the queue can take.
    pub fn queue(&mut self, settings: Settings) -> Result<usize, DeviceError> {
        match self.request(&Request::QueueSettings(settings))? {
            Response::Queued { free } => Ok(free.into()),
            other => Err(unexpected(&Request::QueueSettings(settings), &other)),
        }
    }

    /// Starts ventilation; waits a few seconds for the end of a self-test.
    pub fn start(&mut self) -> Result<Mode, DeviceError> {
        let deadline = Instant::now() + SELF_TEST_TIME;
        loop {
            match self.expect_mode(&Request::Start) {
                Err(DeviceError::Refused(Refusal::SelfTestRuns)) if Instant::now() < deadline => {
                    std::thread::sleep(Duration::from_millis(20));
                }
                other => return other,
            }
        }
    }

    /// Results of the self-test.
    pub fn self_test(&mut self) -> Result<Report, DeviceError> {
        self.expect_report(&Request::GetSelfTest)
    }

    /// Runs a check of the self-test to its end, and returns all results.
    pub fn run_check(&mut self, check: Check) -> Result<Report, DeviceError> {
        let mut report = self.expect_report(&Request::RunSelfTest(check))?;
        let deadline = Instant::now() + CHECK_TIME;
        while report.iter().any(|result| result.outcome == Outcome::Runs) && Instant::now() < deadline {
            std::thread::sleep(Duration::from_millis(20));
            report = self.self_test()?;
        }
        Ok(report)
    }

    fn expect_report(&mut self, request: &Request) -> Result<Report, DeviceError> {
        match self.request(request)? {
            Response::SelfTest(report) => Ok(report),
            other => Err(unexpected(request, &other)),
        }
    }

    /// Stops ventilation.
    pub fn stop(&mut self) -> Result<Mode, DeviceError> {
        self.expect_mode(&Request::Stop)
    }

    /// Acknowledges all alarms, and leaves the latched safe state.
    pub fn acknowledge(&mut self) -> Result<Mode, DeviceError> {
        self.expect_mode(&Request::Acknowledge)
    }

    /// Alarms, and the level of the ladder.
    pub fn alarms(&mut self) -> Result<AlarmStatus, DeviceError> {
        match self.request(&Request::GetAlarms)? {
            Response::Alarms(alarms) => Ok(alarms),
            other => Err(unexpected(&Request::GetAlarms, &other)),
        }
    }

    /// Pauses the sounder for this many seconds; 0 ends the pause.
    pub fn pause_audio(&mut self, seconds: u16) -> Result<AudioStatus, DeviceError> {
        self.expect_audio(&Request::PauseAudio { seconds })
    }

    /// State of the sounder.
    pub fn audio(&mut self) -> Result<AudioStatus, DeviceError> {
        self.expect_audio(&Request::GetAudio)
    }

    fn expect_audio(&mut self, request: &Request) -> Result<AudioStatus, DeviceError> {
        match self.request(request)? {
            Response::Audio(audio) => Ok(audio),
            other => Err(unexpected(request, &other)),
        }
    }

    /// Who steers the device.
    pub fn lease(&mut self) -> Result<LeaseStatus, DeviceError> {
        self.expect_lease(&Request::GetLease)
    }

    /// Acquires the lease; `take_over` takes it from another host, which only a person may decide.
    pub fn acquire_lease(&mut self, take_over: bool) -> Result<LeaseStatus, DeviceError> {
        self.expect_lease(&Request::AcquireLease { name: host_name(), take_over })
    }

    /// Gives the lease back, if this connection holds it.
    pub fn release_lease(&mut self) -> Result<LeaseStatus, DeviceError> {
        self.expect_lease(&Request::ReleaseLease)
    }

    fn expect_lease(&mut self, request: &Request) -> Result<LeaseStatus, DeviceError> {
        match self.exchange(request)? {
            Response::Lease(status) => Ok(status),
            other => Err(unexpected(request, &other)),
        }
    }

    fn expect_mode(&mut self, request: &Request) -> Result<Mode, DeviceError> {
        match self.request(request)? {
            Response::Mode(mode) => Ok(mode),
            other => Err(unexpected(request, &other)),
        }
    }

    /// For requests whose answer only confirms them.
    fn expect(&mut self, request: &Request, done: impl Fn(&Response) -> bool) -> Result<(), DeviceError> {
        let response = self.request(request)?;
        if done(&response) { Ok(()) } else { Err(unexpected(request, &response)) }
    }

    /// Selects another controller from the next breath on.
    pub fn choose(&mut self, choice: ControllerChoice) -> Result<(), DeviceError> {
        self.expect(&Request::SetController(choice), |answer| matches!(answer, Response::Controller(_)))
    }

    /// Sets the exploration from the next breath on.
    pub fn explore(&mut self, exploration: Option<Exploration>) -> Result<(), DeviceError> {
        self.expect(&Request::SetExploration(exploration), |answer| {
            matches!(answer, Response::Exploration(_))
        })
    }

    /// Sets the sweep of sines from the next breath on.
    pub fn sweep(&mut self, sweep: Option<SineSweep>) -> Result<(), DeviceError> {
        self.expect(&Request::SetSweep(sweep), |answer| matches!(answer, Response::Sweep(_)))
    }

    /// Switches telemetry on or off.
    pub fn telemetry(&mut self, on: bool) -> Result<(), DeviceError> {
        self.expect(&Request::Telemetry { on }, |answer| matches!(answer, Response::Telemetry { .. }))
    }

    /// Statistics of the control ticks; resets them if `clear`.
    pub fn timing(&mut self, clear: bool) -> Result<TickTimes, DeviceError> {
        match self.request(&Request::GetTiming { clear })? {
            Response::Timing(times) => Ok(times),
            other => Err(unexpected(&Request::GetTiming { clear }, &other)),
        }
    }

    /// Number of stored calibrations, and one of them: 0 for the newest, 1 for the one before, and so on.
    pub fn calibration(&mut self, back: u16) -> Result<(u16, Option<Calibration>), DeviceError> {
        self.expect_calibration(&Request::GetCalibration { back })
    }

    /// Stores a calibration, which corrects the readings from the next start of ventilation on; returns the number of stored
    /// calibrations. Only in standby.
    pub fn calibrate(&mut self, calibration: &Calibration) -> Result<u16, DeviceError> {
        self.expect_calibration(&Request::StoreCalibration(*calibration)).map(|(stored, _)| stored)
    }

    fn expect_calibration(&mut self, request: &Request) -> Result<(u16, Option<Calibration>), DeviceError> {
        match self.request(request)? {
            Response::Calibration { stored, calibration } => Ok((stored, calibration)),
            other => Err(unexpected(request, &other)),
        }
    }

    /// Makes the plant restart with this seed at the next start.
    pub fn reset_plant(&mut self, seed: u64) -> Result<(), DeviceError> {
        self.expect(&Request::ResetPlant { seed }, |answer| matches!(answer, Response::Done))
    }

    /// Restarts the device and waits until it identifies itself again.
    pub fn restart(&mut self) -> Result<DeviceIdentity, DeviceError> {
        self.expect(&Request::Reset, |answer| matches!(answer, Response::Done))?;
        let deadline = Instant::now() + RESTART_TIME;
        loop {
            // The line may break with the device, as with a USB port.
            let gone = self.line.broken.load(Ordering::Relaxed);
            let greeting =
                if gone { self.reconnect().and_then(|()| self.identify()) } else { self.identify() };
            match greeting {
                Err(
                    DeviceError::Port(_)
                    | DeviceError::Gone(_)
                    | DeviceError::Silent(_)
                    | DeviceError::Babbles { .. },
                ) if Instant::now() < deadline => {
                    std::thread::sleep(Duration::from_millis(100));
                }
                other => return other,
            }
        }
    }
}

impl Drop for Device {
    /// Gives the lease back, so that the next host need not wait until it lapses.
    fn drop(&mut self) {
        if self.steers {
            let message = self.message(&Request::ReleaseLease);
            // A device that does not answer lets the lease lapse.
            if self.line.send(&message).is_ok() {
                let _ = self.answer(RELEASE_TIME, &mut None);
            }
        }
    }
}
