//! The half of a device that runs with the control tick.
//!
//! A tick is [`Control::cue`] (hardware in the loop only) -> reading -> [`Control::step`] -> valves ->
//! [`Control::report`] -> at most one [`Control::execute`] -> the flight recorder, by [`Control::moment`] ->
//! [`Control::record`]. Orders about settings, controller and exploration wait for the breath boundary, so that no breath
//! changes while it runs.

use heapless::Deque;

use super::timing::{TickTime, TickTimer};
use super::{Answer, KNOWN_GOOD, Order, Report, Start, Status};
use crate::breath::Breath;
use crate::control::Controller;
use crate::control::pid::Pid;
use crate::control::residual::Residual;
use crate::explore::Exploration;
use crate::link::messages::{ControllerChoice, DeviceKind, Response};
use crate::link::refusal::Refusal;
use crate::link::telemetry::{BreathMeter, Counters};
use crate::recorder::Moment;
use crate::safety::alarms::Fault;
use crate::safety::host::HostWatch;
use crate::safety::monitors::Monitors;
use crate::settings::Settings;
use crate::ventilator::{Mode, Output, Ventilator, VentilatorState};

/// Settings that can wait for their breaths.
pub const QUEUE_LENGTH: usize = 16;
/// Ticks between two reports of the counters.
const COUNTERS_EVERY: u64 = 64;

/// What a plant that takes the place of sensor and valves has to be told before the next tick.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Cue {
    /// PEEP of the breath that begins, cmH2O, if it is another than before.
    pub peep: Option<f32>,
    /// Start anew, at rest, with this seed; comes in place of a step.
    pub reset: Option<u64>,
}

/// The control half.
#[derive(Clone, Debug)]
pub struct Control {
    kind: DeviceKind,
    ventilator: Ventilator,
    state: VentilatorState,
    learned: Option<Residual>,
    status: Status,
    /// Whether `status` differs from what the ventilator runs.
    changed: bool,
    queue: Deque<Settings, QUEUE_LENGTH>,
    meter: BreathMeter,
    timer: TickTimer,
    tick: u64,
    dropped: u32,
    host: HostWatch,
    /// Alarms that wait to be told.
    alarms: Deque<Fault, 2>,
    seed: Option<u64>,
    /// PEEP that the plant was told last, cmH2O.
    peep: Option<f32>,
}

impl Control {
    /// A device in standby. It runs `learned`, if there are weights for this control period, else a PID of
    /// [`KNOWN_GOOD`] gains; `core_hz` is the unit of the tick times.
    ///
    /// # Errors
    /// [`Refusal::Settings`] for a control period that cannot be.
    pub fn new(
        kind: DeviceKind,
        period_us: u32,
        learned: Option<Residual>,
        core_hz: u32,
    ) -> Result<Self, Refusal> {
        let pid = Pid::new(KNOWN_GOOD, period_us).map_err(|_| Refusal::Gains)?;
        let ventilator = Ventilator::new(period_us, Controller::Pid(pid));
        let state = ventilator.standby(&Settings::default())?;
        let learned = learned.filter(|residual| residual.spec().period_us == period_us);
        let controller = match learned {
            Some(_) => ControllerChoice::Learned,
            None => ControllerChoice::Pid(KNOWN_GOOD),
        };
        Ok(Self {
            kind,
            ventilator,
            state,
            learned,
            status: Status { mode: Mode::Standby, controller, exploration: None },
            changed: true,
            queue: Deque::new(),
            meter: BreathMeter::default(),
            timer: TickTimer::new(core_hz),
            tick: 0,
            dropped: 0,
            host: HostWatch::new(period_us),
            alarms: Deque::new(),
            seed: None,
            peep: None,
        })
    }

    /// The same with these monitors alone, for a plant that is no ventilator.
    #[must_use]
    pub fn with_monitors(mut self, monitors: Monitors) -> Self {
        self.ventilator = self.ventilator.with_monitors(monitors);
        self
    }

    /// Tells with the first ticks what the start has found.
    pub fn started(&mut self, start: &Start) {
        let found = [(Fault::Restarted, start.by_itself()), (Fault::WeightsRefused, start.refused_weights())];
        for (fault, _) in found.into_iter().filter(|(_, is)| *is) {
            self.tell(fault);
        }
    }

