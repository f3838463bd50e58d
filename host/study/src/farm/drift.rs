//! How a unit has changed from its first calibration to its last.

use serde::Serialize;
use shared::calibration::Calibration;

/// Seconds of a day.
const DAY_S: f64 = 86_400.0;

/// Changes of a unit.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Drift {
    /// Number of calibrations.
    pub calibrations: usize,
    /// Time between the first and the last one, days.
    pub days: f64,
    /// Change of the sensor's zero, cmH2O.
    pub sensor_zero: f32,
    /// Change of the valve's dead time, ms.
    pub dead_time_ms: f32,
    /// Change of the valve's lag, ms.
    pub lag_ms: f32,
    /// Change of the valve's full flow, L/s.
    pub full_flow: f32,
}

impl Drift {
    /// The changes over these calibrations, oldest first; none with fewer than two.
    pub fn of(calibrations: &[Calibration]) -> Option<Self> {
        let [first, .., last] = calibrations else { return None };
        Some(Self {
            calibrations: calibrations.len(),
            days: (f64::from(last.measured_at) - f64::from(first.measured_at)) / DAY_S,
            sensor_zero: last.sensor_zero - first.sensor_zero,
            dead_time_ms: last.dead_time_ms - first.dead_time_ms,
            lag_ms: last.lag_ms - first.lag_ms,
            full_flow: last.valve_flow[3] - first.valve_flow[3],
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn drift_is_the_change_from_the_first_calibration_to_the_last() {
        let calibration = |sensor_zero: f32, day: u32| Calibration {
            sensor_zero,
            sensor_gain: 1.0,
            dead_time_ms: 12.0,
            lag_ms: 25.0,
            valve_flow: [0.2, 0.5, 1.0, 1.6],
            measured_at: day * 86_400,
        };
        assert_eq!(Drift::of(&[calibration(0.5, 3)]), None);
        let drift = Drift::of(&[calibration(0.5, 3), calibration(2.0, 4), calibration(0.75, 10)]).unwrap();
        assert_eq!((drift.calibrations, drift.sensor_zero, drift.dead_time_ms), (3, 0.25, 0.0));
        assert!((drift.days - 7.0).abs() < 1e-9);
    }
}
