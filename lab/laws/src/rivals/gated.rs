//! The learned controller with iterative learning and a gate: network and classical learning from breath to breath together.
//!
//! The shipped controller `adult` breathes, and a feed-forward that is learned by the rule of [`super::feed_learning`] is added to its
//! command. The network remembers earlier breaths too, so the correction of a breath may not be what the next one needs. Each
//! correction is therefore on trial for one breath: the gate keeps it if the mean error became smaller, and otherwise drops it,
//! returns to the feed-forward before it and halves the learning gain. After a few drops nothing is tried any more.
//!
//! A breath that is known to be disturbed decides nothing. After a disturbance that nothing reports, the error falls by itself, and a
//! wrong correction on trial at that time is kept. Changed settings forget all. So does a breath that surprises the network or became
//! clearly worse without a trial: lung or unit have changed, and what was learned for the earlier one is no help.

use shared::control::memory::Lesson;
use shared::control::pid::Pid;
use shared::control::residual::Residual;
use shared::control::{COMMAND_MAX, ControlLaw, ControlOutput, Controller, ControllerState, Observation};
use shared::math;

use super::feed_learning::{self, FeedLearning};
use super::parameter::{self, Parameter, RivalError};
use learn::controller::shipped;
use margins::iteration::LearningFilter;
use ventilator::law::Law;

/// Name of the learned controller that breathes.
const LEARNED: &str = "adult";

/// Parameters in the order of [`Gated::new`]. `lab tune-rival gated` for the family `adult` ends with a gain of 0.8 and a lead of
/// 52.5 ms. On 200 other plants these values have 0.2 % less error in the first 20 breaths, and they correct more on a slow valve.
pub(super) const PARAMETERS: [Parameter; 4] = [
    Parameter { coarse: &[0.4, 0.8, 1.6], tuned: 1.6, ..feed_learning::GAIN },
    Parameter { coarse: &[30.0, 45.0, 60.0], tuned: 60.0, ..feed_learning::LEAD },
    Parameter { coarse: &[8.0, 15.0, 30.0], tuned: 37.5, ..feed_learning::HALF_BASE },
    Parameter {
        name: "bound",
        unit: "%",
        meaning: "largest magnitude of the feed-forward",
        coarse: &[10.0, 20.0],
        bounds: (0.0, COMMAND_MAX),
        tuned: 7.5,
    },
];

/// Factor on the learning gain after a correction that was dropped.
const SHRINK: f32 = 0.5;
/// Share of the learning gain below which nothing is tried any more: five drops.
const LEAST_SHARE: f32 = 0.05;
/// A breath without a trial is clearly worse if its error grew by this share and by this many cmH2O.
const WORSE: (f32, f32) = (0.2, 0.3);

/// The learned controller with a gated feed-forward.
#[derive(Clone, Debug, PartialEq)]
pub struct Gated {
    controller: Controller,
    learning: FeedLearning,
    bound: f32,
}

/// State of the law.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct GatedState {
    controller: ControllerState,
    /// Feed-forward in force, percent.
    feed: Vec<f32>,
    /// Errors of the running inspiration, cmH2O.
    errors: Vec<f32>,
    gate: Gate,
}

/// What the gate knows.
#[derive(Clone, Debug, PartialEq)]
struct Gate {
    /// The feed-forward that has proved itself, percent.
    kept: Vec<f32>,
    /// Mean absolute error of the last breath with it, cmH2O; none before the first breath.
    error: Option<f32>,
    /// Whether the feed-forward in force is another one, on trial.
    trial: bool,
    /// Share of the learning gain in use.
    share: f32,
}

impl Default for Gate {
    fn default() -> Self {
        Self { kept: Vec::new(), error: None, trial: false, share: 1.0 }
    }
}

/// What becomes of a feed-forward after a breath.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Verdict {
    /// It stays, and the errors of the breath may correct it.
    Keep,
    /// Back to the one before.
    Drop,
    /// It belongs to another lung.
    Forget,
}

