//! Pressure sensor: lag, offset with drift, Gaussian noise, converter of 12 bits (more if its quantum is finer).

use rand_chacha::ChaCha8Rng;

use super::config::SensorConfig;
use super::lag::Lag;
use crate::math::ceil;
use crate::random::normal;

/// Number of readings of a 12-bit converter.
const CODES: f64 = 4096.0;
/// Share of the readings below zero (room pressure).
const BELOW_ZERO: f64 = 0.25;
/// Minimum range of a converter, cmH2O: that of the default quantum in 12 bits.
const LEAST_RANGE: f64 = 0.07 * CODES;

/// The sensor and its state.
#[derive(Clone, Debug)]
pub(super) struct Sensor {
    lag: Lag,
    noise_sd: f64,
    quantum: f64,
    /// Number of readings of the converter.
    codes: f64,
    rng: ChaCha8Rng,
}

impl Sensor {
    /// A sensor at rest at `pressure`; its noise comes from `rng`.
    #[inline(never)]
    pub(super) fn new(config: &SensorConfig, pressure: f64, sub_step_s: f64, rng: ChaCha8Rng) -> Self {
        Self {
            lag: Lag::new(config.lag_ms * 1e-3, sub_step_s, pressure),
            noise_sd: config.noise_sd_cmh2o,
            quantum: config.quantum_cmh2o,
            codes: CODES * ceil(LEAST_RANGE / (CODES * config.quantum_cmh2o)).max(1.0),
            rng,
        }
    }

    /// One sub-step at the airway pressure `pressure`.
    pub(super) fn advance(&mut self, pressure: f64) {
        self.lag.advance(pressure);
    }

    /// Lagged pressure, cmH2O.
    pub(super) fn lagged(&self) -> f64 {
        self.lag.output()
    }

    /// One sample in cmH2O from a sensor with this `offset`.
    pub(super) fn sample(&mut self, offset: f64) -> f32 {
        let analogue = self.lag.output() + offset + self.noise_sd * normal(&mut self.rng);
        // Zero is the only non-positive step that the configuration allows.
        if self.quantum <= 0.0 {
            return analogue as f32;
        }
        // Adding a half and truncating rounds like a converter, and is faster than `round`.
        let zero = BELOW_ZERO * self.codes;
        let code = (analogue / self.quantum + zero + 0.5).clamp(0.0, self.codes - 1.0) as u32;
        ((f64::from(code) - zero) * self.quantum) as f32
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand_chacha::rand_core::SeedableRng;

    const SUB_STEP_S: f64 = 0.000_25;

    fn sensor(config: &SensorConfig, pressure: f64) -> Sensor {
        Sensor::new(config, pressure, SUB_STEP_S, ChaCha8Rng::seed_from_u64(3))
    }

    fn mean_and_sd(samples: &[f64]) -> (f64, f64) {
        let n = samples.len() as f64;
        let mean = samples.iter().sum::<f64>() / n;
        (mean, (samples.iter().map(|x| (x - mean).powi(2)).sum::<f64>() / (n - 1.0)).sqrt())
    }

    #[test]
    fn noise_has_the_stated_sd_and_no_bias() {
        let config = SensorConfig { quantum_cmh2o: 0.0, ..SensorConfig::default() };
        let mut sensor = sensor(&config, 17.0);
        let samples: Vec<f64> = (0..40_000).map(|_| f64::from(sensor.sample(0.3))).collect();
        let (mean, sd) = mean_and_sd(&samples);
        // Standard errors: 0.0005 of the mean, 0.35 % of the sd; the bounds are five of them.
        assert!((mean - 17.3).abs() < 0.0025, "{mean}");
        assert!((sd / 0.1 - 1.0).abs() < 0.018, "{sd}");
    }

    #[test]
    fn noise_is_white() {
        let config = SensorConfig { quantum_cmh2o: 0.0, ..SensorConfig::default() };
        let mut sensor = sensor(&config, 0.0);
        let samples: Vec<f64> = (0..40_000).map(|_| f64::from(sensor.sample(0.0))).collect();
        let products: f64 = samples.windows(2).map(|pair| pair[0] * pair[1]).sum();
        let correlation = products / samples.iter().map(|x| x * x).sum::<f64>();
        assert!(correlation.abs() < 0.025, "{correlation}");
    }

    #[test]
    fn samples_stand_on_the_grid_of_the_converter() {
        let config = SensorConfig::default();
        let mut sensor = sensor(&config, 12.34);
        let mut codes: Vec<i64> = Vec::new();
        for _ in 0..1_000 {
            let code = f64::from(sensor.sample(0.0)) / config.quantum_cmh2o;
            assert!((code - code.round()).abs() < 1e-4, "{code}");
            codes.push(code.round() as i64);
        }
        codes.sort_unstable();
        codes.dedup();
        assert!(codes.len() >= 6, "noise of 0.1 reaches several quanta: {codes:?}");
    }

    #[test]
    fn rounds_to_the_nearest_quantum() {
        let config = SensorConfig { noise_sd_cmh2o: 0.0, quantum_cmh2o: 0.5, ..SensorConfig::default() };
        for (pressure, expected) in [(5.2, 5.0), (5.3, 5.5), (-5.2, -5.0), (-5.3, -5.5)] {
            assert!((sensor(&config, pressure).sample(0.0) - expected).abs() < 1e-6, "{pressure}");
        }
    }

    #[test]
    fn a_fine_quantum_does_not_narrow_the_range() {
        let config = SensorConfig { noise_sd_cmh2o: 0.0, quantum_cmh2o: 0.010_2, ..SensorConfig::default() };
        for pressure in [-50.0, 31.5, 100.0] {
            let read = f64::from(sensor(&config, pressure).sample(0.0));
            assert!((read - pressure).abs() < 0.006, "{read} at {pressure}");
        }
    }

    #[test]
    fn saturates_at_the_ends_of_twelve_bits() {
        let config = SensorConfig::default();
        assert!((sensor(&config, 1e4).sample(0.0) - 3071.0 * 0.07).abs() < 1e-3);
        assert!((sensor(&config, -1e4).sample(0.0) + 1024.0 * 0.07).abs() < 1e-3);
    }

    #[test]
    fn lags_behind_the_airway() {
        let mut sensor = sensor(&SensorConfig::default(), 0.0);
        for _ in 0..16 {
            sensor.advance(10.0);
        }
        assert!((sensor.lagged() - 10.0 * (1.0 - (-1.0_f64).exp())).abs() < 1e-9, "4 ms");
    }
}
