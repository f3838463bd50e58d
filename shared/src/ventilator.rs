//! The ventilator: a pure state machine that connects controller and supervisor, with one [`Ventilator::step`] per
//! control tick.
//!
//! # Modes
//! *Standby*: valves safe, no breath runs. *Ventilating*: breath follows breath, also without a pressure reading. *Fault*:
//! latched safe state, only for faults with which ventilating on would harm; [`VentilatorState::acknowledge`] ends it, and
//! leads to standby.
//!
//! # Breath
//! Settings sent while ventilating take effect when the next breath starts. The controller runs during the
//! inspiration; in fall and expiration the expiratory valve is open, the mechanical PEEP valve holds PEEP, and the
//! inspiratory valve is closed (fall) or at its bias (expiration). A flow that makes up for a leak is added to the bias, in the fall too.
//!
//! # Order of a tick
//! The supervisor checks the readings -> controller -> exploration -> safety filter -> the controller records the
//! applied command, without a sine that measures the loop. What the checks allow the tick is one [`Belief`], which
//! the safety filter takes back. Any [`ControlLaw`] can be the controller; order and safety are the same for all.
//! Down the ladder of trust a PID of the ventilator's own or backup ventilation commands in its place.

use serde::{Deserialize, Serialize};

use crate::breath::{Breath, Phase};
use crate::control::memory::{self, Lesson};
use crate::control::pid::{Pid, PidState};
use crate::control::{COMMAND_MAX, ControlLaw, ControlOutput, Controller, ControllerState, Observation};
use crate::explore::sines::SineSweep;
use crate::explore::{Addition, Exploration};
use crate::math;
use crate::safety::alarms::Fault;
use crate::safety::filter::ValveCommand;
use crate::safety::indications::Indications;
use crate::safety::ladder::Level;
use crate::safety::monitors::Monitors;
use crate::safety::supervisor::{Belief, Supervisor, SupervisorState};
use crate::sensor::Readings;
use crate::settings::{Settings, SettingsError};
use crate::trigger::{Sign, Trigger, TriggerState};

/// Breaths at the start that follow the clock alone: a leak is not known yet, and its sag looks like an effort.
const FIRST_BREATHS: u32 = 1;

/// Mode of the ventilator.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Mode {
    /// Valves safe, waiting for the start.
    Standby,
    /// Ventilating breath by breath.
    Ventilating,
    /// Latched safe state, with the fault that caused it.
    Fault(Fault),
}

/// Record of one tick, for telemetry and recordings.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sample {
    /// Number of the breath since the start of ventilation, from 0.
    pub breath: u32,
    /// Tick within the breath.
    pub tick: u32,
    /// Phase of the breath.
    pub phase: Phase,
    /// Target, cmH2O.
    pub target: f32,
    /// Pressure as read by the sensor in use, cmH2O; without a sound one that of the airway sensor.
    pub pressure: f32,
    /// Command sent to the inspiratory valve, percent.
    pub u_in: f32,
    /// Whether the expiratory valve is open.
    pub u_out: bool,
    /// Perturbation that exploration added to the controller's output, percent.
    pub explore: f32,
    /// Learned part of the controller's command before the safety filter, percent; 0 unless the learned controller commands.
    pub learned: f32,
    /// Flow towards the patient as the flow sensor reads it, L/s; none without a reading.
    pub flow: Option<f32>,
}

/// Opening of the expiratory valve, which only opens and closes, percent.
pub const fn opening(u_out: bool) -> f32 {
    if u_out { 100.0 } else { 0.0 }
}

/// What commands a tick, before the safety filter.
struct Command {
    output: ControlOutput,
    /// Parts of it as in [`Sample`], percent.
    explore: f32,
    learned: f32,
}

impl Command {
    /// A command without a learned part and a perturbation, percent.
    const fn plain(command: f32) -> Self {
        Self { output: ControlOutput::plain(command), explore: 0.0, learned: 0.0 }
    }
}