impl Gate {
    /// The verdict on the feed-forward in force after a breath with this mean error, cmH2O.
    fn verdict(&self, error: f32) -> Verdict {
        match self.error {
            Some(known) if self.trial && error >= known => Verdict::Drop,
            Some(known) if !self.trial && error > (known * (1.0 + WORSE.0)).max(known + WORSE.1) => {
                Verdict::Forget
            }
            _ => Verdict::Keep,
        }
    }
}

impl Gated {
    /// The law with learning gain, lead in ms, half base in ms and bound in percent, for a control period in microseconds.
    ///
    /// # Errors
    /// A value out of bounds, or a period for which the learned controller was not trained.
    pub fn new(values: [f32; 4], period_us: u32) -> Result<Self, RivalError> {
        parameter::check(&PARAMETERS, &values)?;
        let [gain, lead_ms, half_base_ms, bound] = values;
        let residual = learned();
        let trained_us = residual.spec().period_us;
        if period_us != trained_us {
            return Err(RivalError::Period { learned: LEARNED, trained_us, period_us });
        }
        Ok(Self {
            controller: Controller::Residual(residual),
            learning: FeedLearning::new([gain, lead_ms, half_base_ms], period_us),
            bound,
        })
    }

    /// The learning rule, for its certificate.
    pub fn filter(&self) -> LearningFilter {
        self.learning.filter()
    }

    /// Judges the feed-forward by an undisturbed breath, and decides on that of the next one.
    fn judge(&self, state: &mut GatedState) {
        let error = mean(&state.errors);
        let gate = &mut state.gate;
        match gate.verdict(error) {
            Verdict::Keep => {
                (gate.error, gate.trial) = (Some(error), false);
                gate.kept.clone_from(&state.feed);
                if gate.share >= LEAST_SHARE {
                    state.feed = self.learning.learned(&gate.kept, &state.errors, gate.share, self.bound);
                    gate.trial = true;
                }
            }
            Verdict::Drop => {
                state.feed.clone_from(&gate.kept);
                (gate.trial, gate.share) = (false, SHRINK * gate.share);
            }
            Verdict::Forget => forget(state),
        }
    }
}

/// Forgets the feed-forward and what the gate knows.
fn forget(state: &mut GatedState) {
    state.feed.clear();
    state.gate = Gate::default();
}

/// The shipped controller.
fn learned() -> Residual {
    shipped::residual(LEARNED).expect("a test names every shipped controller")
}

/// Mean absolute value, of at least one.
fn mean(errors: &[f32]) -> f32 {
    errors.iter().map(|error| error.abs()).sum::<f32>() / errors.len() as f32
}

impl Law for Gated {
    fn pid(&self) -> &Pid {
        self.controller.pid()
    }
}

impl ControlLaw for Gated {
    type State = GatedState;

    fn initial_state(&self) -> GatedState {
        GatedState::default()
    }

    fn learn(&self, state: &mut GatedState, lesson: Lesson) -> Lesson {
        // A breath that surprises the network makes it forget.
        let learned = match self.controller.learn(&mut state.controller, lesson) {
            Lesson::Adopt if !feed_learning::sound(&state.errors) => Lesson::Discard,
            learned => learned,
        };
        match learned {
            Lesson::Adopt => self.judge(state),
            Lesson::Discard => {}
            Lesson::Forget => forget(state),
        }
        state.errors.clear();
        learned
    }

    fn start_breath(&self, state: &mut GatedState, command: f32) {
        self.controller.start_breath(&mut state.controller, command);
        state.errors.clear();
    }

    fn step(&self, state: &mut GatedState, seen: &Observation) -> ControlOutput {
        self.learning.record(&mut state.errors, seen.tick, seen.target - seen.pressure);
        let output = self.controller.step(&mut state.controller, seen);
        let fed = output.command + feed_learning::at(&state.feed, seen.tick as usize);
        ControlOutput { command: math::limit(fed, 0.0, COMMAND_MAX), ..output }
    }

