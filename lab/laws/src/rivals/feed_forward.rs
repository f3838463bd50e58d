//! PID with identified feed-forward: the flow that the target needs, through the inverse of the nominal valve, and a PID for the rest.
//!
//! A model of valve, circuit and lung runs beside the plant. In it, the pressure is to approach the target with a chosen lag: the
//! circuit takes the flow of its compliance, the lung that of a resistance and a compliance. The flow gives the stem's travel by the
//! valve's curve, and that gives the command: the actuator's lag is shortened, its backlash taken up. A valve that is fully open
//! gives no more, in the model too. The PID follows the model's pressure, delayed by a chosen time, and so corrects
//! only what the model has wrong. A slow rise of the target is known before: the model follows it the valve's dead time ahead.
//!
//! The lung is identified after each undisturbed inspiration from its commands and pressures ([`super::lung_fit`]); before the first
//! one it is the usual lung on such a machine. Nothing is taken from the plant itself.

use std::collections::VecDeque;

use shared::breath::period_s;
use shared::control::memory::Lesson;
use shared::control::pid::{Pid, PidGains, PidState};
use shared::control::{COMMAND_MAX, ControlLaw, ControlOutput, Observation};
use shared::math;

use super::lung::Lung;
use super::lung_fit::LungFit;
use super::machine::Machine;
use super::parameter::{self, GAIN_D, GAIN_I, GAIN_P, Parameter, RivalError};
use ventilator::law::Law;

/// Parameters in the order of [`FeedForward::new`]. The values are those that `lab tune-rival feed-forward` had found for
/// the family `adult` when it was stopped after 585 points scored in full.
pub(super) const PARAMETERS: [Parameter; 6] = [
    Parameter { coarse: &[1.0, 2.5, 5.0], tuned: 4.21875, ..GAIN_P },
    Parameter { coarse: &[30.0, 60.0, 150.0], tuned: 105.0, ..GAIN_I },
    Parameter { coarse: &[0.0, 0.08, 0.16], tuned: 0.125, ..GAIN_D },
    Parameter {
        name: "approach",
        unit: "ms",
        meaning: "time constant with which the model's pressure approaches the target",
        coarse: &[5.0, 10.0, 20.0],
        bounds: (1.0, 500.0),
        tuned: 33.75,
    },
    Parameter {
        name: "valve lag",
        unit: "ms",
        meaning: "lag to which the actuator's is shortened",
        coarse: &[6.0, 12.0, 24.0],
        bounds: (1.0, 500.0),
        tuned: 2.25,
    },
    Parameter {
        name: "delay",
        unit: "ms",
        meaning: "delay of the model's pressure that the PID follows",
        coarse: &[10.0, 16.0, 24.0],
        bounds: (0.0, 500.0),
        tuned: 0.0,
    },
];

/// Weight of the newest inspiration in the estimate of the lung.
const NEWEST: f32 = 0.5;

/// A PID with a feed-forward from a model.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FeedForward {
    pid: Pid,
    machine: Machine,
    period_us: u32,
    /// Conductance of the circuit's compliance over the approach and over a tick, (L/s)/cmH2O.
    approach: f32,
    storage: f32,
    /// Ratio of the actuator's lag to the shortened one.
    quicker: f32,
    delay_ticks: usize,
    /// Ticks of the valve's dead time.
    dead_ticks: u32,
}

/// State of the law: what is known of the lung, and the model in the running breath.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct FeedForwardState {
    pid: PidState,
    /// The lung identified so far; none before the first inspiration.
    lung: Option<Lung>,
    fit: LungFit,
    model: Option<Model>,
    /// Pressure of the running tick, cmH2O.
    pressure: f32,
}

/// The model of the running breath.
#[derive(Clone, Debug, PartialEq)]
struct Model {
    /// Pressures at the airway and in the lung, cmH2O.
    airway: f32,
    alveolar: f32,
    /// Travel of actuator and stem, percent.
    actuator: f32,
    stem: f32,
    /// Airway pressures that the PID has not seen yet, the oldest first.
    unseen: VecDeque<f32>,
}

