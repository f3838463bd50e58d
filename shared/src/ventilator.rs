//! The ventilator: a pure state machine that connects controller and supervisor, with one [`Ventilator::step`] per
//! control tick.
//!
//! # Modes
//! *Standby*: valves safe, no breath runs. *Ventilating*: breath follows breath. *Fault*: latched safe state; only
//! [`VentilatorState::acknowledge`] ends it, and leads to standby.
//!
//! # Breath
//! Settings sent while ventilating take effect when the next breath starts. The controller runs during the
//! inspiration; in fall and expiration the expiratory valve is open, the mechanical PEEP valve holds PEEP, and the
//! inspiratory valve is closed (fall) or at its bias (expiration).
//!
//! # Order of a tick
//! The supervisor checks the reading -> controller -> exploration -> safety filter -> the controller records the applied
//! command. Any [`ControlLaw`] can be the controller; order and safety are the same for all.

use serde::{Deserialize, Serialize};

use crate::breath::{Breath, Phase};
use crate::control::{ControlLaw, ControlOutput, Controller, ControllerState, Observation};
use crate::explore::{Exploration, Perturbation};
use crate::safety::alarms::Fault;
use crate::safety::filter::ValveCommand;
use crate::safety::ladder::Level;
use crate::safety::monitors::Monitors;
use crate::safety::supervisor::{Supervisor, SupervisorState};
use crate::settings::{Settings, SettingsError};

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
    /// Pressure as read, cmH2O.
    pub pressure: f32,
    /// Command sent to the inspiratory valve, percent.
    pub u_in: f32,
    /// Whether the expiratory valve is open.
    pub u_out: bool,
    /// Perturbation that exploration added to the controller's output, percent.
    pub explore: f32,
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
    exploration: Option<Exploration>,
    supervisor: Supervisor,
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
    perturbation: Perturbation,
    controller: S,
    supervisor: SupervisorState,
}

impl<C: ControlLaw> Ventilator<C> {
    /// A ventilator with a control period in microseconds.
    pub fn new(period_us: u32, controller: C) -> Self {
        let supervisor = Supervisor::new(period_us, Monitors::ALL);
        Self { period_us, controller, exploration: None, supervisor }
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
        Ok(self.at_rest(Breath::new(settings, self.period_us)?))
    }

    /// A state in standby with the first breath.
    pub fn at_rest(&self, breath: Breath) -> VentilatorState<C::State> {
        VentilatorState {
            mode: Mode::Standby,
            breath,
            pending: None,
            number: 0,
            tick: 0,
            last_command: 0.0,
            perturbation: Perturbation::default(),
            controller: self.controller.initial_state(),
            supervisor: SupervisorState::default(),
        }
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

    /// Runs one control tick with the pressure reading in cmH2O.
    #[inline]
    pub fn step(&self, state: &mut VentilatorState<C::State>, reading: f32) -> Output {
        let tick = if state.mode == Mode::Ventilating {
            if state.tick == 0 {
                self.start_breath(state);
            }
            Some(state.tick)
        } else {
            None
        };
        let believed = self.supervisor.check(&mut state.supervisor, reading, &state.breath, tick);
        if let Some(fault) = state.supervisor.fault() {
            state.mode = Mode::Fault(fault);
        }
        match (state.mode, believed) {
            (Mode::Ventilating, Some(pressure)) => self.breathe(state, reading, pressure),
            (mode, _) => {
                state.last_command = 0.0;
                let command = self.supervisor.rest(&mut state.supervisor);
                Output { command, mode, sample: None, alarm: state.supervisor.take_raised() }
            }
        }
    }

    /// Runs one tick of a breath; `pressure` is the reading, or for a few milliseconds the last good one.
    fn breathe(&self, state: &mut VentilatorState<C::State>, reading: f32, pressure: f32) -> Output {
        let (tick, breath) = (state.tick, state.breath);
        let settings = breath.settings();
        let (phase, target) = match breath.phase(tick) {
            // An inspiration that has reached the pressure limit has ended.
            Phase::Inspiration if state.supervisor.cut() => (Phase::Fall, settings.peep),
            phase => (phase, breath.target(tick)),
        };
        let (wanted, explore) = match phase {
            Phase::Inspiration => {
                let seen = Observation { pressure, target, pip: settings.pip, peep: settings.peep, tick };
                let explore = state.perturbation.at(tick, self.period_us);
                (self.controller.step(&mut state.controller, &seen).plus(explore), explore)
            }
            Phase::Fall => (ControlOutput::plain(0.0), 0.0),
            Phase::Expiration => (ControlOutput::plain(settings.expiratory_bias), 0.0),
        };
        let command = self.supervisor.command(&mut state.supervisor, wanted, phase != Phase::Inspiration);
        if phase == Phase::Inspiration {
            self.controller.applied(&mut state.controller, command.u_in());
        }
        state.last_command = command.u_in();
        let sample = Sample {
            breath: state.number,
            tick,
            phase,
            target,
            pressure: reading,
            u_in: command.u_in(),
            u_out: command.u_out(),
            explore,
        };
        state.tick += 1;
        if state.tick >= breath.total_ticks() {
            state.tick = 0;
            state.number = state.number.wrapping_add(1);
        }
        let alarm = state.supervisor.take_raised();
        Output { command, mode: state.mode, sample: Some(sample), alarm }
    }

    fn start_breath(&self, state: &mut VentilatorState<C::State>) {
        if let Some(breath) = state.pending.take() {
            state.breath = breath;
        }
        state.perturbation = match &self.exploration {
            Some(exploration) => exploration.perturbation(&state.breath, state.number),
            None => Perturbation::default(),
        };
        self.controller.start_breath(&mut state.controller, state.last_command);
    }
}

impl<S> VentilatorState<S> {
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

