//! A monitor's knowledge of its device, and the requests of keys.
//!
//! Everything shown was reported by the device. A key creates a request and changes nothing here: only the device's
//! answer changes the settings in force. A key changes the settings that the device reported last, so the monitor never
//! pushes settings that the device did not have.

use std::collections::VecDeque;

use shared::control::pid::PidGains;
use shared::device::annunciator::AUDIO_PAUSE_MAX;
use shared::link::messages::{ControllerChoice, Event, LeaseStatus, Request, Response};
use shared::link::telemetry::BreathSummary;
use shared::safety::alarms::Fault;
use shared::settings::Settings;
use shared::ventilator::Mode;

use super::News;
use super::window::TelemetryWindow;
use super::words;
pub use monitoring::known::Known;
use monitoring::known::Reported;

/// Length of the charts, s.
pub const SECONDS: f64 = 9.0;
/// Change of PIP by one key, cmH2O.
pub const PIP_STEP: f32 = 1.0;
/// Change of the rate by one key, 1/min.
pub const RATE_STEP: f32 = 1.0;
/// Number of breaths and alarms kept.
const REMEMBERED: usize = 100;

/// The keys that an operator can press.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Key {
    /// Start or stop ventilation.
    StartStop,
    /// Acknowledge all alarms, and leave the latched safe state.
    Acknowledge,
    /// Pause the sounder for the longest time, or end the pause.
    PauseAudio,
    /// Higher PIP.
    PipUp,
    /// Lower PIP.
    PipDown,
    /// Faster breaths.
    RateUp,
    /// Slower breaths.
    RateDown,
    /// Switch between the PID and the learned controller.
    Controller,
    /// Send the settings that are shown, which a device demands before it starts.
    Confirm,
    /// Take the lease from the host that steers the device.
    TakeOver,
}

/// An alarm.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct AlarmEntry {
    /// Fault that raised it; it may have latched or not, see its row in the table of alarms.
    pub fault: Fault,
    /// Control tick since the device started.
    pub tick: u64,
}

/// The message line below the charts.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Notice {
    /// A request was carried out.
    Note(String),
    /// A request was not carried out.
    Warning(String),
}

/// What was known before a piece of news.
#[derive(Clone, Copy, Debug)]
struct Before {
    lost: bool,
    period_us: Option<u32>,
    ticks: Option<u32>,
}

/// The known state of a device.
#[derive(Clone, Debug, Default)]
pub struct View {
    pub(super) address: String,
    reported: Reported,
    pub(super) window: TelemetryWindow,
    /// Breaths, newest first.
    pub(super) breaths: VecDeque<BreathSummary>,
    /// Alarms, newest first.
    pub(super) alarms: VecDeque<AlarmEntry>,
    pub(super) message: Option<Notice>,
    /// PID gains for a device that runs learned weights, when switched to a PID.
    gains: PidGains,
    /// Requested settings that are not answered yet, and the number of such requests in progress.
    asked: Option<Settings>,
    under_way: usize,
}

