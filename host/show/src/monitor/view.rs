//! What a monitor knows of its device, and what a key asks of it.
//!
//! Everything shown was told by the device. A key gives a request and changes nothing here: what is in force is what the
//! answer says. Settings that a key changes are the ones the device named last, so nothing is ever pushed that the
//! device did not hold before.

use std::collections::VecDeque;

use shared::control::pid::PidGains;
use shared::link::messages::{ControllerChoice, DeviceIdentity, Event, Request, Response};
use shared::link::telemetry::BreathSummary;
use shared::safety::alarms::{Action, Fault};
use shared::settings::Settings;
use shared::timing::TickTimes;
use shared::ventilator::Mode;

use super::News;
use super::window::TelemetryWindow;
use super::words;
use device::LineCounters;

/// Length of the charts, s.
pub const SECONDS: f64 = 9.0;
/// Change of PIP by one key, cmH2O.
pub const PIP_STEP: f32 = 1.0;
/// Change of the rate by one key, 1/min.
pub const RATE_STEP: f32 = 1.0;
/// Breaths and alarms that are remembered.
const REMEMBERED: usize = 100;

/// What an operator can press.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Key {
    /// Start, or stop.
    StartStop,
    /// Leave the latched safe state.
    Acknowledge,
    /// Higher PIP.
    PipUp,
    /// Lower PIP.
    PipDown,
    /// Faster breaths.
    RateUp,
    /// Slower breaths.
    RateDown,
    /// PID in place of the learned controller, or the other way round.
    Controller,
}

/// An alarm.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct AlarmEntry {
    /// Fault that raised it; it may have latched or not, see its row in the table of alarms.
    pub fault: Fault,
    /// Control tick since power-up.
    pub tick: u64,
}

/// The line below the charts.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Notice {
    /// Something was done.
    Note(String),
    /// Something was not done.
    Warning(String),
}

/// What is known of a device.
#[derive(Clone, Debug, Default)]
pub struct View {
    pub(super) address: String,
    pub(super) lost: Option<String>,
    pub(super) identity: Option<DeviceIdentity>,
    pub(super) mode: Option<Mode>,
    pub(super) controller: Option<ControllerChoice>,
    pub(super) in_force: Option<Settings>,
    pub(super) pending: Option<Settings>,
    pub(super) times: Option<TickTimes>,
    pub(super) traffic: LineCounters,
    pub(super) window: TelemetryWindow,
    /// The newest first.
    pub(super) breaths: VecDeque<BreathSummary>,
    /// The newest first.
    pub(super) alarms: VecDeque<AlarmEntry>,
    pub(super) message: Option<Notice>,
    /// Gains for a device that runs learned weights and is to run a PID.
    gains: PidGains,
    /// Settings asked for that are not answered yet, and how many such requests are under way.
    asked: Option<Settings>,
    under_way: usize,
}

impl View {
    /// Nothing is known yet of the device at `address`; `gains` are those of the PID that replaces a learned controller,
    /// unless the device names others.
    pub fn new(address: impl Into<String>, gains: PidGains) -> Self {
        Self {
            address: address.into(),
            gains,
            window: TelemetryWindow::new(SECONDS, shared::breath::DEFAULT_PERIOD_US),
            ..Self::default()
        }
    }

    /// Takes in a piece of news.
    pub fn take(&mut self, news: &News) {
        match news {
            News::Event(event) => self.happened(event),
            News::Answer { request, result } => self.answered(request, result),
            News::Traffic(traffic) => self.traffic = *traffic,
            News::Lost(reason) => {
                (self.asked, self.under_way) = (None, 0);
                self.lost = Some(reason.clone());
            }
        }
    }

    fn happened(&mut self, event: &Event) {
        match event {
            Event::Telemetry(batch) => self.window.take(batch),
            Event::Breath(breath) => {
                if self.breaths.front().is_some_and(|last| last.breath >= breath.breath) {
                    // Ventilation was started again.
                    self.breaths.clear();
                }
                remember(&mut self.breaths, *breath);
            }
            Event::Alarm { fault, tick } => {
                remember(&mut self.alarms, AlarmEntry { fault: *fault, tick: *tick });
                if fault.alarm().action == Action::Vent {
                    self.mode = Some(Mode::Fault(*fault));
                }
            }
        }
    }

    fn answered(&mut self, request: &Request, result: &Result<Response, String>) {
        if let Request::ApplySettings(_) = request {
            self.under_way = self.under_way.saturating_sub(1);
            if self.under_way == 0 {
                self.asked = None;
            }
        }
        match result {
            Err(reason) => self.message = Some(Notice::Warning(reason.clone())),
            Ok(response) => {
                self.learn(response);
                if !asked_by_itself(request) {
                    self.message = note(response);
                }
            }
        }
    }