    /// Leaves the latched safe state for standby.
    pub fn acknowledge(&mut self) {
        if let Mode::Fault(_) = self.mode {
            self.supervisor.clear();
            self.mode = Mode::Standby;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::breath::{DEFAULT_PERIOD_US, paper_settings};
    use crate::control::features::FeatureSpec;
    use crate::control::network::Network;
    use crate::control::pid::{Pid, PidGains};
    use crate::control::residual::{Residual, ResidualSpec};
    use proptest::prelude::*;
    use std::vec::Vec;

    const GAINS: PidGains = PidGains { p: 2.0, i: 20.0, d: 0.0 };

    /// A ventilator for plants whose readings the tests make up.
    fn ventilator() -> Ventilator {
        let pid = Pid::new(GAINS, DEFAULT_PERIOD_US).unwrap();
        Ventilator::new(DEFAULT_PERIOD_US, Controller::Pid(pid)).with_monitors(Monitors::ANY_PLANT)
    }

    /// The same ventilator with a network that always adds `percent` to the PID.
    fn learned(percent: f32) -> Ventilator {
        let mut network = Network::zero();
        network.output.bias[0] = 0.01 * percent;
        let spec = ResidualSpec {
            period_us: DEFAULT_PERIOD_US,
            gains: GAINS,
            lambda: 1.0,
            authority: 100.0,
            features: FeatureSpec::default(),
        };
        let residual = Residual::new(spec, network).unwrap();
        Ventilator::new(DEFAULT_PERIOD_US, Controller::Residual(residual)).with_monitors(Monitors::ANY_PLANT)
    }

    fn started(ventilator: &Ventilator) -> VentilatorState {
        let mut state = ventilator.standby(&paper_settings(20.0)).unwrap();
        state.start();
        state
    }

    fn run(ventilator: &Ventilator, state: &mut VentilatorState, ticks: u32, pressure: f32) -> Output {
        for _ in 1..ticks {
            ventilator.step(state, pressure);
        }
        ventilator.step(state, pressure)
    }

    #[test]
    fn standby_holds_the_valves_safe() {
        let ventilator = ventilator();
        let mut state = ventilator.standby(&paper_settings(20.0)).unwrap();
        let output = run(&ventilator, &mut state, 100, 5.0);
        assert_eq!((output.command, output.mode, output.sample), (ValveCommand::SAFE, Mode::Standby, None));
    }

    #[test]
    fn a_breath_runs_through_its_phases() {
        let ventilator = ventilator();
        let mut state = started(&ventilator);
        let sample = |output: Output| output.sample.unwrap();
        let first = sample(run(&ventilator, &mut state, 1, 5.0));
        assert_eq!((first.phase, first.u_out, first.breath, first.tick), (Phase::Inspiration, false, 0, 0));
        assert!(first.u_in > 0.0);
        assert_eq!((state.breath_number(), state.tick()), (0, 1));
        let fall = sample(run(&ventilator, &mut state, 1000, 15.0));
        assert_eq!((fall.phase, fall.u_out), (Phase::Fall, true));
        assert!(fall.u_in.abs() < f32::EPSILON);
        let rest = sample(run(&ventilator, &mut state, 500, 5.0));
        assert_eq!((rest.phase, rest.u_out), (Phase::Expiration, true));
        assert!((rest.u_in - 5.0).abs() < f32::EPSILON, "the bias");
        let next = sample(run(&ventilator, &mut state, 1500, 5.0));
        assert_eq!((next.breath, next.tick, next.phase), (1, 0, Phase::Inspiration));
        run(&ventilator, &mut state, 3099, 5.0);
        assert_eq!((state.breath_number(), state.tick()), (2, 100));
    }

    /// Asks for a constant command; remembers where the valve stood before the breath, then each command that was applied.
    struct Constant(f32);

    impl ControlLaw for Constant {
        type State = Vec<f32>;

        fn initial_state(&self) -> Vec<f32> {
            Vec::new()
        }

        fn start_breath(&self, state: &mut Vec<f32>, command: f32) {
            *state = Vec::from([command]);
        }

        fn step(&self, _: &mut Vec<f32>, _: &Observation) -> ControlOutput {
            ControlOutput::plain(self.0)
        }

        fn applied(&self, state: &mut Vec<f32>, command: f32) {
            state.push(command);
        }
    }

    #[test]
    fn the_controller_is_told_where_the_valve_stood_and_what_was_applied_in_the_inspiration() {
        let ventilator =
            Ventilator::new(DEFAULT_PERIOD_US, Constant(120.0)).with_monitors(Monitors::ANY_PLANT);
        let mut state = ventilator.standby(&paper_settings(20.0)).unwrap();
        state.start();
        for _ in 0..3000 {
            ventilator.step(&mut state, 5.0);
        }
        assert_eq!((state.controller.len(), state.controller[0] as i32), (1001, 0));
        assert!(state.controller[1..].iter().all(|command| (command - 100.0).abs() < f32::EPSILON));
        ventilator.step(&mut state, 5.0);
        assert_eq!((state.controller.len(), state.controller[0] as i32), (2, 5), "after the bias");
    }

    #[test]
    fn settings_wait_for_the_next_breath() {
        let ventilator = ventilator();
        let mut state = started(&ventilator);
        run(&ventilator, &mut state, 10, 5.0);
        ventilator.apply(&mut state, &paper_settings(30.0)).unwrap();
        assert_eq!(state.pending(), Some(&paper_settings(30.0)));
        let before = run(&ventilator, &mut state, 990, 5.0).sample.unwrap();
        assert!((before.target - 20.0).abs() < f32::EPSILON);
        let after = run(&ventilator, &mut state, 2001, 5.0).sample.unwrap();
        assert_eq!((after.tick, state.pending()), (0, None));
        assert!((after.target - 30.0).abs() < f32::EPSILON);
    }

    #[test]
    fn refused_settings_leave_those_in_force() {
        let ventilator = ventilator();
        let mut state = started(&ventilator);
        assert!(ventilator.apply(&mut state, &paper_settings(f32::NAN)).is_err());
        let next = run(&ventilator, &mut state, 3001, 5.0).sample.unwrap();
        assert!((next.target - 20.0).abs() < f32::EPSILON);
    }

    #[test]
    fn at_the_pressure_limit_the_inspiration_ends() {
        let ventilator = ventilator();
        let mut state = started(&ventilator);
        run(&ventilator, &mut state, 1, 59.0);
        assert!(!state.cut());
        let over = run(&ventilator, &mut state, 3, 61.0);
        assert!(state.cut());
        assert_eq!((over.command, over.mode), (ValveCommand::SAFE, Mode::Ventilating));
        let sample = run(&ventilator, &mut state, 800, 7.0).sample.unwrap();
        assert_eq!((sample.phase, sample.u_out, sample.target as i32), (Phase::Fall, true, 5));
        let next = run(&ventilator, &mut state, 2197, 5.0).sample.unwrap();
        assert_eq!((next.tick, next.phase, next.u_out), (0, Phase::Inspiration, false));
    }

    #[test]
    fn a_pressure_far_above_its_limit_latches_until_acknowledged() {
        let ventilator = ventilator();
        let mut state = started(&ventilator);
        let output = run(&ventilator, &mut state, 3, 76.0);
        assert_eq!((output.command, output.mode), (ValveCommand::SAFE, Mode::Fault(Fault::HardLimit)));
        assert_eq!(output.alarm, Some(Fault::HardLimit));
        assert_eq!(run(&ventilator, &mut state, 1, 76.0).alarm, None, "reported once");
        state.start();
        let output = run(&ventilator, &mut state, 10_000, 5.0);
        assert_eq!((output.command, output.mode), (ValveCommand::SAFE, Mode::Fault(Fault::HardLimit)));
        state.acknowledge();
        assert_eq!(state.mode(), Mode::Standby);
        state.start();
        assert_eq!(run(&ventilator, &mut state, 1, 5.0).mode, Mode::Ventilating);
    }

    #[test]
    fn exploration_adds_to_the_command_and_is_recorded() {
        let quiet = ventilator();
        let exploring = ventilator().with_exploration(Some(Exploration {
            boundary_probability: 1.0,
            boundary_height: (10.0, 10.0),
            ..Exploration::default()
        }));
        let first = |v: &Ventilator| run(v, &mut started(v), 1, 15.0).sample.unwrap();
        assert!((first(&exploring).u_in - first(&quiet).u_in - 10.0).abs() < 1e-4);
        assert!((first(&exploring).explore - 10.0).abs() < 1e-6);
    }

    /// SAFETY.md on a hand-over: the learned part fades at the slew, and the PID underneath continues, its integral neither
    /// reset nor fitted to the applied command.
    #[test]
    fn a_hand_over_is_a_ramp_of_the_learned_part_alone() {
        let (learned, pid) = (learned(60.0), ventilator());
        let (mut state, mut pid_state) = (started(&learned), started(&pid));
        // Difference between each command and that of a PID without a network, thousandths of a percent.
        let mut added = |state: &mut VentilatorState, readings: &[f32]| -> Vec<i32> {
            let mut added = |reading| {
                let command = learned.step(state, reading).command.u_in();
                command - pid.step(&mut pid_state, reading).command.u_in()
            };
            readings.iter().map(|reading| (1000.0 * added(*reading) + 0.5) as i32).collect()
        };
        assert_eq!(added(&mut state, &[15.0; 4]), [25_000, 50_000, 60_000, 60_000]);
        assert_eq!(added(&mut state, &[f32::NAN, 15.0]), [35_000, 60_000], "bridged");
        learned.missed(&mut state, 1);
        assert_eq!(added(&mut state, &[15.0; 100])[..4], [35_000, 10_000, 0, 0], "the PID takes over");
        assert!(added(&mut state, &[20.0; 2894]).iter().all(|percent| *percent == 0));
        assert_eq!(added(&mut state, &[15.0; 4]), [25_000, 50_000, 60_000, 60_000], "the next breath");
    }

    proptest! {
        /// For any readings and requests in any order: the command stays in range, the expiratory valve is open unless an
        /// inspiration runs, and a fault stays until it is acknowledged.
        #[test]
        fn no_sequence_of_events_leaves_the_state_machine(
            events in prop::collection::vec((0u8..12, prop::num::f32::ANY, -20.0f32..80.0), 1..400),
        ) {
            let ventilator = ventilator();
            let mut state = ventilator.standby(&paper_settings(20.0)).unwrap();
            for (kind, wild, tame) in events {
                let before = state.mode();
                match kind {
                    0 => state.start(),
                    1 => state.stop(),
                    2 => state.acknowledge(),
                    3 => { let _ = ventilator.apply(&mut state, &paper_settings(tame)); }
                    _ => {
                        let output = ventilator.step(&mut state, if kind == 4 { wild } else { tame });
                        prop_assert!((0.0..=100.0).contains(&output.command.u_in()));
                        let inspiring = output.sample.is_some_and(|s| s.phase == Phase::Inspiration);
                        prop_assert_eq!(output.command.u_out(), !inspiring);
                        prop_assert!(!state.cut() || output.command.u_out());
                    }
                }
                if let Mode::Fault(_) = before {
                    prop_assert!(kind == 2 || state.mode() == before);
                }
            }
        }
    }
}
