//! A feed-forward that is learned from breath to breath: the rule that [`super::iterative`] and [`super::gated`] share.
//!
//! After a breath the feed-forward becomes `f <- Q [f + g e(t + lead)]`. The correction comes `lead` before the error that it answers,
//! because the valve acts late; Q is a zero-phase triangle, which keeps what the loop cannot follow out of the feed-forward.

use shared::breath::period_s;
use shared::math;

use super::parameter::Parameter;
use margins::iteration::LearningFilter;

/// Longest inspiration that is remembered, s; what follows runs without a feed-forward.
const LONGEST_S: f32 = 10.0;

/// Learning gain; each law sets its grid and its tuned value.
pub(super) const GAIN: Parameter = Parameter {
    name: "gain",
    unit: "%/cmH2O",
    meaning: "learning gain from breath to breath",
    coarse: &[],
    bounds: (0.0, 100.0),
    tuned: 0.0,
};
/// Lead of the correction.
pub(super) const LEAD: Parameter = Parameter {
    name: "lead",
    unit: "ms",
    meaning: "time by which the correction precedes the error",
    bounds: (0.0, 1000.0),
    ..GAIN
};
/// Width of the smoothing.
pub(super) const HALF_BASE: Parameter = Parameter {
    name: "half base",
    unit: "ms",
    meaning: "half of the smoothing triangle's base",
    bounds: (0.0, 1000.0),
    ..GAIN
};

/// The learning rule on the ticks of an inspiration.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FeedLearning {
    filter: LearningFilter,
    lead_ticks: usize,
    half_ticks: usize,
    longest_ticks: usize,
}

impl FeedLearning {
    /// The rule with learning gain in percent per cmH2O, lead in ms and half base in ms, for a control period in microseconds.
    pub fn new([gain, lead_ms, half_base_ms]: [f32; 3], period_us: u32) -> Self {
        let nearest = |ms: f32| (1e-3 * ms / period_s(period_us)).round() as usize;
        let filter = LearningFilter {
            gain: f64::from(gain),
            lead_s: 1e-3 * f64::from(lead_ms),
            half_base_s: 1e-3 * f64::from(half_base_ms),
        };
        Self {
            filter,
            lead_ticks: nearest(lead_ms),
            half_ticks: nearest(half_base_ms),
            longest_ticks: math::ticks(LONGEST_S, period_us) as usize,
        }
    }

    /// The rule in continuous time, for its certificate.
    pub fn filter(&self) -> LearningFilter {
        self.filter
    }

    /// Adds the error of a tick of the running inspiration in cmH2O, unless an earlier tick is missing: a law that takes over within
    /// a breath has nothing to learn from it.
    pub fn record(&self, errors: &mut Vec<f32>, tick: u32, error: f32) {
        if errors.len() < self.longest_ticks && errors.len() == tick as usize {
            errors.push(error);
        }
    }

    /// The feed-forward in percent after a breath with this feed-forward and these errors, which are not empty; `share` of the
    /// learning gain is used. No value exceeds `bound` percent.
    pub fn learned(&self, feed: &[f32], errors: &[f32], share: f32, bound: f32) -> Vec<f32> {
        let (last, gain) = (errors.len() - 1, share * self.filter.gain as f32);
        let raised: Vec<f32> = (0..errors.len())
            .map(|tick| at(feed, tick) + gain * errors[(tick + self.lead_ticks).min(last)])
            .collect();
        (0..=last).map(|tick| math::limit(self.smoothed(&raised, tick), -bound, bound)).collect()
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

/// The feed-forward in a tick, percent; none after its end.
pub fn at(feed: &[f32], tick: usize) -> f32 {
    feed.get(tick).copied().unwrap_or(0.0)
}

/// Whether a breath can be learned from: it has errors, and all of them are numbers.
pub fn sound(errors: &[f32]) -> bool {
    !errors.is_empty() && errors.iter().all(|error| error.is_finite())
}

#[cfg(test)]
mod tests {
    use super::*;
    use shared::breath::DEFAULT_PERIOD_US;

    fn rule() -> FeedLearning {
        FeedLearning::new([2.0, 10.0, 0.0], DEFAULT_PERIOD_US)
    }

    #[test]
    fn a_share_of_the_gain_corrects_less_and_the_bound_limits_the_sum() {
        let learned = |share, bound| rule().learned(&[1.0], &[3.0; 20], share, bound);
        assert!((learned(1.0, 100.0)[0] - 7.0).abs() < 1e-6 && (learned(0.5, 100.0)[0] - 4.0).abs() < 1e-6);
        assert!((learned(1.0, 100.0)[1] - 6.0).abs() < 1e-6, "no feed-forward after its end");
        assert!(learned(1.0, 5.0).iter().all(|value| (value - 5.0).abs() < 1e-6));
    }

    #[test]
    fn within_a_breath_the_triangle_is_that_of_the_certificate() {
        let rule = FeedLearning::new([1.0, 0.0, 15.0], DEFAULT_PERIOD_US);
        for hz in [2.0, 20.0, 50.0] {
            let sine = |tick: usize| (std::f64::consts::TAU * hz * 1e-3 * tick as f64).sin();
            let errors: Vec<f32> = (0..1000).map(|tick| sine(tick) as f32).collect();
            let learned = rule.learned(&[], &errors, 1.0, 100.0);
            let factor = rule.filter().smoothing(hz, DEFAULT_PERIOD_US);
            let near = |tick: &usize| (f64::from(learned[*tick]) - factor * sine(*tick)).abs() < 1e-4;
            assert!((100..900).all(|tick| near(&tick)), "{hz} Hz");
        }
    }

    #[test]
    fn errors_are_recorded_from_the_first_tick_of_a_breath_or_not_at_all() {
        let mut errors = Vec::new();
        rule().record(&mut errors, 300, 1.0);
        assert!(!sound(&errors));
        for tick in [0, 1, 5] {
            rule().record(&mut errors, tick, 1.0);
        }
        assert_eq!(errors.len(), 2);
        assert!(sound(&errors) && !sound(&[1.0, f32::NAN]));
        (2..20_000).for_each(|tick| rule().record(&mut errors, tick, 1.0));
        assert_eq!(errors.len(), 10_000, "not more than 10 s");
    }
}