impl View {
    /// What the device has reported.
    pub fn known(&self) -> Known<'_> {
        self.reported.known()
    }

    /// An empty view of the device at `address`; `gains` are those of the PID that replaces a learned controller,
    /// unless the device reports others.
    pub fn new(address: impl Into<String>, gains: PidGains) -> Self {
        Self {
            address: address.into(),
            gains,
            window: TelemetryWindow::new(SECONDS, shared::breath::DEFAULT_PERIOD_US),
            ..Self::default()
        }
    }

    /// Processes a piece of news.
    pub fn take(&mut self, news: &News) {
        let known = self.known();
        let before = Before {
            lost: known.lost.is_some(),
            period_us: known.identity.map(|identity| identity.period_us),
            ticks: known.times.map(|times| times.ticks),
        };
        self.reported.take(news);
        match news {
            News::Event(event) => self.happened(event),
            News::Answer { request, result } => self.answered(request, result, before),
            News::Traffic(_) => {}
            News::Lost(_) => self.forget_requests(),
        }
    }

    /// After a lost line or a restart the device may have other settings: a change of the old ones must not reach it.
    fn forget_requests(&mut self) {
        (self.asked, self.under_way) = (None, 0);
    }

    fn happened(&mut self, event: &Event) {
        match event {
            Event::Telemetry(batch) => self.window.take(batch),
            Event::Breath(breath) => {
                if self.breaths.front().is_some_and(|last| last.breath >= breath.breath) {
                    // Ventilation was restarted.
                    self.breaths.clear();
                }
                remember(&mut self.breaths, *breath);
            }
            Event::Alarm { fault, tick } => {
                remember(&mut self.alarms, AlarmEntry { fault: *fault, tick: *tick });
            }
            Event::Unacknowledged { fault, tick } => {
                let (fault, tick) = (*fault, *tick);
                if !self.alarms.contains(&AlarmEntry { fault, tick }) {
                    // Its first report was missed.
                    self.take(&News::Event(Event::Alarm { fault, tick }));
                }
            }
        }
    }

    fn answered(&mut self, request: &Request, result: &Result<Response, String>, before: Before) {
        if let Request::ApplySettings(_) = request {
            self.under_way = self.under_way.saturating_sub(1);
            if self.under_way == 0 {
                self.asked = None;
            }
        }
        match result {
            Err(reason) => self.message = Some(Notice::Warning(reason.clone())),
            Ok(response) => {
                self.learn(response, before);
                if !asked_by_itself(request) {
                    self.message = note(response);
                }
            }
        }
    }

    /// Takes what a report says about the charts, the lists and the message.
    fn learn(&mut self, response: &Response, before: Before) {
        match response {
            Response::Identity(identity) => {
                if before.lost {
                    let again = "connected again; nothing was changed on the device";
                    self.message = Some(Notice::Note(again.into()));
                }
                if before.period_us != Some(identity.period_us) {
                    self.window = TelemetryWindow::new(SECONDS, identity.period_us);
                }
                self.chosen(identity.controller);
            }
            Response::Controller(choice) => self.chosen(*choice),
            Response::Timing(times) if before.ticks.is_some_and(|ticks| times.ticks < ticks) => {
                self.restarted();
            }
            _ => {}
        }
    }

    fn chosen(&mut self, choice: ControllerChoice) {
        if let ControllerChoice::Pid(gains) = choice {
            self.gains = gains;
        }
    }

    /// Handles a restart of the device between two polls, seen by its tick counter.
    fn restarted(&mut self) {
        let identity = self.known().identity;
        let cause = identity.map_or("unknown cause", |identity| words::reset(identity.reset));
        let period_us = identity.map_or(0, |identity| identity.period_us);
        self.message = Some(Notice::Warning(format!("the device restarted: {cause}")));
        self.forget_requests();
        self.window = TelemetryWindow::new(SECONDS, period_us);
        self.breaths.clear();
    }

    /// The request of a key; `None`, with a message, if nothing can be requested now.
    pub fn press(&mut self, key: Key) -> Option<Request> {
        let request = match (self.known().lost, self.request(key)) {
            (None, Some(request)) => request,
            (Some(_), _) => return self.hold_back("no connection: nothing was sent"),
            (None, None) => return self.hold_back("the device's state is not known yet: nothing was sent"),
        };
        if let Request::ApplySettings(settings) = request {
            self.asked = Some(settings);
            self.under_way += 1;
        }
        Some(request)
    }

    fn hold_back(&mut self, why: &str) -> Option<Request> {
        self.message = Some(Notice::Warning(why.to_owned()));
        None
    }

    fn request(&self, key: Key) -> Option<Request> {
        let Known { mode, audio, controller, .. } = self.known();
        match key {
            Key::StartStop => mode.map(|mode| match mode {
                Mode::Ventilating => Request::Stop,
                // The device refuses to start with a latched fault and reports what to do.
                Mode::Standby | Mode::Fault(_) => Request::Start,
            }),
            Key::Acknowledge => mode.map(|_| Request::Acknowledge),
            Key::PauseAudio => audio.map(|audio| Request::PauseAudio {
                seconds: if audio.pause_left > 0 { 0 } else { AUDIO_PAUSE_MAX },
            }),
            Key::Confirm => self.changed(|_| ()),
            Key::TakeOver => {
                mode.map(|_| Request::AcquireLease { name: device::host_name(), take_over: true })
            }
            Key::PipUp => self.changed(|settings| settings.pip += PIP_STEP),
            Key::PipDown => self.changed(|settings| settings.pip -= PIP_STEP),
            Key::RateUp => self.changed(|settings| settings.rate += RATE_STEP),
            Key::RateDown => self.changed(|settings| settings.rate -= RATE_STEP),
            Key::Controller => controller.map(|choice| {
                Request::SetController(match choice {
                    ControllerChoice::Pid(_) => ControllerChoice::Learned,
                    ControllerChoice::Learned => ControllerChoice::Pid(self.gains),
                })
            }),
        }
    }

    /// The settings that apply next, with a change; the device checks them.
    fn changed(&self, change: impl Fn(&mut Settings)) -> Option<Request> {
        let Known { pending, in_force, .. } = self.known();
        let mut settings = self.asked.or(pending.or(in_force).copied())?;
        change(&mut settings);
        Some(Request::ApplySettings(settings))
    }

    /// A message for an operator who quits.
    pub fn farewell(&self) -> String {
        let Self { address, .. } = self;
        let Known { mode, lost, .. } = self.known();
        match (mode, lost) {
            (None, _) => format!("{address} never reported its state"),
            (Some(Mode::Ventilating), None) => {
                format!(
                    "{address} continues to ventilate; `trainer monitor --port {address}` shows it, space stops it"
                )
            }
            (Some(Mode::Ventilating), Some(_)) => {
                format!("{address} was ventilating when the connection broke, and continues if it has power")
            }
            (Some(mode), _) => format!("{address}: {}", words::mode(mode)),
        }
    }
}

fn remember<T>(list: &mut VecDeque<T>, newest: T) {
    list.push_front(newest);
    list.truncate(REMEMBERED);
}

/// Whether the monitor polls this itself.
fn asked_by_itself(request: &Request) -> bool {
    use Request::{GetAlarms, GetAudio, GetLease, GetSettings, GetTiming, Identify, Telemetry};
    let reads = matches!(request, Identify | GetSettings | GetAlarms | GetAudio | GetLease);
    reads || matches!(request, GetTiming { .. } | Telemetry { .. })
}

/// A message for a completed request; `None` if the change shows elsewhere.
fn note(response: &Response) -> Option<Notice> {
    let text = match response {
        Response::Settings { in_force, pending } => {
            let Settings { pip, rate, .. } = pending.unwrap_or(*in_force);
            format!("from the next breath on: PIP {pip} cmH2O, rate {rate} /min")
        }
        Response::Audio(audio) => format!("sounder: {}", words::audio(audio)),
        Response::Lease(LeaseStatus { yours: true, .. }) => "this monitor steers the device now".to_owned(),
        Response::Controller(choice) => format!("from the next breath on: {}", words::controller(*choice)),
        _ => return None,
    };
    Some(Notice::Note(text))
}
