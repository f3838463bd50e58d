//! The half of a device that runs in every control tick.
//!
//! A tick is [`Control::plant_change`] (for a plant in place of sensor and valves) -> reading -> [`Control::step`] ->
//! valves -> [`Control::report`] -> at most one [`Control::execute`] -> flight recorder ([`Control::moment`]) ->
//! [`Control::record`]. Requests about settings, controller, exploration and sweep are validated on arrival, and refused with a
//! reason if invalid. They take effect at the breath boundary, so that no breath changes while it runs.

use heapless::Deque;

use super::alarm_events::AlarmEvents;
use super::annunciator::{Annunciator, Signals};
use super::self_test::{BootFindings, Check, SelfTest};
use super::{ControlReply, ControlReport, ControlRequest, HostRole, KNOWN_GOOD, Status};
use crate::breath::{Breath, Phase};
use crate::calibration::SensorCorrection;
use crate::control::pid::Pid;
use crate::control::residual::Residual;
use crate::control::{Controller, ControllerState};
use crate::explore::Exploration;
use crate::explore::sines::SineSweep;
use crate::link::messages::{AlarmStatus, ControllerChoice, DeviceKind, Response};
use crate::link::refusal::Refusal;
use crate::link::telemetry::{BreathMeter, Counters, Findings};
use crate::recorder::RecorderInput;
use crate::recorder::keeper::Leave;
use crate::reset::ResetCause;
use crate::safety::alarms::Fault;
use crate::safety::filter::TEST_MAX;
use crate::safety::host::HostWatch;
use crate::safety::monitors::Monitors;
use crate::safety::responses;
use crate::sensor::Readings;
use crate::settings::Settings;
use crate::timing::{TickTime, TickTimer};
use crate::ventilator::{Mode, Output, Ventilator, VentilatorState};
use crate::weights::slots::SlotState;

/// Number of breaths that can be queued.
pub const QUEUE_LENGTH: usize = 16;
/// Ticks between two reports of the counters.
const COUNTERS_EVERY: u64 = 64;

/// Changes that a plant in place of sensor and valves must make before its next step.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct PlantChange {
    /// New PEEP of the breath that begins, cmH2O; none if unchanged.
    pub peep: Option<f32>,
    /// Seed with which to restart at rest, instead of a step.
    pub reset: Option<u64>,
}

/// An accepted controller that waits for the breath boundary.
#[derive(Clone, Copy, Debug)]
enum NextController {
    /// This PID.
    Pid(Pid),
    /// The learned controller in [`Control`], which takes kilobytes and is copied only then.
    Learned,
}

/// The control half of a device.
#[derive(Clone, Debug)]
pub struct Control {
    kind: DeviceKind,
    ventilator: Ventilator,
    state: VentilatorState,
    learned: Option<Residual>,
    status: Status,
    /// Controller from the next breath on; one that is chosen in the last tick before a breath waits for the one after it.
    next_controller: Option<NextController>,
    queue: Deque<Breath, QUEUE_LENGTH>,
    meter: BreathMeter,
    timer: TickTimer,
    tick: u64,
    dropped: u32,
    host: HostWatch,
    annunciator: Annunciator,
    alarm_events: AlarmEvents,
    self_test: SelfTest,
    /// Correction of the airway sensor, if the unit is calibrated.
    correction: Option<SensorCorrection>,
    /// Correction from the next start of ventilation on.
    next_correction: Option<SensorCorrection>,
    /// Whether a host has sent settings in this standby. Fulfils: chosen-settings.
    confirmed: bool,
    seed: Option<u64>,
    /// PEEP last sent to the plant, cmH2O.
    peep: Option<f32>,
}

impl Control {
    /// A device in standby that runs a PID with [`KNOWN_GOOD`] gains. `core_hz` is the clock frequency of the tick times.
    ///
    /// # Errors
    /// [`Refusal::Settings`] if the control period is out of bounds.
    pub fn new(kind: DeviceKind, period_us: u32, core_hz: u32) -> Result<Self, Refusal> {
        let pid = Pid::new(KNOWN_GOOD, period_us).map_err(|_| Refusal::Gains)?;
        let breath = Breath::new(&Settings::default(), period_us)?;
        Ok(Self::standby(kind, period_us, core_hz, pid, breath))
    }