    fn tell(&mut self, fault: Fault) {
        if self.ventilator.monitors().has(fault) {
            // There is room for what a start can find and for what a tick can.
            let _ = self.alarms.push_back(fault);
        }
    }

    /// The ventilator's state.
    pub fn state(&self) -> &VentilatorState {
        &self.state
    }

    /// What the ventilator is doing.
    pub fn mode(&self) -> Mode {
        self.state.mode()
    }

    /// What a plant must be told before this tick's reading is taken.
    pub fn cue(&mut self) -> Cue {
        let peep = match (self.begins_breath(), self.queue.front().or(self.state.pending())) {
            (true, Some(next)) => next.peep,
            _ => self.state.breath().settings().peep,
        };
        let begins = self.begins_breath() && self.state.breath_number() == 0;
        let reset = if begins { self.seed.take() } else { None };
        let told = self.peep.replace(peep);
        Cue { peep: (told != Some(peep)).then_some(peep), reset }
    }

    /// One step of the ventilator with the pressure reading in cmH2O.
    #[inline]
    pub fn step(&mut self, reading: f32) -> Output {
        if self.begins_breath() {
            self.begin_breath();
        }
        self.tick = self.tick.wrapping_add(1);
        if self.host.is_gone(self.state.mode() == Mode::Ventilating) {
            self.go_on_alone();
        }
        let mut output = self.ventilator.step(&mut self.state, reading);
        if output.alarm.is_none() {
            output.alarm = self.alarms.pop_front();
        }
        output
    }

    /// The host is gone: nobody watches what exploration does.
    #[cold]
    fn go_on_alone(&mut self) {
        self.tell(Fault::HostSilent);
        if self.ventilator.monitors().has(Fault::HostSilent) {
            (self.status.exploration, self.changed) = (None, true);
        }
    }

    /// Whether the next step starts a breath.
    fn begins_breath(&self) -> bool {
        self.state.mode() == Mode::Ventilating && self.state.tick() == 0
    }

    /// Hands the ventilator what waited for the breath boundary.
    fn begin_breath(&mut self) {
        if let Some(settings) = self.queue.pop_front() {
            // They were validated when they came.
            let _ = self.ventilator.apply(&mut self.state, &settings);
        }
        if self.changed {
            self.changed = false;
            self.ventilator.set_exploration(self.status.exploration);
            self.choose_controller();
        }
    }

    /// Hands the ventilator the controller that was chosen. A learned one is copied straight to its place: it is kilobytes
    /// long, and each move on the way would cost the tick as much as the network itself.
    fn choose_controller(&mut self) {
        match (self.status.controller, &self.learned) {
            (ControllerChoice::Pid(gains), _) => {
                // They were validated when they came.
                if let Ok(pid) = Pid::new(gains, self.ventilator.period_us()) {
                    self.ventilator.set_controller(Controller::Pid(pid));
                }
            }
            (ControllerChoice::Learned, Some(residual)) => {
                self.ventilator.set_controller(Controller::Residual(residual.clone()));
            }
            (ControllerChoice::Learned, None) => {}
        }
    }

    /// Reports what a step did; `room` takes a report or says that there is no room for it.
    #[inline]
    pub fn report(&mut self, output: &Output, room: &mut dyn FnMut(Report) -> bool) {
        let tick = self.tick.wrapping_sub(1);
        let counters = tick.is_multiple_of(COUNTERS_EVERY).then(|| self.counters());
        let before = core::mem::replace(&mut self.status.mode, output.mode);
        let mut tell = |report| {
            if !room(report) {
                self.dropped = self.dropped.saturating_add(1);
            }
        };
        if let Some(sample) = output.sample {
            if let Some(summary) = self.meter.take(&sample) {
                tell(Report::Breath(summary));
            }
            tell(Report::Sample { tick, sample });
        }
        if before == Mode::Ventilating && output.mode != Mode::Ventilating {
            tell(Report::Stopped);
        }
        if let (Mode::Fault(_), true) = (output.mode, before != output.mode) {
            self.queue.clear();
        }
        if let Some(fault) = output.alarm {
            tell(Report::Alarm { fault, tick });
        }
        if let Some(counters) = counters {
            tell(Report::Counters(counters));
        }
    }

    fn counters(&self) -> Counters {
        let (worst_tick_us, mean_tick_us) = self.timer.work_us();
        let (dropped, missed_ticks) = (self.dropped, self.timer.missed());
        Counters { dropped, corrupt_frames: 0, missed_ticks, worst_tick_us, mean_tick_us }
    }

