//! Iterative learning control over a PID.
//!
//! Breaths repeat, so the error of one breath tells what the next one needs: each undisturbed breath corrects the feed-forward by the
//! rule of [`super::feed_learning`]. `lab margins --learning` certifies the rule. A soft PID
//! allows a high learning gain; over a stiff one a high gain rings unless the smoothing is wide. The tuned values are of the second
//! kind.

use shared::control::memory::Lesson;
use shared::control::pid::{Pid, PidGains, PidState};
use shared::control::{COMMAND_MAX, ControlLaw, ControlOutput, Observation};

use super::feed_learning::{self, FeedLearning};
use super::parameter::{self, GAIN_D, GAIN_I, GAIN_P, Parameter, RivalError};
use margins::iteration::LearningFilter;
use ventilator::law::Law;

/// Parameters in the order of [`Iterative::new`]. The values are those that `lab tune-rival iterative` had found for the
/// family `adult` when it was stopped after 403 points scored in full.
pub(super) const PARAMETERS: [Parameter; 6] = [
    Parameter { coarse: &[1.0, 2.5, 5.0], tuned: 4.375, ..GAIN_P },
    Parameter { coarse: &[30.0, 60.0, 150.0], tuned: 206.25, ..GAIN_I },
    Parameter { coarse: &[0.0, 0.08, 0.16], tuned: 0.2, ..GAIN_D },
    Parameter { coarse: &[0.5, 1.0, 2.0], tuned: 2.75, ..feed_learning::GAIN },
    Parameter { coarse: &[35.0, 50.0, 65.0], tuned: 18.125, ..feed_learning::LEAD },
    Parameter { coarse: &[8.0, 15.0, 30.0], tuned: 90.0, ..feed_learning::HALF_BASE },
];

/// A PID with a feed-forward learned from breath to breath.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Iterative {
    pid: Pid,
    learning: FeedLearning,
}

/// Feed-forward and errors over the ticks of an inspiration.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct IterativeState {
    pid: PidState,
    /// What earlier breaths have taught, percent.
    feed: Vec<f32>,
    /// Errors of the running inspiration, cmH2O.
    errors: Vec<f32>,
}

impl Iterative {
    /// The law with P, I, D, learning gain, lead in ms and half base in ms, for a control period in microseconds.
    ///
    /// # Errors
    /// A value out of bounds.
    pub fn new(values: [f32; 6], period_us: u32) -> Result<Self, RivalError> {
        parameter::check(&PARAMETERS, &values)?;
        let [p, i, d, learning @ ..] = values;
        Ok(Self {
            pid: Pid::new(PidGains { p, i, d }, period_us)?,
            learning: FeedLearning::new(learning, period_us),
        })
    }

    /// The learning rule, for its certificate.
    pub fn filter(&self) -> LearningFilter {
        self.learning.filter()
    }
}

impl Law for Iterative {
    fn pid(&self) -> &Pid {
        &self.pid
    }
}

impl ControlLaw for Iterative {
    type State = IterativeState;

    fn initial_state(&self) -> IterativeState {
        IterativeState::default()
    }

    fn learn(&self, state: &mut IterativeState, lesson: Lesson) -> Lesson {
        let sound = feed_learning::sound(&state.errors);
        let learned = if lesson == Lesson::Adopt && !sound { Lesson::Discard } else { lesson };
        match learned {
            Lesson::Adopt => {
                state.feed = self.learning.learned(&state.feed, &state.errors, 1.0, COMMAND_MAX);
            }
            Lesson::Discard => {}
            Lesson::Forget => state.feed.clear(),
        }
        state.errors.clear();
        learned
    }

    fn start_breath(&self, state: &mut IterativeState, _command: f32) {
        state.pid = PidState::new();
        state.errors.clear();
    }

    fn step(&self, state: &mut IterativeState, seen: &Observation) -> ControlOutput {
        self.learning.record(&mut state.errors, seen.tick, seen.target - seen.pressure);
        self.pid.step(&mut state.pid, seen, feed_learning::at(&state.feed, seen.tick as usize))
    }

    fn applied(&self, _state: &mut IterativeState, _command: f32) {}
}

#[cfg(test)]
mod tests {
    use super::*;
    use plant::bench::BenchConfig;
    use shared::breath::{DEFAULT_PERIOD_US, paper_settings};
    use trials::robust::plant_run::{PlantRun, breaths};

    fn law(values: [f32; 6]) -> Iterative {
        Iterative::new(values, DEFAULT_PERIOD_US).unwrap()
    }

    /// Textbook values, with a PID that adds nothing.
    fn learning_alone() -> Iterative {
        law([0.0, 0.0, 0.0, 2.0, 50.0, 15.0])
    }

