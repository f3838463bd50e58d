//! The balloon plant: a valve that saturates, and a balloon whose recoil falls as it grows.

use std::f64::consts::PI;

use shared::settings::Settings;

use crate::link::PlantError;
use crate::{Plant, Reading, TickTruth};

/// Control period, microseconds.
pub const PERIOD_US: u32 = 30_000;
/// Number of samples of an inspiration.
pub const SAMPLES: usize = 29;
/// Ticks after the inspiration in which the balloon rests at its initial volume.
const REST_TICKS: usize = 4;
/// Duration of a step, s.
const STEP_S: f64 = PERIOD_US as f64 * 1e-6;
/// Volume at the start of a breath, at which the balloon's pressure is zero.
const FIRST_VOLUME: f64 = 1.5;
/// Scale of the recoil.
const RECOIL: f64 = 40.0;
/// Largest flow through the inspiratory valve.
const FULL_FLOW: f64 = 2.0;

/// A breath on the balloon at one PIP, cmH2O: PEEP 0, no bias flow, no fall, no trigger, and a pressure limit above its highest
/// pressures.
pub fn settings(pip: f32) -> Settings {
    let period_s = shared::breath::period_s(PERIOD_US);
    Settings {
        pip,
        peep: 0.0,
        rate: 60.0 / ((SAMPLES + REST_TICKS) as f32 * period_s),
        inspiratory_time: SAMPLES as f32 * period_s,
        rise_time: 0.0,
        fall_time: 0.0,
        expiratory_bias: 0.0,
        pressure_limit: 70.0,
        trigger_pressure: 0.0,
        trigger_flow: 0.0,
        ..Settings::default()
    }
}

/// A running balloon.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Balloon {
    volume: f64,
}

impl Default for Balloon {
    fn default() -> Self {
        Self { volume: FIRST_VOLUME }
    }
}

impl Balloon {
    /// Volume above that at the start of a breath, in the authors' unit.
    pub fn volume(&self) -> f64 {
        self.volume - FIRST_VOLUME
    }

    /// Pressure, cmH2O.
    pub fn pressure(&self) -> f64 {
        let (radius, first) = (radius(self.volume), radius(FIRST_VOLUME));
        RECOIL * (1.0 - (first / radius).powi(6)) / (first * first * radius)
    }

    /// One control period of an inspiration with the inspiratory valve at `u_in` percent.
    pub fn inspire(&mut self, u_in: f64) {
        self.volume += STEP_S * flow(u_in);
    }

    /// One control period of an inspiration with exactly the flow that brings the pressure to `target` cmH2O, or as
    /// close as a valve that could also close fully gets it. Pressure rises with volume as long as the recoil does.
    pub fn inspire_towards(&mut self, target: f64) {
        let full = Self { volume: self.volume + STEP_S * FULL_FLOW };
        if full.pressure() <= target {
            *self = full;
            return;
        }
        let (mut low, mut high) = (self.volume, full.volume);
        for _ in 0..60 {
            let middle = 0.5 * (low + high);
            if (Self { volume: middle }).pressure() > target { high = middle } else { low = middle }
        }
        self.volume = low;
    }

    fn reading(self) -> Reading {
        let (pressure, lung_volume) = (self.pressure() as f32, self.volume() as f32);
        let truth = TickTruth { airway_pressure: pressure, sensor_pressure: pressure, lung_volume };
        Reading { truth: Some(truth), ..Reading::of_pressure(pressure) }
    }
}

/// The balloon has no expiration: once the expiratory valve opens, it returns to the volume at the start of a breath.
/// It has no PEEP valve and no noise.
impl Plant for Balloon {
    type Error = PlantError;

    fn name(&self) -> String {
        "balloon".to_owned()
    }

    fn reset(&mut self, period_us: u32, _seed: u64, _peep: f32) -> Result<Reading, PlantError> {
        if period_us != PERIOD_US {
            return Err(PlantError::other_period(period_us, PERIOD_US));
        }
        *self = Self::default();
        Ok(self.reading())
    }

    fn set_peep(&mut self, _peep: f32) -> Result<(), PlantError> {
        Ok(())
    }

    fn step(&mut self, u_in: f32, u_out: bool) -> Result<Reading, PlantError> {
        if u_out {
            *self = Self::default();
        } else {
            self.inspire(f64::from(u_in));
        }
        Ok(self.reading())
    }
}

/// Radius of a sphere.
fn radius(volume: f64) -> f64 {
    (3.0 * volume / (4.0 * PI)).cbrt()
}

/// Flow through the inspiratory valve at `u_in` percent.
fn flow(u_in: f64) -> f64 {
    let opening = ((0.03 * (3.0 * u_in - 130.0)).tanh() + 1.0).clamp(0.0, 1.72);
    (15.0 * opening).clamp(0.0, FULL_FLOW)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_breath_starts_at_no_pressure() {
        assert!(Balloon::default().pressure().abs() < 1e-12);
    }

    #[test]
    fn full_flow_raises_the_pressure_as_published() {
        let mut balloon = Balloon::default();
        for expected in [8.3177, 15.5318, 21.8139, 27.3042] {
            balloon.inspire(100.0);
            assert!((balloon.pressure() - expected).abs() < 1e-4, "{balloon:?}");
        }
    }

    #[test]
    fn the_valve_never_shuts_and_is_open_from_29_percent_on() {
        assert!((flow(0.0) - 0.012_287).abs() < 1e-6);
        assert!(flow(28.0) < FULL_FLOW);
        assert!((flow(29.0) - FULL_FLOW).abs() < 1e-12 && (flow(100.0) - FULL_FLOW).abs() < 1e-12);
    }

    #[test]
    fn an_open_expiratory_valve_ends_the_breath() {
        let mut balloon = Balloon::default();
        assert!(balloon.step(100.0, false).unwrap().pressure > 8.0);
        assert_eq!(balloon.step(100.0, true).unwrap(), Balloon::default().reading());
        assert!(matches!(balloon.reset(1000, 0, 0.0), Err(PlantError::Period { asked: 1000, .. })));
    }

    #[test]
    fn a_step_towards_a_target_stops_there() {
        let mut balloon = Balloon::default();
        balloon.inspire_towards(12.0);
        assert!((balloon.pressure() - 8.3177).abs() < 1e-4, "as far as full flow gets");
        for _ in 0..3 {
            balloon.inspire_towards(12.0);
            assert!((balloon.pressure() - 12.0).abs() < 1e-6);
        }
    }
}
