//! The half of a device that runs with the control tick.
//!
//! A tick is [`Control::plant_change`] (hardware in the loop only) -> reading -> [`Control::step`] -> valves ->
//! [`Control::report`] -> at most one [`Control::execute`] -> the flight recorder, by [`Control::moment`] ->
//! [`Control::record`]. A request about settings, controller or exploration is built when it is accepted, and refused with a
//! reason if that fails. What was built waits for the breath boundary, so that no breath changes while it runs.

use heapless::Deque;

use super::{ControlReply, ControlReport, ControlRequest, KNOWN_GOOD, Status};
use crate::breath::Breath;
use crate::control::Controller;
use crate::control::pid::Pid;
use crate::control::residual::Residual;
use crate::explore::Exploration;
use crate::link::messages::{ControllerChoice, DeviceKind, Response};
use crate::link::refusal::Refusal;
use crate::link::telemetry::{BreathMeter, Counters};
use crate::recorder::Moment;
use crate::reset::ResetCause;
use crate::safety::alarms::Fault;
use crate::safety::host::HostWatch;
use crate::safety::monitors::Monitors;
use crate::settings::Settings;
use crate::timing::{TickTime, TickTimer};
use crate::ventilator::{Mode, Output, Ventilator, VentilatorState};
use crate::weights::slots::SlotState;

/// Breaths that can wait for their turn.
pub const QUEUE_LENGTH: usize = 16;
/// Ticks between two reports of the counters.
const COUNTERS_EVERY: u64 = 64;

/// Changes that a plant in the place of sensor and valves makes before its next tick.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct PlantChange {
    /// PEEP of the breath that begins, cmH2O, if it is another than before.
    pub peep: Option<f32>,
    /// Restart at rest with this seed, in place of a step.
    pub reset: Option<u64>,
}

/// A controller that was accepted and waits for the breath boundary.
#[derive(Clone, Copy, Debug)]
enum NextController {
    /// This one.
    Pid(Pid),
    /// The stored weights, which are kilobytes long and stay in their place until then.
    Learned,
}

/// The control half.
#[derive(Clone, Debug)]
pub struct Control {
    kind: DeviceKind,
    ventilator: Ventilator,
    state: VentilatorState,
    learned: Option<Residual>,
    status: Status,
    /// Runs from the next breath on.
    next_controller: Option<NextController>,
    queue: Deque<Breath, QUEUE_LENGTH>,
    meter: BreathMeter,
    timer: TickTimer,
    tick: u64,
    dropped: u32,
    host: HostWatch,
    /// Alarms that wait for a tick to report them: two that a start can find, and one of a silent host.
    alarms: Deque<Fault, 3>,
    seed: Option<u64>,
    /// PEEP that the plant was last set to, cmH2O.
    peep: Option<f32>,
}

