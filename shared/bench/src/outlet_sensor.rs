//! Second pressure sensor, at the machine's outlet, in front of the inspiratory tube.

use rand_chacha::ChaCha8Rng;

use super::config::OutletSensorConfig;
use super::sensor::Sensor;
use crate::step::STEP_S;

/// The sensor and its state. Its lag moves once per step, with the mean flow of the step.
#[derive(Clone, Debug)]
pub(super) struct OutletSensor {
    sensor: Sensor,
    tube_resistance: f64,
    offset: f64,
    drift_per_step: f64,
    /// The sample of this step, once it is drawn.
    reading: Option<f32>,
}

impl OutletSensor {
    /// A sensor at rest at `pressure`; its noise comes from `rng`. `None` if the machine has none.
    #[inline(never)]
    pub(super) fn new(config: &OutletSensorConfig, pressure: f64, rng: ChaCha8Rng) -> Option<Self> {
        config.present.then(|| Self {
            sensor: Sensor::new(&config.sensor(), pressure, STEP_S, rng),
            tube_resistance: config.tube_resistance_cmh2o_per_l_s,
            offset: config.offset_cmh2o,
            drift_per_step: config.drift_cmh2o_per_hour * STEP_S / 3600.0,
            reading: None,
        })
    }

    /// One step with the airway at `pressure` at its end and this flow through the inspiratory valve, L/s.
    #[inline]
    pub(super) fn advance(&mut self, pressure: f64, flow_valve: f64) {
        self.sensor.advance(pressure + self.tube_resistance * flow_valve);
        self.reading = None;
    }

    /// The sample of the last step, after `steps` in all, cmH2O.
    pub(super) fn sample(&mut self, steps: u64) -> f32 {
        let offset = self.offset + self.drift_per_step * steps as f64;
        *self.reading.get_or_insert_with(|| self.sensor.sample(offset))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand_chacha::rand_core::SeedableRng;

    /// Without noise and quantum.
    fn exact() -> OutletSensorConfig {
        OutletSensorConfig { noise_sd_cmh2o: 0.0, quantum_cmh2o: 0.0, ..OutletSensorConfig::default() }
    }

    fn sensor(config: &OutletSensorConfig) -> OutletSensor {
        OutletSensor::new(config, 5.0, ChaCha8Rng::seed_from_u64(1)).unwrap()
    }

    #[test]
    fn reads_the_airway_pressure_plus_the_drop_along_the_tube() {
        let mut sensor = sensor(&OutletSensorConfig { lag_ms: 0.0, ..exact() });
        sensor.advance(20.0, 0.5);
        assert!((sensor.sample(1) - 21.5).abs() < 1e-6, "3 cmH2O/(L/s) x 0.5 L/s");
    }

    #[test]
    fn lags_with_its_time_constant() {
        let mut sensor = sensor(&exact());
        for _ in 0..4 {
            sensor.advance(15.0, 0.0);
        }
        let expected = 15.0 - 10.0 * (-1.0_f32).exp();
        assert!((sensor.sample(4) - expected).abs() < 1e-5, "4 ms");
    }

    #[test]
    fn offset_drifts_by_the_hour() {
        let config = OutletSensorConfig { offset_cmh2o: 0.7, drift_cmh2o_per_hour: -0.4, ..exact() };
        assert!((sensor(&config).sample(0) - 5.7).abs() < 1e-6);
        assert!((sensor(&config).sample(7_200_000) - 4.9).abs() < 1e-6);
    }

    #[test]
    fn a_step_has_one_sample_however_often_it_is_read() {
        let mut sensor = sensor(&OutletSensorConfig::default());
        let first = sensor.sample(1);
        assert_eq!(first.to_bits(), sensor.sample(1).to_bits());
        let others = (2..20).filter(|step| {
            sensor.advance(5.0, 0.0);
            sensor.sample(*step).to_bits() != first.to_bits()
        });
        assert!(others.count() > 5, "noise of 0.1 reaches several quanta");
    }
}