    /// Takes in what the device says is in force.
    fn learn(&mut self, response: &Response) {
        match response {
            Response::Identity(identity) => self.greeted(identity),
            Response::Settings { in_force, pending } => {
                (self.in_force, self.pending) = (Some(*in_force), *pending);
            }
            Response::Mode(mode) => self.mode = Some(*mode),
            Response::Controller(choice) => self.chosen(*choice),
            Response::Timing(times) => {
                if self.times.is_some_and(|before| times.ticks < before.ticks) {
                    self.started_anew();
                }
                self.times = Some(*times);
            }
            _ => {}
        }
    }

    fn greeted(&mut self, identity: &DeviceIdentity) {
        if self.lost.take().is_some() {
            self.message = Some(Notice::Note("connected again; nothing was changed on the device".into()));
        }
        if self.identity.as_ref().map(|before| before.period_us) != Some(identity.period_us) {
            self.window = TelemetryWindow::new(SECONDS, identity.period_us);
        }
        self.mode = Some(identity.mode);
        self.chosen(identity.controller);
        self.identity = Some(identity.clone());
    }

    fn chosen(&mut self, choice: ControllerChoice) {
        if let ControllerChoice::Pid(gains) = choice {
            self.gains = gains;
        }
        self.controller = Some(choice);
    }

    /// The tick counter went back: the device was restarted between two looks at it.
    fn started_anew(&mut self) {
        let cause = self.identity.as_ref().map_or("unknown cause", |identity| words::reset(identity.reset));
        self.message = Some(Notice::Warning(format!("the device restarted: {cause}")));
        self.window =
            TelemetryWindow::new(SECONDS, self.identity.as_ref().map_or(0, |identity| identity.period_us));
        self.breaths.clear();
    }

    /// What a key asks of the device; none, with a message, if it can ask nothing now.
    pub fn press(&mut self, key: Key) -> Option<Request> {
        let request = match (&self.lost, self.request(key)) {
            (None, Some(request)) => request,
            (Some(_), _) => return self.hold_back("no connection: nothing was sent"),
            (None, None) => return self.hold_back("the device has not told its state yet: nothing was sent"),
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
        match key {
            Key::StartStop => self.mode.map(|mode| match mode {
                Mode::Ventilating => Request::Stop,
                // The device refuses to start with a fault latched and says what to do.
                Mode::Standby | Mode::Fault(_) => Request::Start,
            }),
            Key::Acknowledge => self.mode.map(|_| Request::Acknowledge),
            Key::PipUp => self.changed(|settings| settings.pip += PIP_STEP),
            Key::PipDown => self.changed(|settings| settings.pip -= PIP_STEP),
            Key::RateUp => self.changed(|settings| settings.rate += RATE_STEP),
            Key::RateDown => self.changed(|settings| settings.rate -= RATE_STEP),
            Key::Controller => self.controller.map(|choice| {
                Request::SetController(match choice {
                    ControllerChoice::Pid(_) => ControllerChoice::Learned,
                    ControllerChoice::Learned => ControllerChoice::Pid(self.gains),
                })
            }),
        }
    }

    /// The settings that would come next, changed; they are the device's to check.
    fn changed(&self, change: impl Fn(&mut Settings)) -> Option<Request> {
        let mut settings = self.asked.or(self.pending).or(self.in_force)?;
        change(&mut settings);
        Some(Request::ApplySettings(settings))
    }

    /// What an operator who leaves should know.
    pub fn farewell(&self) -> String {
        let Self { address, .. } = self;
        match (self.mode, &self.lost) {
            (None, _) => format!("{address} never told what it is doing"),
            (Some(Mode::Ventilating), None) => {
                format!(
                    "{address} goes on ventilating; `trainer monitor --port {address}` shows it, space stops it"
                )
            }
            (Some(Mode::Ventilating), Some(_)) => {
                format!("{address} was ventilating when the connection broke, and goes on if it has power")
            }
            (Some(mode), _) => format!("{address}: {}", words::mode(mode)),
        }
    }
}

fn remember<T>(list: &mut VecDeque<T>, newest: T) {
    list.push_front(newest);
    list.truncate(REMEMBERED);
}

/// Whether the monitor asks this by itself, again and again.
fn asked_by_itself(request: &Request) -> bool {
    use Request::{GetSettings, GetTiming, Identify, Telemetry};
    matches!(request, Identify | GetSettings | GetTiming { .. } | Telemetry { .. })
}

/// What to say about a request that was carried out; nothing where the change shows elsewhere.
fn note(response: &Response) -> Option<Notice> {
    let text = match response {
        Response::Settings { in_force, pending } => {
            let Settings { pip, rate, .. } = pending.unwrap_or(*in_force);
            format!("from the next breath on: PIP {pip} cmH2O, rate {rate} /min")
        }
        Response::Controller(choice) => format!("from the next breath on: {}", words::controller(*choice)),
        _ => return None,
    };
    Some(Notice::Note(text))
}