    fn seen(tick: u32, error: f32) -> Observation {
        Observation { pressure: 15.0 - error, target: 15.0, pip: 15.0, peep: 5.0, tick, rise_ticks: 0 }
    }

    /// Runs an inspiration with this error in each tick.
    fn breathe(law: &Iterative, state: &mut IterativeState, error: impl Fn(u32) -> f32) {
        law.start_breath(state, 0.0);
        for tick in 0..1000 {
            law.step(state, &seen(tick, error(tick)));
        }
    }

    fn feed(law: &Iterative, state: &IterativeState, tick: u32) -> f32 {
        law.step(&mut state.clone(), &seen(tick, 0.0)).command
    }

    #[test]
    fn a_breath_without_an_error_teaches_nothing() {
        let (law, mut state) = (learning_alone(), IterativeState::default());
        breathe(&law, &mut state, |_| 0.0);
        assert_eq!(law.learn(&mut state, Lesson::Adopt), Lesson::Adopt);
        assert!((0..1000).all(|tick| feed(&law, &state, tick).abs() < 1e-9));
    }

    #[test]
    fn an_error_is_answered_in_the_next_breath_earlier_by_the_lead_and_smoothed() {
        let (law, mut state) = (learning_alone(), IterativeState::default());
        breathe(&law, &mut state, |tick| if tick == 300 { 16.0 } else { 0.0 });
        law.learn(&mut state, Lesson::Adopt);
        assert!(
            (feed(&law, &state, 250) - 2.0 * 16.0 * 16.0 / 256.0).abs() < 1e-4,
            "the top of the triangle"
        );
        assert!((feed(&law, &state, 265) - 2.0 * 16.0 * 1.0 / 256.0).abs() < 1e-4, "its last tick");
        assert!(feed(&law, &state, 266).abs() < 1e-6 && feed(&law, &state, 300).abs() < 1e-6);
    }

    #[test]
    fn what_was_learned_adds_up_and_stays_within_the_valves_range() {
        let (law, mut state) = (learning_alone(), IterativeState::default());
        for breath in 1..=60 {
            breathe(&law, &mut state, |_| 1.0);
            law.learn(&mut state, Lesson::Adopt);
            let wanted = (2.0 * f64::from(breath)).min(100.0);
            assert!((f64::from(feed(&law, &state, 500)) - wanted).abs() < 1e-3, "{breath}");
        }
        assert!(state.feed.iter().all(|value| value.abs() <= COMMAND_MAX), "the memory itself is limited");
    }

    #[test]
    fn a_disturbed_breath_is_left_out_and_a_change_of_settings_forgets_all() {
        let (law, mut state) = (learning_alone(), IterativeState::default());
        breathe(&law, &mut state, |_| 1.0);
        law.learn(&mut state, Lesson::Adopt);
        breathe(&law, &mut state, |_| 9.0);
        assert_eq!(law.learn(&mut state, Lesson::Discard), Lesson::Discard);
        assert!((feed(&law, &state, 500) - 2.0).abs() < 1e-4);
        assert_eq!(law.learn(&mut state, Lesson::Forget), Lesson::Forget);
        assert_eq!((state.feed.len(), state.errors.len()), (0, 0));
    }

    #[test]
    fn a_breath_with_a_pressure_that_is_no_number_is_left_out() {
        let (law, mut state) = (learning_alone(), IterativeState::default());
        breathe(&law, &mut state, |tick| if tick == 7 { f32::NAN } else { 1.0 });
        assert_eq!(law.learn(&mut state, Lesson::Adopt), Lesson::Discard);
        assert!(feed(&law, &state, 500).abs() < 1e-9);
    }

    #[test]
    fn a_command_that_is_not_trusted_is_that_of_the_pid_alone() {
        let (law, mut state) = (law([1.0, 0.0, 0.0, 2.0, 50.0, 15.0]), IterativeState::default());
        breathe(&law, &mut state, |_| 1.0);
        law.learn(&mut state, Lesson::Adopt);
        let output = law.step(&mut state, &seen(0, 3.0));
        assert!((output.base - 3.0).abs() < 1e-5 && (output.command - 5.0).abs() < 1e-4, "{output:?}");
    }

    #[test]
    fn errors_that_repeat_shrink_from_breath_to_breath_on_the_bench() {
        let run = PlantRun {
            bench: BenchConfig::paper(20.0, 20.0),
            settings: paper_settings(25.0),
            noise: 1,
            breaths: 30,
            goes_on: false,
        };
        let scores = breaths(&run, &law([2.5, 60.0, 0.08, 1.0, 50.0, 15.0])).unwrap().every;
        assert!(scores[29] < 0.8 * scores[0], "{scores:?}");
    }
}