    /// What a step did, for the flight recorder: the reading that it was given, its output, and the ticks missed before it.
    #[inline]
    pub fn moment<'a>(&'a self, reading: f32, output: &'a Output, missed: u32) -> Moment<'a> {
        let learned = self.status.controller == ControllerChoice::Learned;
        Moment { reading, output, settings: self.state.breath().settings(), learned, missed }
    }

    /// Takes in how long a tick took.
    #[inline]
    pub fn record(&mut self, time: &TickTime) {
        let before = self.timer.missed();
        self.timer.record(time);
        self.ventilator.missed(&mut self.state, self.timer.missed().saturating_sub(before));
    }

    /// Carries out an order.
    pub fn execute(&mut self, order: &Order) -> Answer {
        self.host.heard();
        let response = match *order {
            Order::Status => return Answer::Status(Status { mode: self.state.mode(), ..self.status }),
            Order::Settings => Ok(self.settings()),
            Order::Apply(settings) => self.apply(&settings),
            Order::Queue(settings) => self.enqueue(&settings),
            Order::Start => self.start(),
            Order::Stop => Ok(self.stop()),
            Order::Acknowledge => self.acknowledge(),
            Order::Controller(choice) => self.choose(choice),
            Order::Exploration(exploration) => self.explore(exploration),
            Order::Timing { clear } => Ok(self.timing(clear)),
            Order::ResetPlant(seed) => self.reset_plant(seed),
        };
        Answer::Host(response.unwrap_or_else(Response::Refused))
    }

    fn settings(&self) -> Response {
        let pending = self.queue.front().or(self.state.pending());
        Response::Settings { in_force: *self.state.breath().settings(), pending: pending.copied() }
    }

    fn apply(&mut self, settings: &Settings) -> Result<Response, Refusal> {
        self.ventilator.apply(&mut self.state, settings)?;
        self.queue.clear();
        Ok(self.settings())
    }

    fn enqueue(&mut self, settings: &Settings) -> Result<Response, Refusal> {
        Breath::new(settings, self.ventilator.period_us())?;
        self.queue.push_back(*settings).map_err(|_| Refusal::QueueFull)?;
        Ok(Response::Queued { free: (QUEUE_LENGTH - self.queue.len()) as u8 })
    }

    fn start(&mut self) -> Result<Response, Refusal> {
        if let Mode::Fault(_) = self.state.mode() {
            return Err(Refusal::FaultLatched);
        }
        if self.state.mode() == Mode::Standby {
            self.meter = BreathMeter::default();
            self.state.start();
        }
        Ok(Response::Mode(self.state.mode()))
    }

    fn stop(&mut self) -> Response {
        self.state.stop();
        self.queue.clear();
        Response::Mode(self.state.mode())
    }

    fn acknowledge(&mut self) -> Result<Response, Refusal> {
        let Mode::Fault(_) = self.state.mode() else {
            return Err(Refusal::NoFault);
        };
        self.state.acknowledge();
        Ok(Response::Mode(self.state.mode()))
    }

    fn choose(&mut self, choice: ControllerChoice) -> Result<Response, Refusal> {
        match choice {
            ControllerChoice::Pid(gains) => {
                Pid::new(gains, self.ventilator.period_us()).map_err(|_| Refusal::Gains)?;
            }
            ControllerChoice::Learned if self.learned.is_none() => return Err(Refusal::NoWeights),
            ControllerChoice::Learned => {}
        }
        (self.status.controller, self.changed) = (choice, true);
        Ok(Response::Controller(choice))
    }

    fn explore(&mut self, exploration: Option<Exploration>) -> Result<Response, Refusal> {
        if let Some(exploration) = &exploration {
            exploration.validate().map_err(|_| Refusal::Exploration)?;
        }
        (self.status.exploration, self.changed) = (exploration, true);
        Ok(Response::Exploration(exploration))
    }

    fn timing(&mut self, clear: bool) -> Response {
        let times = self.timer.times();
        if clear {
            self.timer.clear();
        }
        Response::Timing(times)
    }

    fn reset_plant(&mut self, seed: u64) -> Result<Response, Refusal> {
        if self.kind == DeviceKind::Ventilator {
            return Err(Refusal::NoPlant);
        }
        self.seed = Some(seed);
        Ok(Response::Done)
    }
}