/// Output of a tick.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Output {
    /// Command for the valves.
    pub command: ValveCommand,
    /// Mode after the tick.
    pub mode: Mode,
    /// Sample of the tick; none outside ventilation.
    pub sample: Option<Sample>,
    /// Alarm that begins in this tick.
    pub alarm: Option<Fault>,
}

/// Configuration of a ventilator: control period, controller, exploration, supervisor. Changing it does not change the
/// state, and so does not interrupt the running breath.
#[derive(Clone, Debug)]
pub struct Ventilator<C = Controller> {
    period_us: u32,
    controller: C,
    /// The PID to which the ladder falls.
    spare: Pid,
    exploration: Option<Exploration>,
    /// In its breaths, in place of the exploration.
    sweep: Option<SineSweep>,
    supervisor: Supervisor,
    trigger: Trigger,
}

/// State of a ventilator: everything that changes from tick to tick.
#[derive(Clone, Debug)]
pub struct VentilatorState<S = ControllerState> {
    mode: Mode,
    breath: Breath,
    pending: Option<Breath>,
    number: u32,
    tick: u32,
    last_command: f32,
    addition: Addition,
    controller: S,
    spare: PidState,
    supervisor: SupervisorState,
    trigger: TriggerState,
    /// Whether something has disturbed the running inspiration; none outside one.
    disturbed: Option<bool>,
    /// What the controller last learned.
    lesson: Lesson,
}

impl<C: ControlLaw> Ventilator<C> {
    /// A ventilator with a control period in microseconds.
    pub fn new(period_us: u32, controller: C) -> Self {
        let supervisor = Supervisor::new(period_us, Monitors::ALL);
        Self {
            period_us,
            controller,
            spare: Pid::known_good(period_us),
            exploration: None,
            sweep: None,
            supervisor,
            trigger: Trigger::new(period_us),
        }
    }

    /// Enables only these monitors: for a plant that does not behave like a ventilator, or to show what a monitor prevents.
    #[must_use]
    pub fn with_monitors(mut self, monitors: Monitors) -> Self {
        self.supervisor = Supervisor::new(self.period_us, monitors);
        self
    }

    /// Sets the exploration.
    #[must_use]
    pub fn with_exploration(mut self, exploration: Option<Exploration>) -> Self {
        self.exploration = exploration;
        self
    }

    /// Replaces the controller; the running breath continues with the new one.
    pub fn set_controller(&mut self, controller: C) {
        self.controller = controller;
    }

    /// Sets the exploration from the next breath on; none ends it.
    pub fn set_exploration(&mut self, exploration: Option<Exploration>) {
        self.exploration = exploration;
    }

    /// Sets the sweep of sines from the next breath on; none ends it. It runs in the inspirations of the chosen
    /// controller; an alarm ends that of the running breath, and none begins during one ([`VentilatorState::bars_sines`]).
    pub fn set_sweep(&mut self, sweep: Option<SineSweep>) {
        self.sweep = sweep;
    }

    /// The enabled monitors.
    pub fn monitors(&self) -> Monitors {
        self.supervisor.monitors()
    }

    /// Control period, microseconds.
    pub fn period_us(&self) -> u32 {
        self.period_us
    }

    /// The controller.
    pub fn controller(&self) -> &C {
        &self.controller
    }

    /// A state in standby, with settings for the first breath.
    ///
    /// # Errors
    /// Settings that are refused by [`Breath::new`].
    pub fn standby(&self, settings: &Settings) -> Result<VentilatorState<C::State>, SettingsError> {
        let breath = Breath::new(settings, self.period_us)?;
        Ok(VentilatorState::at_rest(breath, || self.controller.initial_state()))
    }

    /// Sets the settings of the next breath (in standby: of the first one).
    ///
    /// # Errors
    /// Settings that are refused by [`Breath::new`]; those in force stay.
    pub fn apply(
        &self,
        state: &mut VentilatorState<C::State>,
        settings: &Settings,
    ) -> Result<(), SettingsError> {
        state.set_pending(Breath::new(settings, self.period_us)?);
        Ok(())
    }

