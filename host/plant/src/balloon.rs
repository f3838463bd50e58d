//! The plant: a valve that saturates and a balloon whose recoil falls off as it grows.

use std::f64::consts::PI;

use shared::settings::Settings;

/// Control period, microseconds.
pub const PERIOD_US: u32 = 30_000;
/// Samples of an inspiration.
pub const SAMPLES: usize = 29;
/// Ticks after the inspiration in which the balloon rests at its first volume.
const REST_TICKS: usize = 4;
/// Duration of a step, s.
const STEP_S: f64 = PERIOD_US as f64 * 1e-6;
/// Volume at the start of a breath; the balloon's pressure there is zero.
const FIRST_VOLUME: f64 = 1.5;
/// Scale of the recoil.
const RECOIL: f64 = 40.0;
/// The balloon leaks through the open expiratory valve above this pressure, cmH2O.
const PEEP_VALVE: f64 = 5.0;
/// Flow through the open expiratory valve per pressure.
const LEAK: f64 = 0.05;
/// Largest flow through the inspiratory valve.
const FULL_FLOW: f64 = 2.0;

/// A breath on the balloon at one PIP, cmH2O: PEEP 0, no bias, no fall, and a limit that its highest pressures stay
/// below.
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
    /// Volume above the one at which a breath starts, in the authors' unit.
    pub fn volume(&self) -> f64 {
        self.volume - FIRST_VOLUME
    }

    /// Pressure, cmH2O.
    pub fn pressure(&self) -> f64 {
        let (radius, first) = (radius(self.volume), radius(FIRST_VOLUME));
        RECOIL * (1.0 - (first / radius).powi(6)) / (first * first * radius)
    }

    /// One control period with the inspiratory valve at `u_in` percent, the expiratory valve open if `u_out`.
    pub fn step(&mut self, u_in: f64, u_out: bool) {
        let pressure = self.pressure();
        let leak = if u_out && pressure > PEEP_VALVE { LEAK * pressure } else { 0.0 };
        self.volume += STEP_S * (flow(u_in) - leak);
    }

    /// One control period with just the flow that brings the pressure to `target` cmH2O, or as close to it as the valve
    /// can if it could also shut tightly. Pressure rises with volume as long as the recoil does.
    pub fn step_towards(&mut self, target: f64) {
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
            balloon.step(100.0, false);
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
    fn gas_leaves_through_the_expiratory_valve_above_its_pressure_only() {
        let after = |volume: f64, u_out| {
            let mut balloon = Balloon { volume };
            balloon.step(0.0, u_out);
            balloon.volume - volume
        };
        let high = Balloon { volume: 1.7 };
        let lost = after(1.7, false) - after(1.7, true);
        assert!((lost - STEP_S * LEAK * high.pressure()).abs() < 1e-12, "{lost}");
        assert!((after(1.52, false) - after(1.52, true)).abs() < 1e-12, "below the valve's pressure");
    }

    #[test]
    fn a_step_towards_a_target_stops_there() {
        let mut balloon = Balloon::default();
        balloon.step_towards(12.0);
        assert!((balloon.pressure() - 8.3177).abs() < 1e-4, "as far as full flow gets");
        for _ in 0..3 {
            balloon.step_towards(12.0);
            assert!((balloon.pressure() - 12.0).abs() < 1e-6);
        }
    }
}
