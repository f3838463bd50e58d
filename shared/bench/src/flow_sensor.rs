//! Bidirectional flow sensor at the airway opening.

use rand_chacha::ChaCha8Rng;

use super::config::FlowSensorConfig;
use super::lag::Lag;
use crate::random::normal;
use crate::step::STEP_S;

/// The sensor and its state. Its lag moves once per step, with the mean flow of the step.
#[derive(Clone, Debug)]
pub(super) struct FlowSensor {
    lag: Lag,
    gain: f64,
    offset: f64,
    noise_sd: f64,
    rng: ChaCha8Rng,
    /// The sample of this step, once it is drawn.
    reading: Option<f32>,
}

impl FlowSensor {
    /// A sensor without flow; its noise comes from `rng`. `None` if the machine has none.
    #[inline(never)]
    pub(super) fn new(config: &FlowSensorConfig, rng: ChaCha8Rng) -> Option<Self> {
        config.present.then(|| Self {
            lag: Lag::new(config.lag_ms * 1e-3, STEP_S, 0.0),
            gain: 1.0 + config.gain_error_percent / 100.0,
            offset: config.offset_l_per_s,
            noise_sd: config.noise_sd_l_per_s,
            rng,
            reading: None,
        })
    }

    /// One step with this flow towards the patient, L/s.
    #[inline]
    pub(super) fn advance(&mut self, flow: f64) {
        self.lag.advance(flow);
        self.reading = None;
    }

    /// The sample of the last step, L/s.
    pub(super) fn sample(&mut self) -> f32 {
        *self.reading.get_or_insert_with(|| {
            (self.lag.output() * self.gain + self.offset + self.noise_sd * normal(&mut self.rng)) as f32
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand_chacha::rand_core::SeedableRng;

    fn sensor(config: &FlowSensorConfig) -> FlowSensor {
        FlowSensor::new(config, ChaCha8Rng::seed_from_u64(1)).unwrap()
    }

    #[test]
    fn gain_error_and_offset_apply_in_both_directions() {
        let config = FlowSensorConfig {
            lag_ms: 0.0,
            noise_sd_l_per_s: 0.0,
            offset_l_per_s: 0.02,
            gain_error_percent: -10.0,
            ..FlowSensorConfig::default()
        };
        let mut sensor = sensor(&config);
        for (flow, expected) in [(0.0, 0.02), (0.5, 0.47), (-1.0, -0.88)] {
            sensor.advance(flow);
            assert!((sensor.sample() - expected).abs() < 1e-6, "{flow} L/s");
        }
    }

    #[test]
    fn lags_with_its_time_constant() {
        let mut sensor = sensor(&FlowSensorConfig { noise_sd_l_per_s: 0.0, ..FlowSensorConfig::default() });
        sensor.advance(1.0);
        sensor.advance(1.0);
        assert!((sensor.sample() - (1.0 - (-1.0_f32).exp())).abs() < 1e-6, "2 ms");
    }

    #[test]
    fn noise_has_the_stated_sd_and_each_step_one_sample() {
        let mut sensor = sensor(&FlowSensorConfig::default());
        let mut squares = 0.0;
        for _ in 0..40_000 {
            sensor.advance(0.0);
            let sample = sensor.sample();
            assert_eq!(sample.to_bits(), sensor.sample().to_bits());
            squares += f64::from(sample).powi(2);
        }
        // The standard error of the sd is 0.35 %; the bound is five of them.
        assert!(((squares / 40_000.0).sqrt() / 0.005 - 1.0).abs() < 0.018);
    }
}