    /// Reports control ticks missed since the last step.
    pub fn missed(&self, state: &mut VentilatorState<C::State>, ticks: u32) {
        if state.mode == Mode::Ventilating {
            self.supervisor.missed(&mut state.supervisor, ticks);
        }
    }

    /// Raises an alarm that another part of the device has found.
    pub fn raise(&self, state: &mut VentilatorState<C::State>, fault: Fault) {
        self.supervisor.report(&mut state.supervisor, fault);
    }

    /// Runs one control tick with the sensors' readings; a pressure alone is that of the airway sensor, cmH2O.
    #[inline]
    pub fn step(&self, state: &mut VentilatorState<C::State>, readings: impl Into<Readings>) -> Output {
        let readings = readings.into();
        let ventilates = state.mode == Mode::Ventilating;
        if ventilates && state.tick == 0 {
            self.start_breath(state);
        }
        let breath = state.breath;
        let belief = if ventilates {
            self.supervisor.check(&mut state.supervisor, &readings, breath.at(state.tick))
        } else {
            self.supervisor.watch(&mut state.supervisor, &readings, &breath);
            None
        };
        if let Some(fault) = state.supervisor.fault() {
            state.mode = Mode::Fault(fault);
        }
        let (command, sample) = match belief {
            Some(belief) => self.breathe(state, &belief, &readings),
            None => (self.rest(state), None),
        };
        debug_assert!(belief.is_some() || command == ValveCommand::SAFE, "no breath, no gas");
        debug_assert!(
            belief.is_none() || state.mode == Mode::Ventilating,
            "a latched fault ends the breaths"
        );
        Output { command, mode: state.mode, sample, alarm: state.supervisor.take_begun() }
    }

    /// The safe command, for a tick without a breath.
    fn rest(&self, state: &mut VentilatorState<C::State>) -> ValveCommand {
        state.last_command = 0.0;
        self.supervisor.rest(&mut state.supervisor)
    }

    /// Runs one tick of a breath.
    fn breathe(
        &self,
        state: &mut VentilatorState<C::State>,
        belief: &Belief,
        readings: &Readings,
    ) -> (ValveCommand, Option<Sample>) {
        let moment = &belief.moment;
        let settings = moment.settings();
        let sign = self.trigger.check(&mut state.trigger, moment, belief.effort, belief.flow);
        let (phase, target) = match moment.phase {
            // An inspiration that has reached the pressure limit has ended.
            Phase::Inspiration if belief.cut => (Phase::Fall, settings.peep),
            Phase::Inspiration => (Phase::Inspiration, moment.target() + belief.pip_shift),
            phase => (phase, moment.target()),
        };
        let open = settings.expiratory_bias + belief.compensation;
        let Command { output, explore, learned } = match phase {
            Phase::Inspiration => self.inspire(state, belief, target),
            // Flow that makes up for a leak does not rise within the expiration: that would look like an effort.
            Phase::Fall if belief.compensation > 0.0 => Command::plain(open),
            Phase::Fall => Command::plain(0.0),
            Phase::Expiration => Command::plain(open),
        };
        let u_out = phase != Phase::Inspiration;
        let command = self.supervisor.command(&mut state.supervisor, belief, output, u_out);
        debug_assert!(command.u_out() == u_out, "the valves follow the phase");
        self.learn(state, belief, phase, explore);
        if phase == Phase::Inspiration {
            let told = told(&state.addition, output, explore, command.u_in());
            self.controller.applied(&mut state.controller, told);
        }
        state.last_command = command.u_in();
        let sample = Sample {
            breath: state.number,
            tick: moment.tick,
            phase,
            target,
            pressure: belief.reading,
            u_in: command.u_in(),
            u_out: command.u_out(),
            explore,
            learned,
            flow: (!readings.flow.is_nan()).then_some(readings.flow),
        };
        self.end_tick(state, belief, sign);
        (command, Some(sample))
    }