impl FeedForward {
    /// The law with P, I, D, approach, valve lag and delay in ms, for a machine and a control period in microseconds.
    ///
    /// # Errors
    /// A value out of bounds.
    pub fn new(values: [f32; 6], machine: Machine, period_us: u32) -> Result<Self, RivalError> {
        parameter::check(&PARAMETERS, &values)?;
        let [p, i, d, approach_ms, valve_ms, delay_ms] = values;
        let period = period_s(period_us);
        Ok(Self {
            pid: Pid::new(PidGains { p, i, d }, period_us)?,
            machine,
            period_us,
            approach: machine.circuit / approach_ms,
            storage: 1e-3 * machine.circuit / period,
            quicker: (machine.lag_s / (1e-3 * valve_ms)).max(1.0),
            delay_ticks: (1e-3 * delay_ms / period).round() as usize,
            dead_ticks: math::ticks(machine.dead_time_s, period_us),
        })
    }

    /// Advances the model by a tick; returns its command in percent.
    fn predicted(&self, model: &mut Model, lung: Lung, target: f32) -> f32 {
        let (machine, period) = (&self.machine, period_s(self.period_us));
        let lung_flow = (model.airway - model.alveolar) / lung.resistance;
        let stem = machine.stem(lung_flow + self.approach * (target - model.airway), model.airway);
        // A stem that closes lags behind its actuator by the play.
        let actuator = if stem < model.stem { (stem - machine.play).max(0.5 * stem) } else { stem };
        let command = model.actuator + self.quicker * (actuator - model.actuator);
        let command = math::limit(command, 0.0, COMMAND_MAX);
        model.actuator += math::lag_factor(machine.lag_s, period) * (command - model.actuator);
        model.stem = machine.follow(model.stem, model.actuator);
        let flow = machine.flow(model.stem, model.airway);
        // Implicit in the pressure, which may change faster than a tick with a low resistance.
        let conductance = 1.0 / lung.resistance;
        model.airway = (self.storage * model.airway + flow + conductance * model.alveolar)
            / (self.storage + conductance);
        model.alveolar += 1e3 * period * conductance * (model.airway - model.alveolar) / lung.compliance;
        command
    }
}

impl Model {
    /// At rest at a pressure in cmH2O, with the valve closed.
    fn at_rest(pressure: f32) -> Self {
        let unseen = VecDeque::new();
        Self { airway: pressure, alveolar: pressure, actuator: 0.0, stem: 0.0, unseen }
    }

    /// The airway pressure of some ticks ago; that of the first tick before that.
    fn delayed(&mut self, ticks: usize) -> f32 {
        self.unseen.push_back(self.airway);
        if self.unseen.len() > ticks + 1 {
            self.unseen.pop_front();
        }
        self.unseen.front().copied().unwrap_or(self.airway)
    }
}

impl Law for FeedForward {
    fn pid(&self) -> &Pid {
        &self.pid
    }
}

impl ControlLaw for FeedForward {
    type State = FeedForwardState;

    fn initial_state(&self) -> FeedForwardState {
        FeedForwardState::default()
    }

    fn learn(&self, state: &mut FeedForwardState, lesson: Lesson) -> Lesson {
        let fitted = state.fit.lung();
        let learned = match (lesson, fitted) {
            (Lesson::Adopt, Some(lung)) => {
                state.lung = Some(state.lung.map_or(lung, |known| known.towards(lung, NEWEST)));
                Lesson::Adopt
            }
            (Lesson::Adopt, None) => Lesson::Discard,
            (lesson, _) => lesson,
        };
        if learned == Lesson::Forget {
            state.lung = None;
        }
        state.fit = LungFit::begun(&self.machine, self.period_us);
        learned
    }

    fn start_breath(&self, state: &mut FeedForwardState, _command: f32) {
        state.pid = PidState::new();
        state.fit = LungFit::begun(&self.machine, self.period_us);
        state.model = None;
    }