impl Control {
    /// A device in standby. It runs `learned`, if there are weights for this control period, else a PID of
    /// [`KNOWN_GOOD`] gains; `core_hz` is the unit of the tick times.
    ///
    /// # Errors
    /// [`Refusal::Settings`] for a control period out of bounds.
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
        let (controller, next_controller) = match learned {
            Some(_) => (ControllerChoice::Learned, Some(NextController::Learned)),
            None => (ControllerChoice::Pid(KNOWN_GOOD), None),
        };
        Ok(Self {
            kind,
            ventilator,
            state,
            learned,
            status: Status { mode: Mode::Standby, controller, exploration: None },
            next_controller,
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

    /// Raises with the first ticks the alarms for a start that nobody requested, after a fault of supply or program or in
    /// the middle of ventilation (`interrupted`), and for a slot that holds something other than valid weights.
    pub fn report_boot(&mut self, cause: ResetCause, interrupted: bool, slots: &[SlotState; 2]) {
        if interrupted || matches!(cause, ResetCause::BrownOut | ResetCause::Watchdog) {
            self.raise(Fault::Restarted);
        }
        if slots.iter().any(|slot| matches!(slot, SlotState::Torn | SlotState::Invalid(_))) {
            self.raise(Fault::WeightsRefused);
        }
    }

    fn raise(&mut self, fault: Fault) {
        if self.ventilator.monitors().has(fault) {
            // There is room: each tick takes one, and a host falls silent only once in many.
            let _ = self.alarms.push_back(fault);
        }
    }

    /// The ventilator's state.
    pub fn state(&self) -> &VentilatorState {
        &self.state
    }

    /// Mode of the ventilator.
    pub fn mode(&self) -> Mode {
        self.state.mode()
    }

    /// Changes for the plant to make before this tick's reading is taken.
    pub fn plant_change(&mut self) -> PlantChange {
        let peep = match (self.begins_breath(), self.next_settings()) {
            (true, Some(next)) => next.peep,
            _ => self.state.breath().settings().peep,
        };
        let begins = self.begins_breath() && self.state.breath_number() == 0;
        let reset = if begins { self.seed.take() } else { None };
        let before = self.peep.replace(peep);
        PlantChange { peep: (before != Some(peep)).then_some(peep), reset }
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

    /// The host is gone: nobody watches the exploration.
    #[cold]
    fn go_on_alone(&mut self) {
        self.raise(Fault::HostSilent);
        if self.ventilator.monitors().has(Fault::HostSilent) {
            self.status.exploration = None;
        }
    }

    /// Whether the next step starts a breath.
    fn begins_breath(&self) -> bool {
        self.state.mode() == Mode::Ventilating && self.state.tick() == 0
    }

    /// Hands the ventilator what waited for the breath boundary.
    fn begin_breath(&mut self) {
        if let Some(breath) = self.queue.pop_front() {
            self.state.set_pending(breath);
        }
        self.ventilator.set_exploration(self.status.exploration);
        match (self.next_controller.take(), &self.learned) {
            (Some(NextController::Pid(pid)), _) => self.ventilator.set_controller(Controller::Pid(pid)),
            // Copied straight to its place: each move on the way would cost the tick as much as the network itself.
            (Some(NextController::Learned), Some(residual)) => {
                self.ventilator.set_controller(Controller::Residual(residual.clone()));
            }
            // It was accepted only because there are weights, and they stay.
            (None, _) | (Some(NextController::Learned), None) => {}
        }
    }

    /// Reports what a step did; `room` takes a report or says that there is no room for it.
    #[inline]
    pub fn report(&mut self, output: &Output, room: &mut dyn FnMut(ControlReport) -> bool) {
        let tick = self.tick.wrapping_sub(1);
        let counters = tick.is_multiple_of(COUNTERS_EVERY).then(|| self.counters());
        let before = core::mem::replace(&mut self.status.mode, output.mode);
        let mut send = |report| {
            if !room(report) {
                self.dropped = self.dropped.saturating_add(1);
            }
        };
        if let Some(sample) = output.sample {
            if let Some(summary) = self.meter.take(&sample) {
                send(ControlReport::Breath(summary));
            }
            send(ControlReport::Sample { tick, sample });
        }
        if before == Mode::Ventilating && output.mode != Mode::Ventilating {
            send(ControlReport::Stopped);
        }
        if let (Mode::Fault(_), true) = (output.mode, before != output.mode) {
            self.queue.clear();
        }
        if let Some(fault) = output.alarm {
            send(ControlReport::Alarm { fault, tick });
        }
        if let Some(counters) = counters {
            send(ControlReport::Counters(counters));
        }
    }

    fn counters(&self) -> Counters {
        let (worst_tick_us, mean_tick_us) = self.timer.work_us();
        let (dropped, missed_ticks) = (self.dropped, self.timer.missed());
        Counters { dropped, corrupt_frames: 0, missed_ticks, worst_tick_us, mean_tick_us }
    }

    /// A step for the flight recorder: its reading, its output, and the ticks missed before it.
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

    /// Carries out a request.
    pub fn execute(&mut self, request: &ControlRequest) -> ControlReply {
        self.host.heard();
        let response = match *request {
            ControlRequest::Status => {
                return ControlReply::Status(Status { mode: self.state.mode(), ..self.status });
            }
            ControlRequest::Settings => Ok(self.settings()),
            ControlRequest::Apply(settings) => self.apply(&settings),
            ControlRequest::Queue(settings) => self.enqueue(&settings),
            ControlRequest::Start => self.start(),
            ControlRequest::Stop => Ok(self.stop()),
            ControlRequest::Acknowledge => self.acknowledge(),
            ControlRequest::Controller(choice) => self.choose(choice),
            ControlRequest::Exploration(exploration) => self.explore(exploration),
            ControlRequest::Timing { clear } => Ok(self.timing(clear)),
            ControlRequest::ResetPlant(seed) => self.reset_plant(seed),
        };
        ControlReply::Response(response.unwrap_or_else(Response::Refused))
    }

    fn settings(&self) -> Response {
        Response::Settings {
            in_force: *self.state.breath().settings(),
            pending: self.next_settings().copied(),
        }
    }

    /// Settings of the next breath, if they differ from those in force.
    fn next_settings(&self) -> Option<&Settings> {
        self.queue.front().map(Breath::settings).or(self.state.pending())
    }

    fn apply(&mut self, settings: &Settings) -> Result<Response, Refusal> {
        self.ventilator.apply(&mut self.state, settings)?;
        self.queue.clear();
        Ok(self.settings())
    }

    fn enqueue(&mut self, settings: &Settings) -> Result<Response, Refusal> {
        let breath = Breath::new(settings, self.ventilator.period_us())?;
        self.queue.push_back(breath).map_err(|_| Refusal::QueueFull)?;
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
        let next = match choice {
            ControllerChoice::Pid(gains) => {
                let pid = Pid::new(gains, self.ventilator.period_us()).map_err(|_| Refusal::Gains)?;
                NextController::Pid(pid)
            }
            ControllerChoice::Learned if self.learned.is_none() => return Err(Refusal::NoWeights),
            ControllerChoice::Learned => NextController::Learned,
        };
        (self.status.controller, self.next_controller) = (choice, Some(next));
        Ok(Response::Controller(choice))
    }

    fn explore(&mut self, exploration: Option<Exploration>) -> Result<Response, Refusal> {
        if let Some(exploration) = &exploration {
            exploration.validate().map_err(|_| Refusal::Exploration)?;
        }
        self.status.exploration = exploration;
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
