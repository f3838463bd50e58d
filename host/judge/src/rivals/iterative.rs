//! Iterative learning control over a PID.
//!
//! Breaths repeat, so the error of one breath tells what the next one needs: after each undisturbed breath the feed-forward becomes
//! `f <- Q [f + g e(t + lead)]`. The correction comes `lead` before the error that it answers, because the valve acts late; Q is a
//! zero-phase triangle, which keeps what the loop cannot follow out of the feed-forward. `trainer margins --learning` certifies the
//! rule. A soft PID allows a high learning gain; over a stiff one a high gain rings unless the smoothing is wide. The tuned values
//! are of the second kind.

use shared::breath::period_s;
use shared::control::memory::Lesson;
use shared::control::pid::{Pid, PidGains, PidState};
use shared::control::{COMMAND_MAX, ControlLaw, ControlOutput, Observation};
use shared::math;

use super::parameter::{self, GAIN_D, GAIN_I, GAIN_P, Parameter, RivalError};
use crate::margins::iteration::LearningFilter;

/// Parameters in the order of [`Iterative::new`]. The values are those that `trainer tune-rival iterative` had found for the
/// family `adult` when it was stopped after 403 points scored in full.
pub(super) const PARAMETERS: [Parameter; 6] = [
    Parameter { coarse: &[1.0, 2.5, 5.0], tuned: 4.375, ..GAIN_P },
    Parameter { coarse: &[30.0, 60.0, 150.0], tuned: 206.25, ..GAIN_I },
    Parameter { coarse: &[0.0, 0.08, 0.16], tuned: 0.2, ..GAIN_D },
    Parameter {
        name: "gain",
        unit: "%/cmH2O",
        meaning: "learning gain from breath to breath",
        coarse: &[0.5, 1.0, 2.0],
        bounds: (0.0, 100.0),
        tuned: 2.75,
    },
    Parameter {
        name: "lead",
        unit: "ms",
        meaning: "time by which the correction precedes the error",
        coarse: &[35.0, 50.0, 65.0],
        bounds: (0.0, 1000.0),
        tuned: 18.125,
    },
    Parameter {
        name: "half base",
        unit: "ms",
        meaning: "half of the smoothing triangle's base",
        coarse: &[8.0, 15.0, 30.0],
        bounds: (0.0, 1000.0),
        tuned: 90.0,
    },
];

/// Longest inspiration that is remembered, s; what follows runs under the PID alone.
const LONGEST_S: f32 = 10.0;

/// A PID with a feed-forward learned from breath to breath.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Iterative {
    pid: Pid,
    filter: LearningFilter,
    gain: f32,
    lead_ticks: usize,
    half_ticks: usize,
    longest_ticks: usize,
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
        let [p, i, d, gain, lead_ms, half_base_ms] = values;
        let nearest = |ms: f32| (1e-3 * ms / period_s(period_us)).round() as usize;
        let filter = LearningFilter {
            gain: f64::from(gain),
            lead_s: 1e-3 * f64::from(lead_ms),
            half_base_s: 1e-3 * f64::from(half_base_ms),
        };
        Ok(Self {
            pid: Pid::new(PidGains { p, i, d }, period_us)?,
            filter,
            gain,
            lead_ticks: nearest(lead_ms),
            half_ticks: nearest(half_base_ms),
            longest_ticks: math::ticks(LONGEST_S, period_us) as usize,
        })
    }

    /// The PID underneath.
    pub fn pid(&self) -> &Pid {
        &self.pid
    }

    /// The learning rule, for its certificate.
    pub fn filter(&self) -> LearningFilter {
        self.filter
    }

    /// The feed-forward after a breath with these errors, which are not empty.
    fn learned(&self, feed: &[f32], errors: &[f32]) -> Vec<f32> {
        let last = errors.len() - 1;
        let raised: Vec<f32> = (0..errors.len())
            .map(|tick| {
                feed.get(tick).copied().unwrap_or(0.0)
                    + self.gain * errors[(tick + self.lead_ticks).min(last)]
            })
            .collect();
        (0..=last).map(|tick| math::limit(self.smoothed(&raised, tick), -COMMAND_MAX, COMMAND_MAX)).collect()
    }

    /// Mean around a tick under the triangle, of the part that lies within the breath.
    fn smoothed(&self, raised: &[f32], tick: usize) -> f32 {
        let from = tick.saturating_sub(self.half_ticks);
        let to = (tick + self.half_ticks).min(raised.len() - 1);
        let (mut sum, mut total) = (0.0, 0.0);
        for (at, value) in raised.iter().enumerate().take(to + 1).skip(from) {
            let weight = (self.half_ticks + 1 - at.abs_diff(tick)) as f32;
            sum += weight * value;
            total += weight;
        }
        sum / total
    }
}

impl ControlLaw for Iterative {
    type State = IterativeState;

    fn initial_state(&self) -> IterativeState {
        IterativeState::default()
    }

    fn learn(&self, state: &mut IterativeState, lesson: Lesson) -> Lesson {
        let sound = !state.errors.is_empty() && state.errors.iter().all(|error| error.is_finite());
        let learned = if lesson == Lesson::Adopt && !sound { Lesson::Discard } else { lesson };
        match learned {
            Lesson::Adopt => state.feed = self.learned(&state.feed, &state.errors),
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
        if state.errors.len() < self.longest_ticks {
            state.errors.push(seen.target - seen.pressure);
        }
        let feed = state.feed.get(seen.tick as usize).copied().unwrap_or(0.0);
        self.pid.step(&mut state.pid, seen, feed)
    }

    fn applied(&self, _state: &mut IterativeState, _command: f32) {}
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::robust::plant_run::{PlantRun, breaths};
    use plant::bench::BenchConfig;
    use shared::breath::{DEFAULT_PERIOD_US, paper_settings};

    fn law(values: [f32; 6]) -> Iterative {
        Iterative::new(values, DEFAULT_PERIOD_US).unwrap()
    }

    /// Textbook values, with a PID that adds nothing.
    fn learning_alone() -> Iterative {
        law([0.0, 0.0, 0.0, 2.0, 50.0, 15.0])
    }

    fn seen(tick: u32, error: f32) -> Observation {
        Observation { pressure: 15.0 - error, target: 15.0, pip: 15.0, peep: 5.0, tick }
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
        };
        let scores = breaths(&run, &law([2.5, 60.0, 0.08, 1.0, 50.0, 15.0])).unwrap().every;
        assert!(scores[29] < 0.8 * scores[0], "{scores:?}");
    }
}