    fn step(&self, state: &mut FeedForwardState, seen: &Observation) -> ControlOutput {
        state.pressure = seen.pressure;
        let lung = state.lung.unwrap_or(self.machine.usual);
        let model = state.model.get_or_insert_with(|| Model::at_rest(seen.peep));
        let fed = self.predicted(model, lung, seen.target + seen.rise_within(self.dead_ticks));
        // The derivative part must not brake the predicted rise: the PID sees the distance to the model, not the pressure.
        let pressure = seen.pip + seen.pressure - model.delayed(self.delay_ticks);
        let rest = Observation { pressure, target: seen.pip, ..*seen };
        // One law: the PID alone, with its slow gains, is no better spare than the whole.
        ControlOutput::plain(self.pid.step(&mut state.pid, &rest, fed).command)
    }

    fn applied(&self, state: &mut FeedForwardState, command: f32) {
        state.fit.add(&self.machine, self.period_us, state.pressure, command);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use plant::bench::BenchConfig;
    use shared::breath::{DEFAULT_PERIOD_US, paper_settings};
    use trials::robust::plant_run::{PlantBreaths, PlantRun, breaths};

    /// The law with soft gains, on the nominal machine.
    fn law() -> FeedForward {
        let machine = Machine::of(&BenchConfig::default());
        FeedForward::new([2.5, 60.0, 0.08, 10.0, 10.0, 16.0], machine, DEFAULT_PERIOD_US).unwrap()
    }

    fn seen(tick: u32, pressure: f32, target: f32) -> Observation {
        Observation { pressure, target, pip: target, peep: 5.0, tick, rise_ticks: 0 }
    }

    /// Runs an inspiration in which the pressure rises to the target within 100 ms.
    fn breathe(law: &FeedForward, state: &mut FeedForwardState) {
        law.start_breath(state, 0.0);
        for tick in 0..600 {
            let pressure = 5.0 + 0.1 * tick.min(100) as f32;
            let command = law.step(state, &seen(tick, pressure, 15.0)).command;
            law.applied(state, command);
        }
    }

    fn on_bench<C: ControlLaw + Clone>(law: &C, resistance: f64, compliance: f64) -> PlantBreaths {
        let bench = BenchConfig::paper(resistance, compliance);
        breaths(
            &PlantRun { bench, settings: paper_settings(25.0), noise: 1, breaths: 6, goes_on: false },
            law,
        )
        .unwrap()
    }

    #[test]
    fn a_slow_rise_is_followed_the_valves_dead_time_ahead() {
        let first = |rise_ticks| {
            let (law, mut state) = (law(), law().initial_state());
            law.start_breath(&mut state, 0.0);
            law.step(&mut state, &Observation { pip: 25.0, rise_ticks, ..seen(0, 5.0, 5.0) })
        };
        // The target is still PEEP; only what follows differs.
        assert!(first(100).command > first(400).command && first(400).command > first(100_000).command);
    }

    #[test]
    fn before_the_first_breath_the_usual_lung_of_the_machine_counts() {
        let first = |usual| {
            let mut law = law();
            law.machine.usual = usual;
            let mut state = law.initial_state();
            law.start_breath(&mut state, 0.0);
            (0..100).map(|tick| law.step(&mut state, &seen(tick, 5.0, 15.0)).command).sum::<f32>()
        };
        let stiff = first(Lung { resistance: 100.0, compliance: 1.0 });
        assert!(stiff < first(law().machine.usual), "a small lung needs less gas");
    }

    #[test]
    fn a_target_at_the_pressure_of_the_plant_asks_for_no_flow() {
        let law = law();
        let mut state = law.initial_state();
        for tick in 0..300 {
            law.step(&mut state, &seen(tick, 5.0, 5.0));
        }
        let model = state.model.unwrap();
        assert!((model.airway - 5.0).abs() < 1e-3 && (model.alveolar - 5.0).abs() < 1e-3, "{model:?}");
    }

    #[test]
    fn the_model_reaches_the_target_and_a_valve_that_is_fully_open_gives_no_more() {
        let law = law();
        let mut model = Model::at_rest(5.0);
        let lung = Lung { resistance: 5.0, compliance: 50.0 };
        let mut pressures = Vec::new();
        for _ in 0..1500 {
            let command = law.predicted(&mut model, lung, 30.0);
            assert!((0.0..=COMMAND_MAX).contains(&command));
            pressures.push(model.airway);
        }
        assert!(pressures[100] < 20.0, "25 cmH2O take 1.25 L: {}", pressures[100]);
        assert!((model.airway - 30.0).abs() < 0.3, "{}", model.airway);
        assert!(pressures.iter().all(|pressure| *pressure < 31.5));
    }

    #[test]
    fn a_pressure_that_follows_the_model_leaves_the_pid_nothing_to_do() {
        let law = law();
        let mut state = law.initial_state();
        law.start_breath(&mut state, 0.0);
        let (mut twin, mut delayed) = (Model::at_rest(5.0), Model::at_rest(5.0));
        for tick in 0..500 {
            delayed.airway = twin.airway;
            let pressure = delayed.delayed(law.delay_ticks - 1);
            let fed = law.predicted(&mut twin, law.machine.usual, 20.0);
            let command = law.step(&mut state, &seen(tick, pressure, 20.0)).command;
            assert!((command - fed).abs() < 2.0, "tick {tick}: {command}, not {fed}");
        }
    }

    #[test]
    fn on_a_known_machine_it_comes_near_the_target_once_the_lung_is_identified() {
        for (resistance, compliance) in [(20.0, 20.0), (50.0, 10.0)] {
            let law = law();
            let (fed, alone) =
                (on_bench(&law, resistance, compliance), on_bench(&PidAlone(law), resistance, compliance));
            let (score, overshoot) = (fed.every[5], fed.scored[1].overshoot);
            assert!(score < 0.8 * alone.every[5], "R {resistance}: {score}, the PID {}", alone.every[5]);
            assert!(overshoot < 2.5, "R {resistance}: {overshoot}");
        }
    }

    #[test]
    fn the_lung_is_learned_from_an_adopted_breath_kept_over_a_disturbed_one_and_forgotten_with_the_settings()
    {
        let law = law();
        let mut state = law.initial_state();
        breathe(&law, &mut state);
        assert_eq!(law.learn(&mut state, Lesson::Adopt), Lesson::Adopt);
        let known = state.lung;
        assert!(known.is_some());
        breathe(&law, &mut state);
        assert_eq!(law.learn(&mut state, Lesson::Discard), Lesson::Discard);
        assert_eq!(state.lung, known);
        assert_eq!(law.learn(&mut state, Lesson::Forget), Lesson::Forget);
        assert_eq!(state.lung, None);
    }

    #[test]
    fn a_breath_that_tells_no_lung_is_left_out() {
        let law = law();
        let mut state = law.initial_state();
        law.start_breath(&mut state, 0.0);
        for tick in 0..600 {
            law.step(&mut state, &seen(tick, f32::NAN, 15.0));
            law.applied(&mut state, 0.0);
        }
        assert_eq!(law.learn(&mut state, Lesson::Adopt), Lesson::Discard);
        assert_eq!(state.lung, None);
    }

    /// The PID of the law, with the target itself and without its feed-forward.
    #[derive(Clone)]
    struct PidAlone(FeedForward);

    impl ControlLaw for PidAlone {
        type State = PidState;

        fn initial_state(&self) -> PidState {
            PidState::new()
        }

        fn start_breath(&self, state: &mut PidState, _command: f32) {
            *state = PidState::new();
        }

        fn step(&self, state: &mut PidState, seen: &Observation) -> ControlOutput {
            self.0.pid.step(state, seen, 0.0)
        }

        fn applied(&self, _state: &mut PidState, _command: f32) {}
    }
}