    fn applied(&self, state: &mut GatedState, command: f32) {
        // The network sees the whole command. With its own part alone, later breaths would be 1 % worse.
        self.controller.applied(&mut state.controller, command);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use plant::bench::BenchConfig;
    use shared::breath::{DEFAULT_PERIOD_US, paper_settings};
    use trials::robust::plant_run::{PlantRun, breaths};

    fn law(values: [f32; 4]) -> Gated {
        Gated::new(values, DEFAULT_PERIOD_US).unwrap()
    }

    /// A high gain without lead and smoothing, whose first trial is in the second breath.
    fn eager() -> Gated {
        law([2.0, 0.0, 0.0, 20.0])
    }

    fn seen(tick: u32, error: f32) -> Observation {
        Observation { pressure: 15.0 - error, target: 15.0, pip: 15.0, peep: 5.0, tick, rise_ticks: 0 }
    }

    /// Runs an inspiration with this error in each tick, and lets the law learn from it.
    fn breathe(law: &Gated, state: &mut GatedState, error: f32, lesson: Lesson) -> Lesson {
        law.start_breath(state, 0.0);
        for tick in 0..1000 {
            let command = law.step(state, &seen(tick, error)).command;
            law.applied(state, command);
        }
        law.learn(state, lesson)
    }

    /// The law after adopted breaths with these errors.
    fn after(law: &Gated, errors: &[f32]) -> GatedState {
        let mut state = law.initial_state();
        for error in errors {
            assert_eq!(breathe(law, &mut state, *error, Lesson::Adopt), Lesson::Adopt);
        }
        state
    }

    /// The feed-forward in the middle of the next breath, percent.
    fn feed(state: &GatedState) -> f32 {
        feed_learning::at(&state.feed, 500)
    }

    #[track_caller]
    fn near(value: f32, wanted: f32) {
        assert!((value - wanted).abs() < 1e-4, "{value}, not {wanted}");
    }

    #[test]
    fn the_first_breath_is_that_of_the_learned_controller_alone() {
        let (law, controller) = (eager(), Controller::Residual(learned()));
        let (mut state, mut alone) = (law.initial_state(), controller.initial_state());
        law.start_breath(&mut state, 0.0);
        controller.start_breath(&mut alone, 0.0);
        for tick in 0..1000 {
            let seen = seen(tick, 5.0 - 0.01 * tick as f32);
            let output = law.step(&mut state, &seen);
            assert_eq!(output, controller.step(&mut alone, &seen));
            law.applied(&mut state, output.command);
            controller.applied(&mut alone, output.command);
        }
        assert_eq!(law.pid().gains(), controller.pid().gains());
    }

    #[test]
    fn a_correction_is_kept_while_the_error_becomes_smaller() {
        let law = eager();
        near(feed(&after(&law, &[1.0])), 2.0);
        near(feed(&after(&law, &[1.0, 0.9])), 3.8);
        near(feed(&after(&law, &[1.0, 0.9, 0.8])), 5.4);
    }

    #[test]
    fn a_correction_that_made_a_breath_worse_is_dropped_and_the_next_one_is_smaller() {
        let law = eager();
        let mut state = after(&law, &[1.0, 0.9, 0.95]);
        near(feed(&state), 2.0);
        assert!(!state.gate.trial, "the next breath measures the kept one again");
        breathe(&law, &mut state, 0.9, Lesson::Adopt);
        near(feed(&state), 2.0 + 0.5 * 2.0 * 0.9);
        near(feed(&after(&law, &[1.0, 1.0])), 0.0);
    }

    #[test]
    fn after_some_drops_nothing_is_tried_any_more() {
        let law = eager();
        let mut state = after(&law, &[1.0; 10]);
        for _ in 0..5 {
            near(feed(&state), 0.0);
            breathe(&law, &mut state, 1.0, Lesson::Adopt);
        }
    }

    #[test]
    fn a_disturbed_breath_decides_nothing() {
        let law = eager();
        let mut state = after(&law, &[1.0, 0.9]);
        let before = (state.feed.clone(), state.gate.clone());
        for error in [0.1, 3.0] {
            assert_eq!(breathe(&law, &mut state, error, Lesson::Discard), Lesson::Discard);
            assert_eq!((&state.feed, &state.gate), (&before.0, &before.1));
        }
        near(feed(&after(&law, &[1.0, 0.9, 0.8])), 5.4);
    }

    #[test]
    fn a_breath_that_surprises_the_network_forgets_all() {
        let law = eager();
        let mut state = after(&law, &[1.0, 0.9, 0.8, 0.7, 0.6]);
        assert_eq!(breathe(&law, &mut state, 3.0, Lesson::Adopt), Lesson::Forget);
        assert_eq!(state.gate, Gate::default());
        near(feed(&state), 0.0);
    }

    #[test]
    fn a_pressure_that_is_no_number_decides_nothing() {
        let law = eager();
        let mut state = after(&law, &[1.0]);
        let before = state.feed.clone();
        assert_eq!(breathe(&law, &mut state, f32::NAN, Lesson::Adopt), Lesson::Discard);
        assert_eq!(state.feed, before);
        let mut silent = law.initial_state();
        assert_eq!(law.learn(&mut silent, Lesson::Adopt), Lesson::Discard, "no breath at all");
        // The network remembers a breath that it took over in the middle; there is no error of its beginning to learn from.
        let mut late = law.initial_state();
        law.start_breath(&mut late, 0.0);
        for tick in 300..1000 {
            let command = law.step(&mut late, &seen(tick, 1.0)).command;
            law.applied(&mut late, command);
        }
        assert_eq!(law.learn(&mut late, Lesson::Adopt), Lesson::Discard);
        assert_eq!(late.gate, Gate::default());
    }

    #[test]
    fn changed_settings_forget_all() {
        let law = eager();
        let mut state = after(&law, &[1.0, 0.9, 0.95]);
        assert_eq!(law.learn(&mut state, Lesson::Forget), Lesson::Forget);
        assert_eq!(state.gate, Gate::default());
        near(feed(&state), 0.0);
    }

    #[test]
    fn a_breath_that_is_clearly_worse_without_a_trial_forgets_all() {
        let law = eager();
        let mut state = after(&law, &[1.0, 0.9, 0.95]);
        breathe(&law, &mut state, 1.15, Lesson::Adopt);
        assert!(feed(&state) > 2.0, "by less than that it is still the same lung");
        let mut state = after(&law, &[1.0, 0.9, 0.95]);
        breathe(&law, &mut state, 1.25, Lesson::Adopt);
        assert_eq!(state.gate, Gate::default());
        near(feed(&state), 0.0);
        // A large error has to grow by a share of it.
        for (error, forgets) in [(3.5, false), (3.7, true)] {
            let mut state = after(&law, &[3.3, 3.0, 3.1]);
            breathe(&law, &mut state, error, Lesson::Adopt);
            assert_eq!(state.gate == Gate::default(), forgets, "{error}");
        }
    }

    #[test]
    fn the_feed_forward_is_bounded_however_long_it_helps() {
        let law = law([2.0, 0.0, 0.0, 7.0]);
        let errors: Vec<f32> = (0..30).map(|breath| 3.0 - 0.05 * breath as f32).collect();
        let state = after(&law, &errors);
        assert!(state.feed.iter().all(|value| value.abs() <= 7.0));
        near(feed(&state), 7.0);
    }

    #[test]
    fn another_control_period_than_the_trained_one_is_refused() {
        let refused = Gated::new([0.5, 45.0, 30.0, 20.0], 2000).unwrap_err().to_string();
        assert!(refused.contains("control period of 1000 us, not 2000"), "{refused}");
    }

    #[test]
    fn on_units_with_a_slow_valve_later_breaths_are_better_than_without() {
        let (mut gated, mut alone) = (0.0, 0.0);
        for lag_ms in [30.0, 45.0, 60.0, 80.0] {
            let mut bench = BenchConfig::paper(20.0, 20.0);
            bench.valve.lag_ms = lag_ms;
            let run =
                PlantRun { bench, settings: paper_settings(25.0), noise: 1, breaths: 12, goes_on: false };
            let last = |scores: Vec<f64>| scores[8..].iter().sum::<f64>();
            gated += last(breaths(&run, &tuned()).unwrap().every);
            alone += last(breaths(&run, &Controller::Residual(learned())).unwrap().every);
        }
        assert!(gated < 0.99 * alone, "{gated}, not below {alone}");
    }

    /// The law with its tuned values.
    fn tuned() -> Gated {
        law(PARAMETERS.map(|parameter| parameter.tuned))
    }
}