    /// Notes what disturbs an inspiration. The controller learns in the first tick after it, in which no controller computes a command.
    fn learn(&self, state: &mut VentilatorState<C::State>, belief: &Belief, phase: Phase, explore: f32) {
        let Some(disturbed) = state.disturbed else { return };
        let sound = belief.level == Level::Learned && state.supervisor.indications().present().is_empty();
        let disturbed = disturbed || !sound || belief.cut || !(explore == 0.0);
        state.disturbed = Some(disturbed);
        if phase != Phase::Inspiration {
            let lesson = if disturbed { Lesson::Discard } else { Lesson::Adopt };
            state.lesson = self.controller.learn(&mut state.controller, lesson);
            state.disturbed = None;
        }
    }

    /// Ends a tick of a breath.
    fn end_tick(&self, state: &mut VentilatorState<C::State>, belief: &Belief, sign: Option<Sign>) {
        let sign = sign.filter(|_| state.number >= FIRST_BREATHS);
        let effort = sign.is_some_and(|sign| !state.supervisor.leak_explains(sign == Sign::Pressure, belief));
        state.tick += 1;
        if self.supervisor.end_tick(&mut state.supervisor, &belief.moment, effort) {
            state.tick = 0;
            state.number = state.number.wrapping_add(1);
        }
    }

    /// The output of the level of the ladder that commands an inspiration.
    fn inspire(&self, state: &mut VentilatorState<C::State>, belief: &Belief, target: f32) -> Command {
        let Belief { moment, pressure, pip_shift, .. } = *belief;
        let settings = moment.settings();
        let (pip, peep, tick) = (settings.pip + pip_shift, settings.peep, moment.tick);
        let rise_ticks = moment.breath.rise_ticks();
        let seen = Observation { pressure, target, pip, peep, tick, rise_ticks };
        // In every tick, so that it has no start of its own when its turn comes.
        let spare = self.spare.step(&mut state.spare, &seen, 0.0);
        match belief.level {
            Level::Backup => Command::plain(belief.backup),
            Level::CappedPid => Command::plain(spare.base),
            // The supervisor applies the base alone.
            Level::Pid => {
                let output = self.controller.step(&mut state.controller, &seen);
                Command { output, explore: 0.0, learned: 0.0 }
            }
            Level::Learned => {
                if matches!(state.addition, Addition::Sine(_)) && state.bars_sines() {
                    state.addition = Addition::Nothing;
                }
                let explore = state.addition.at(tick, self.period_us);
                let output = self.controller.step(&mut state.controller, &seen);
                Command { output: output.plus(explore), explore, learned: output.command - output.base }
            }
        }
    }

    fn start_breath(&self, state: &mut VentilatorState<C::State>) {
        // What was learned belongs to the patient and the settings.
        let mut forgets = state.number == 0;
        if let Some(breath) = state.pending.take() {
            forgets |= !memory::outlasts(state.breath.settings(), breath.settings());
            state.breath = breath;
        }
        if forgets {
            state.lesson = self.controller.learn(&mut state.controller, Lesson::Forget);
        }
        state.disturbed = Some(state.supervisor.triggered());
        state.addition = self.addition(state);
        state.spare = PidState::new();
        self.controller.start_breath(&mut state.controller, state.last_command);
    }

    /// What is added to the commands of the breath that starts.
    fn addition(&self, state: &VentilatorState<C::State>) -> Addition {
        match (&self.sweep, &self.exploration) {
            (Some(sweep), _) => {
                sweep.sine(state.number, self.period_us).map_or(Addition::Nothing, Addition::Sine)
            }
            (None, Some(exploration)) => {
                Addition::Perturbation(exploration.perturbation(&state.breath, state.number))
            }
            (None, None) => Addition::Nothing,
        }
    }
}

/// The command of a tick as the control law is told it, percent: the applied one, but without a sine. So the sine breaks the loop at
/// the valve, and what a law makes of its own commands is part of the law.
fn told(addition: &Addition, output: ControlOutput, explore: f32, applied: f32) -> f32 {
    match addition {
        Addition::Sine(_) if explore != 0.0 => math::limit(output.command - explore, 0.0, COMMAND_MAX),
        _ => applied,
    }
}

