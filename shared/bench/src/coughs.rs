//! Coughs: a single one at a stated time, or many at random times.

use rand_chacha::ChaCha8Rng;

use super::config::PatientConfig;
use super::pulse::pulse;
use crate::random::exponential;

/// The coughs and their state, the present cough and the beginning of the next.
#[derive(Clone, Debug)]
pub(super) struct Coughs {
    /// Peak and beginning of the last cough to begin, or of the single one.
    peak: f64,
    at_s: f64,
    duration_s: f64,
    random: Option<Random>,
}

/// Coughs at random times.
#[derive(Clone, Debug)]
struct Random {
    rng: ChaCha8Rng,
    peak: f64,
    mean_interval_s: f64,
    next_s: f64,
}

impl Random {
    fn interval_s(&mut self) -> f64 {
        self.mean_interval_s * exponential(&mut self.rng)
    }
}

impl Coughs {
    /// The coughs of a patient; random ones draw from `rng`.
    #[inline(never)]
    pub(super) fn new(config: &PatientConfig, rng: ChaCha8Rng) -> Self {
        let (peak, at_s, duration_s) = (config.cough_cmh2o, config.cough_at_s, config.cough_duration_s);
        if config.coughs_per_hour <= 0.0 || peak <= 0.0 {
            return Self { peak, at_s, duration_s, random: None };
        }
        let mut random = Random { rng, peak, mean_interval_s: 3600.0 / config.coughs_per_hour, next_s: 0.0 };
        random.next_s = random.interval_s();
        Self { peak: 0.0, at_s: 0.0, duration_s, random: Some(random) }
    }

    /// Adds a cough with this peak, cmH2O, at this time, s; it replaces one that has not ended.
    pub(super) fn add(&mut self, peak: f64, at_s: f64) {
        (self.peak, self.at_s) = (peak, at_s);
    }

    /// Begins the next random cough if it is due at this time, s.
    #[inline]
    pub(super) fn advance(&mut self, time_s: f64) {
        let Some(random) = &mut self.random else { return };
        if time_s >= random.next_s {
            (self.peak, self.at_s) = (random.peak, random.next_s);
            random.next_s += random.interval_s().max(self.duration_s);
        }
    }

    /// Expulsive pressure, cmH2O.
    #[inline]
    pub(super) fn pressure(&self, time_s: f64) -> f64 {
        if self.peak > 0.0 { self.peak * pulse(time_s - self.at_s, self.duration_s) } else { 0.0 }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand_chacha::rand_core::SeedableRng;

    fn coughs(coughs_per_hour: f64, seed: u64) -> Coughs {
        let config = PatientConfig { cough_cmh2o: 40.0, coughs_per_hour, ..PatientConfig::default() };
        Coughs::new(&config, ChaCha8Rng::seed_from_u64(seed))
    }

    /// Beginnings of the coughs in this many hours, s.
    fn beginnings(mut coughs: Coughs, hours: u32) -> Vec<f64> {
        let mut found = Vec::new();
        for centiseconds in 0..hours * 360_000 {
            coughs.advance(f64::from(centiseconds) * 0.01);
            if coughs.peak > 0.0 && found.last().is_none_or(|last| *last < coughs.at_s) {
                found.push(coughs.at_s);
            }
        }
        found
    }

    #[test]
    fn random_coughs_come_at_their_rate_and_without_memory() {
        let beginnings = beginnings(coughs(60.0, 1), 60);
        let intervals: Vec<f64> = beginnings.windows(2).map(|pair| pair[1] - pair[0]).collect();
        let n = intervals.len() as f64;
        let mean = intervals.iter().sum::<f64>() / n;
        // Five standard errors: 8 % of the mean, 1 % of a share.
        assert!((mean / 60.0 - 1.0).abs() < 0.08, "{mean}");
        for (longer_s, expected) in [(60.0, 0.368), (120.0, 0.135)] {
            let share = intervals.iter().filter(|interval| **interval > longer_s).count() as f64 / n;
            assert!((share - expected).abs() < 0.04, "{share} of the intervals exceed {longer_s} s");
        }
    }

    #[test]
    fn a_random_cough_is_a_pulse_of_the_stated_peak() {
        let mut coughs = coughs(600.0, 1);
        let first_s = coughs.random.as_ref().unwrap().next_s;
        assert!(coughs.pressure(first_s - 1e-3).abs() < 1e-12);
        coughs.advance(first_s);
        assert!((coughs.pressure(first_s + 0.15) - 40.0).abs() < 1e-9);
        assert!(coughs.pressure(first_s + 0.301).abs() < 1e-12);
    }

    #[test]
    fn the_same_seed_gives_the_same_coughs() {
        let with = |seed| beginnings(coughs(60.0, seed), 1);
        assert_eq!(with(7), with(7));
        assert_ne!(with(7), with(8));
    }

    #[test]
    fn without_a_rate_there_is_the_single_cough() {
        let mut single = coughs(0.0, 1);
        single.advance(1e5);
        assert!((single.pressure(10.15) - 40.0).abs() < 1e-9);
        assert!(single.pressure(20.0).abs() < 1e-12);
    }
}