    /// A device in standby that runs a PID. Not inlined, and apart from its errors: it is built in the caller's place.
    #[expect(
        clippy::redundant_closure,
        reason = "what the function itself returns is built on the stack and copied"
    )]
    #[inline(never)]
    fn standby(kind: DeviceKind, period_us: u32, core_hz: u32, pid: Pid, breath: Breath) -> Self {
        Self {
            kind,
            // No variables, which would be copied from the stack; the smallest one is nearly used up here.
            ventilator: with_pid(period_us, pid),
            state: VentilatorState::at_rest(breath, || ControllerState::new()),
            learned: None,
            status: Status {
                mode: Mode::Standby,
                moves_valves: false,
                resumes: false,
                controller: ControllerChoice::Pid(KNOWN_GOOD),
                exploration: None,
                sweep: None,
            },
            next_controller: None,
            queue: Deque::new(),
            meter: BreathMeter::default(),
            timer: TickTimer::new(core_hz),
            tick: 0,
            dropped: 0,
            host: HostWatch::new(period_us),
            annunciator: Annunciator::new(period_us),
            alarm_events: AlarmEvents::new(period_us),
            self_test: SelfTest::none(period_us),
            correction: None,
            next_correction: None,
            confirmed: false,
            seed: None,
            peep: None,
        }
    }

    /// Lets the first breath run the learned controller, if it was made for this control period. Apart from [`Self::new`],
    /// because it is copied into place here: built together, they would need twice the stack.
    pub fn learn(&mut self, learned: &Residual) {
        if learned.spec().period_us == self.period_us() {
            self.learned = Some(learned.clone());
            self.status.controller = ControllerChoice::Learned;
            self.next_controller = Some(NextController::Learned);
        }
    }

    /// Enables only these monitors, for a plant that does not behave like a ventilator.
    #[must_use]
    pub fn with_monitors(mut self, monitors: Monitors) -> Self {
        self.ventilator = self.ventilator.with_monitors(monitors);
        self
    }

    /// Raises in the first ticks the alarms for an unrequested start (after a supply dip, by the watchdog, or during
    /// ventilation: `interrupted`), and for a slot with torn or invalid weights. Fulfils: restarted, weights-refused.
    pub fn report_boot(&mut self, cause: ResetCause, interrupted: bool, slots: &[SlotState; 2]) {
        if interrupted || matches!(cause, ResetCause::BrownOut | ResetCause::Watchdog) {
            self.raise(Fault::Restarted);
        }
        if slots.iter().any(|slot| matches!(slot, SlotState::Torn | SlotState::Invalid(_))) {
            self.raise(Fault::WeightsRefused);
        }
    }

    /// Lets ventilation start only after the self-test, which begins with what the start of the chip has found.
    pub fn require_self_test(&mut self, boot: &BootFindings) {
        self.self_test = SelfTest::after_boot(self.ventilator.period_us(), boot);
    }

    /// Corrects the airway sensor's readings from the first tick on. Call it before that.
    pub fn calibrate(&mut self, correction: SensorCorrection) {
        self.correction = Some(correction);
    }

    fn raise(&mut self, fault: Fault) {
        self.ventilator.raise(&mut self.state, fault);
    }

    /// What must outlast a reset: the settings in force while ventilating.
    pub fn prescription(&self) -> Option<Settings> {
        (self.state.mode() == Mode::Ventilating).then(|| *self.state.breath().settings())
    }

    /// Resumes the ventilation that a reset has interrupted, with the PID alone until clean breaths lead up the ladder.
    ///
    /// # Errors
    /// [`Refusal::Settings`] for settings out of bounds; the device then stays in standby.
    pub fn resume(&mut self, prescription: &Settings) -> Result<(), Refusal> {
        self.ventilator.apply(&mut self.state, prescription)?;
        if self.ventilator.monitors().responses().has(responses::Response::Resume) {
            self.change_controller();
            self.state.resume();
        }
        Ok(())
    }

    /// Control period, us.
    pub fn period_us(&self) -> u32 {
        self.ventilator.period_us()
    }

    /// The ventilator's state.
    pub fn state(&self) -> &VentilatorState {
        &self.state
    }

    /// Mode of the ventilator.
    pub fn mode(&self) -> Mode {
        self.state.mode()
    }

    /// What may be done to the flash ([`Status::leave`]). Where ventilation may wait to resume, ask
    /// [`super::prescription::Prescription::leave`].
    #[inline]
    pub fn leave(&self) -> Leave {
        self.status().leave()
    }

    /// Changes that the plant must make before this tick's reading.
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

    /// Runs one step of the ventilator with the sensors' readings; a pressure alone is that of the airway sensor, cmH2O.
    #[inline]
    pub fn step(&mut self, readings: impl Into<Readings>) -> Output {
        if self.begins_breath() {
            self.begin_breath();
        }
        if self.next_controller.is_some() && !self.inspires() {
            self.change_controller();
        }
        self.tick = self.tick.wrapping_add(1);
        if self.host.is_gone(self.state.mode() == Mode::Ventilating) {
            self.go_on_alone();
        }
        let readings = self.corrected(readings.into());
        let mut output = self.ventilator.step(&mut self.state, readings);
        if output.mode != Mode::Ventilating {
            let alarm = output.alarm.is_some() || output.mode != Mode::Standby;
            let command = self.self_test.step(&readings, self.state.breath().settings(), alarm);
            output.command = command.unwrap_or(output.command);
            debug_assert!(
                output.command.u_in() <= TEST_MAX,
                "only the self-test lets gas in without a breath"
            );
        }
        if output.alarm.is_some() && self.state.bars_sines() {
            self.status.sweep = None;
        }
        self.annunciator.step(self.state.indications());
        output
    }

    /// The readings as the ventilator sees them. Without a calibration nothing but the zeros changes a bit.
    #[inline]
    fn corrected(&self, readings: Readings) -> Readings {
        let airway = self.correction.map_or(readings.airway, |sensor| sensor.corrected(readings.airway));
        self.self_test.zeroed(Readings { airway, ..readings })
    }

    /// Levels of the sounder and the lamps after the last step.
    pub fn signals(&self) -> Signals {
        self.annunciator.signals()
    }

    /// Handles a silent host: raises the alarm and ends exploration and sweep, which nobody supervises any more.
    #[cold]
    fn go_on_alone(&mut self) {
        self.raise(Fault::HostSilent);
        if self.ventilator.monitors().has(Fault::HostSilent) {
            (self.status.exploration, self.status.sweep) = (None, None);
        }
    }

    /// Whether the next step starts a breath.
    fn begins_breath(&self) -> bool {
        self.state.mode() == Mode::Ventilating && self.state.tick() == 0
    }

    /// Passes pending settings and exploration to the ventilator.
    fn begin_breath(&mut self) {
        if let Some(breath) = self.queue.pop_front() {
            self.state.set_pending(breath);
        }
        self.ventilator.set_exploration(self.status.exploration);
        self.status.sweep = self.status.sweep.filter(|sweep| !sweep.has_ended(self.state.breath_number()));
        self.ventilator.set_sweep(self.status.sweep);
    }

    /// Whether the next step runs a tick of an inspiration.
    fn inspires(&self) -> bool {
        let phase = self.state.breath().phase(self.state.tick());
        self.state.mode() == Mode::Ventilating && phase == Phase::Inspiration
    }

    /// Passes a pending controller to the ventilator. Not within an inspiration, where it would change the controller of the
    /// running breath, and where the ticks have no time for the copy. Not inlined, so that the stack holds no copy of its own.
    #[inline(never)]
    fn change_controller(&mut self) {
        let lacks = matches!(self.next_controller, Some(NextController::Learned)) && self.learned.is_none();
        debug_assert!(!lacks, "the weights stay from the request on");
        match (self.next_controller.take(), &self.learned) {
            (Some(NextController::Pid(pid)), _) => self.ventilator.set_controller(Controller::Pid(pid)),
            // Copied directly to its destination: each further move would take as long as running the network.
            (Some(NextController::Learned), Some(residual)) => {
                self.ventilator.set_controller(Controller::Residual(residual.clone()));
            }
            // The second pattern cannot occur: the request was accepted because weights are loaded, and they stay.
            (None, _) | (Some(NextController::Learned), None) => {}
        }
    }

    /// Reports the results of a step through `room`, which returns false if it has no room for a report. Alarms that found no
    /// room before come first, so that no sample takes their place.
    #[inline]
    pub fn report(&mut self, output: &Output, room: &mut dyn FnMut(ControlReport) -> bool) {
        let tick = self.tick.wrapping_sub(1);
        let counters = tick.is_multiple_of(COUNTERS_EVERY).then(|| self.counters());
        let before = core::mem::replace(&mut self.status.mode, output.mode);
        let waiting = self.alarm_events.are_waiting();
        if waiting {
            self.alarm_events.report(room);
        }
        let mut send = |report| {
            if !room(report) {
                self.dropped = self.dropped.saturating_add(1);
            }
        };
        if let Some(sample) = output.sample {
            if let Some(summary) = self.meter.take(&sample, || findings(&self.state)) {
                send(ControlReport::Breath(summary));
            }
            send(ControlReport::Sample { tick, sample });
        }
        if before == Mode::Ventilating && output.mode != Mode::Ventilating {
            send(ControlReport::Stopped);
        }
        if let (Mode::Fault(_), true) = (output.mode, before != output.mode) {
            self.queue.clear();
            self.confirmed = false;
        }
        if let Some(counters) = counters {
            send(ControlReport::Counters(counters));
        }
        if let Some(fault) = output.alarm {
            self.alarm_events.begin(fault, tick);
        }
        self.alarm_events.tick(self.state.indications().unacknowledged());
        if !waiting && self.alarm_events.are_waiting() {
            self.alarm_events.report(room);
        }
    }

    fn counters(&self) -> Counters {
        let (worst_tick_us, mean_tick_us) = self.timer.work_us();
        let (dropped, missed_ticks) = (self.dropped, self.timer.missed());
        Counters { dropped, corrupt_frames: 0, missed_ticks, worst_tick_us, mean_tick_us }
    }

    /// The flight recorder's input for a step: the airway sensor's reading, output, and the ticks missed before it.
    #[inline]
    pub fn moment<'a>(&'a self, reading: f32, output: &'a Output, missed: u32) -> RecorderInput<'a> {
        let learned = self.status.controller == ControllerChoice::Learned;
        let reading = self.corrected(reading.into()).airway;
        RecorderInput {
            reading,
            output,
            settings: self.state.breath().settings(),
            learned,
            lesson: self.state.lesson(),
            missed,
        }
    }

    /// Records the times of a tick.
    #[inline]
    pub fn record(&mut self, time: &TickTime) {
        let before = self.timer.missed();
        self.timer.record(time);
        self.ventilator.missed(&mut self.state, self.timer.missed().saturating_sub(before));
    }

    /// Executes a request of the host that steers.
    pub fn execute(&mut self, request: &ControlRequest) -> ControlReply {
        self.execute_for(request, HostRole::Steers)
    }

    /// Executes a request of a host. One that only reads supervises no exploration of another host.
    pub fn execute_for(&mut self, request: &ControlRequest, role: HostRole) -> ControlReply {
        let supervises = match role {
            HostRole::Steers => true,
            HostRole::Attends => self.status.exploration.is_none() && self.status.sweep.is_none(),
            HostRole::Reads => false,
        };
        if supervises {
            self.host.heard();
        }
        let response = match *request {
            ControlRequest::Status => {
                return ControlReply::Status(self.status());
            }
            ControlRequest::Calibrate(correction) => {
                self.next_correction = Some(correction);
                return ControlReply::Status(self.status());
            }
            ControlRequest::Settings => Ok(self.settings()),
            ControlRequest::Apply(settings) => self.apply(&settings),
            ControlRequest::Queue(settings) => self.enqueue(&settings),
            ControlRequest::Start => self.start(),
            ControlRequest::Stop => Ok(self.stop()),
            ControlRequest::Acknowledge => self.acknowledge(),
            ControlRequest::Controller(choice) => self.choose(choice),
            ControlRequest::Exploration(exploration) => self.explore(exploration),
            ControlRequest::Sweep(sweep) => self.sweep(sweep),
            ControlRequest::Timing { clear } => Ok(self.timing(clear)),
            ControlRequest::ResetPlant(seed) => self.reset_plant(seed),
            ControlRequest::Alarms => Ok(Response::Alarms(self.alarms())),
            ControlRequest::PauseAudio(seconds) => self.annunciator.pause(seconds).map(Response::Audio),
            ControlRequest::SelfTest(check) => self.test(check),
            ControlRequest::Audio => Ok(Response::Audio(self.annunciator.status())),
        };
        ControlReply::Response(response.unwrap_or_else(Response::Refused))
    }

    #[inline]
    fn status(&self) -> Status {
        let (mode, moves_valves) = (self.state.mode(), self.self_test.moves_valves());
        Status { mode, moves_valves, ..self.status }
    }

    fn settings(&self) -> Response {
        Response::Settings {
            in_force: *self.state.breath().settings(),
            pending: self.next_settings().copied(),
        }
    }

    /// Settings that wait for the next breath.
    fn next_settings(&self) -> Option<&Settings> {
        self.queue.front().map(Breath::settings).or(self.state.pending())
    }

    fn apply(&mut self, settings: &Settings) -> Result<Response, Refusal> {
        self.ventilator.apply(&mut self.state, settings)?;
        self.queue.clear();
        self.confirmed = true;
        Ok(self.settings())
    }

    fn enqueue(&mut self, settings: &Settings) -> Result<Response, Refusal> {
        let breath = Breath::new(settings, self.ventilator.period_us())?;
        self.queue.push_back(breath).map_err(|_| Refusal::QueueFull)?;
        self.confirmed = true;
        Ok(Response::Queued { free: (QUEUE_LENGTH - self.queue.len()) as u8 })
    }

    fn start(&mut self) -> Result<Response, Refusal> {
        if let Mode::Fault(_) = self.state.mode() {
            return Err(Refusal::FaultLatched);
        }
        if self.state.mode() == Mode::Standby {
            // Before the first tick nothing is known about the sensors. Fulfils: sensor-at-start.
            if self.tick > 0 && !self.state.has_sensor() {
                return Err(Refusal::NoSensor);
            }
            self.self_test.permit()?;
            if !self.confirmed {
                return Err(Refusal::NotConfirmed);
            }
            self.meter = BreathMeter::default();
            self.change_controller();
            self.change_correction();
            self.state.start();
        }
        Ok(Response::Mode(self.state.mode()))
    }

    /// Puts a new calibration in force. It measures the sensor's zero too, so it replaces that of an earlier check.
    fn change_correction(&mut self) {
        if let Some(correction) = self.next_correction.take() {
            self.correction = Some(correction);
            self.self_test.forget_airway_zero();
        }
    }

    fn stop(&mut self) -> Response {
        self.state.stop();
        self.self_test.abort();
        self.queue.clear();
        self.confirmed = false;
        // It counts the breaths of this ventilation.
        self.status.sweep = None;
        Response::Mode(self.state.mode())
    }

    fn acknowledge(&mut self) -> Result<Response, Refusal> {
        if self.state.acknowledge() { Ok(Response::Mode(self.state.mode())) } else { Err(Refusal::NoFault) }
    }

    fn test(&mut self, check: Option<Check>) -> Result<Response, Refusal> {
        match (check, self.state.mode()) {
            (None, _) => {}
            (Some(_), Mode::Ventilating) => return Err(Refusal::Ventilating),
            (Some(_), Mode::Fault(_)) => return Err(Refusal::FaultLatched),
            (Some(check), Mode::Standby) => self.self_test.begin(check)?,
        }
        Ok(Response::SelfTest(self.self_test.report()))
    }

    fn alarms(&self) -> AlarmStatus {
        let alarms = self.state.indications();
        AlarmStatus { present: alarms.present(), indicated: alarms.indicated(), level: self.state.level() }
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
        (self.status.exploration, self.status.sweep) = (exploration, None);
        Ok(Response::Exploration(exploration))
    }

    fn sweep(&mut self, sweep: Option<SineSweep>) -> Result<Response, Refusal> {
        if let Some(sweep) = &sweep {
            sweep.validate()?;
            if self.state.bars_sines() {
                return Err(Refusal::AlarmPresent);
            }
        }
        (self.status.exploration, self.status.sweep) = (None, sweep);
        Ok(Response::Sweep(sweep))
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

/// A ventilator that runs a PID. Not inlined: it is built in the caller's place.
#[inline(never)]
fn with_pid(period_us: u32, pid: Pid) -> Ventilator {
    Ventilator::new(period_us, Controller::Pid(pid))
}

/// What the ventilator has found out by the end of a breath.
fn findings(state: &VentilatorState) -> Findings {
    Findings { leak: state.leak(), lesson: state.lesson(), adopted: state.adopted() }
}
