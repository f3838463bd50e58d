//! How evenly a device ticks.

use shared::timing::TickTimes;

/// How far the periods of the control ticks are from the one that is meant.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Evenness {
    /// Distance of the mean period, us.
    pub bias_us: f32,
    /// Largest distance of a period, us.
    pub jitter_us: f32,
}

impl Evenness {
    /// That of ticks which are meant to come in this period, us; none before the second tick, or from a device without a core clock.
    pub fn of(times: &TickTimes, period_us: u32) -> Option<Self> {
        let off = |cycles: f32| times.microseconds(cycles) - period_us as f32;
        let (shortest, longest) = (off(times.period.shortest as f32), off(times.period.longest as f32));
        (times.period.longest > 0)
            .then(|| Self { bias_us: off(times.period.mean), jitter_us: longest.abs().max(shortest.abs()) })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use shared::timing::CycleStats;

    #[test]
    fn the_bias_is_that_of_the_mean_and_the_jitter_the_largest_distance_to_either_side() {
        let period = CycleStats { shortest: 167_832, mean: 168_084.0, longest: 168_168 };
        let times = TickTimes { core_hz: 168_000_000, period, ..TickTimes::default() };
        let Evenness { bias_us, jitter_us } = Evenness::of(&times, 1000).unwrap();
        assert!((bias_us - 0.5).abs() < 1e-3 && (jitter_us - 1.0).abs() < 1e-3, "{bias_us} {jitter_us}");
        assert_eq!(Evenness::of(&TickTimes::default(), 1000), None, "no period before the second tick");
    }
}
