//! Spread between units of a machine type, and the drift of a unit.

use super::config::UnitConfig;
use crate::random::{normal, stream};

/// `ChaCha` stream of the units; noise uses stream 0, so that unit 7 and noise seed 7 are independent.
const UNIT_STREAM: u64 = 1;
/// Smallest share of the nominal flow that a unit can have.
const LEAST_GAIN: f64 = 0.2;

/// Deviations of a unit from the nominal one.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Unit {
    /// Factor on the flow of the inspiratory valve.
    pub(super) flow_gain: f64,
    /// Offset of the sensor at the start, cmH2O.
    pub(super) sensor_offset: f64,
    /// Deviation of the valve's dead time, ms; the user limits a negative dead time to zero.
    pub(super) dead_time_ms: f64,
    drift_per_step: f64,
}

impl Unit {
    /// Draws the unit given by `config`; unit 0 is the nominal one.
    pub(super) fn draw(config: &UnitConfig, step_s: f64) -> Self {
        let mut rng = stream(u64::from(config.number), UNIT_STREAM);
        // All three are always drawn, in this order, so that changing one spread does not affect the others' draws.
        let mut deviation = |sd: f64| {
            let drawn = normal(&mut rng);
            if config.number == 0 { 0.0 } else { sd * drawn }
        };
        Self {
            flow_gain: (1.0 + deviation(config.flow_gain_sd_percent / 100.0)).max(LEAST_GAIN),
            sensor_offset: deviation(config.sensor_offset_sd_cmh2o),
            dead_time_ms: deviation(config.dead_time_sd_ms),
            drift_per_step: config.sensor_drift_cmh2o_per_hour * step_s / 3600.0,
        }
    }

    /// Offset of the sensor after `steps`, cmH2O.
    pub(super) fn offset_after(&self, steps: u64) -> f64 {
        self.sensor_offset + self.drift_per_step * steps as f64
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn draw(number: u32) -> Unit {
        Unit::draw(&UnitConfig { number, ..UnitConfig::default() }, 1e-3)
    }

    #[test]
    fn unit_zero_is_nominal() {
        let nominal = Unit { flow_gain: 1.0, sensor_offset: 0.0, dead_time_ms: 0.0, drift_per_step: 0.0 };
        assert_eq!(draw(0), nominal);
    }

    #[test]
    fn the_same_number_is_the_same_unit() {
        assert_eq!(draw(17), draw(17));
        assert_ne!(draw(17), draw(18));
    }

    #[test]
    fn unit_and_noise_of_the_same_seed_have_nothing_in_common() {
        let first_noise = normal(&mut stream(17, 0));
        let first_draw = (draw(17).flow_gain - 1.0) / 0.05;
        assert!((first_noise - first_draw).abs() > 1e-6);
    }

    #[test]
    fn units_spread_with_the_stated_sds() {
        let count = 10_000_u32;
        let units: Vec<Unit> = (1..=count).map(draw).collect();
        let check = |what: &str, value: fn(&Unit) -> f64, mean: f64, sd: f64| {
            let n = f64::from(count);
            let found_mean = units.iter().map(value).sum::<f64>() / n;
            let found_sd = (units.iter().map(|u| (value(u) - found_mean).powi(2)).sum::<f64>() / n).sqrt();
            // Five standard errors: 5 % of an sd for the mean, 3.5 % for the sd.
            assert!((found_mean - mean).abs() < 0.05 * sd, "{what}: mean {found_mean}");
            assert!((found_sd / sd - 1.0).abs() < 0.035, "{what}: sd {found_sd}");
        };
        check("gain", |u| u.flow_gain, 1.0, 0.05);
        check("offset", |u| u.sensor_offset, 0.0, 0.3);
        check("dead time", |u| u.dead_time_ms, 0.0, 1.0);
    }

    #[test]
    fn offset_drifts_by_the_hour() {
        let config = UnitConfig { sensor_drift_cmh2o_per_hour: 0.5, ..UnitConfig::default() };
        let unit = Unit::draw(&config, 1e-3);
        assert!((unit.offset_after(7_200_000) - 1.0).abs() < 1e-9);
    }
}