impl<S> VentilatorState<S> {
    /// A state in standby with the first breath, and the initial state of the controller.
    // Inlined, it would be built on the caller's stack and then copied; called, it is built in its place.
    #[inline(never)]
    pub fn at_rest(breath: Breath, controller: impl FnOnce() -> S) -> Self {
        Self {
            mode: Mode::Standby,
            breath,
            pending: None,
            number: 0,
            tick: 0,
            last_command: 0.0,
            addition: Addition::default(),
            controller: controller(),
            spare: PidState::new(),
            supervisor: SupervisorState::default(),
            trigger: TriggerState::default(),
            disturbed: None,
            lesson: Lesson::Forget,
        }
    }

    /// The mode.
    pub fn mode(&self) -> Mode {
        self.mode
    }

    /// The breath in force.
    pub fn breath(&self) -> &Breath {
        &self.breath
    }

    /// Settings that wait for the next breath.
    pub fn pending(&self) -> Option<&Settings> {
        self.pending.as_ref().map(Breath::settings)
    }

    /// Sets the breath that runs from the next start of a breath on; it must be built for the ventilator's control period.
    pub fn set_pending(&mut self, breath: Breath) {
        self.pending = Some(breath);
    }

    /// Number of the running breath.
    pub fn breath_number(&self) -> u32 {
        self.number
    }

    /// Tick within the running breath; 0 means that the next step starts a breath.
    pub fn tick(&self) -> u32 {
        self.tick
    }

    /// Whether an effort of the patient has started the running breath, or at tick 0 the next one.
    pub fn triggered(&self) -> bool {
        self.supervisor.triggered()
    }

    /// What the controller learned from the last inspiration that has ended, or that it has forgotten all.
    pub fn lesson(&self) -> Lesson {
        self.lesson
    }

    /// Level of the ladder of trust that commands the inspiratory valve.
    pub fn level(&self) -> Level {
        self.supervisor.level()
    }

    /// Whether the running inspiration was ended at the pressure limit.
    pub fn cut(&self) -> bool {
        self.supervisor.cut()
    }

    /// In standby, lets the first breath start at the next tick; a latched fault must be acknowledged first.
    pub fn start(&mut self) {
        if self.mode == Mode::Standby {
            self.supervisor.begin();
            (self.mode, self.number, self.tick) = (Mode::Ventilating, 0, 0);
        }
    }

    /// Goes to standby; a latched fault stays.
    pub fn stop(&mut self) {
        if self.mode == Mode::Ventilating {
            self.mode = Mode::Standby;
        }
    }

    /// Starts as [`Self::start`] does, with the PID alone until clean breaths lead up the ladder.
    pub fn resume(&mut self) {
        self.start();
        self.supervisor.distrust();
    }

    /// Acknowledges all alarms, and leaves the latched safe state for standby; returns whether there was an alarm.
    pub fn acknowledge(&mut self) -> bool {
        if let Mode::Fault(_) = self.mode {
            self.supervisor.clear();
            self.mode = Mode::Standby;
            return true;
        }
        self.supervisor.acknowledge()
    }

    /// Whether an alarm is present during which no sine is added to the command: any but that of a leak, under which the pressure
    /// only falls short. It is a property of many test lungs, and of the loop that is measured.
    pub fn bars_sines(&self) -> bool {
        let mut present = self.supervisor.indications().present();
        present.remove(Fault::Leak);
        !present.is_empty()
    }

    /// The alarms.
    pub fn indications(&self) -> &Indications {
        self.supervisor.indications()
    }

    /// Whether a pressure sensor is sound.
    pub fn has_sensor(&self) -> bool {
        self.supervisor.has_sensor()
    }

    /// Leak that the breaths so far have shown, L/s at 1 cmH2O; none unless the flow of the last breath was measured.
    pub fn leak(&self) -> Option<f32> {
        self.supervisor.leak()
    }
}

impl VentilatorState {
    /// Breaths that the learned controller remembers since it last forgot, at most [`crate::control::memory::LEARNING`].
    pub fn adopted(&self) -> u8 {
        self.controller.adopted()
    }
}

#[cfg(test)]
mod tests;
