//! The band of a farm: how far a unit may deviate from the rest before it is named.

use serde::{Deserialize, Serialize};
use shared::calibration::Calibration;

use super::UnitName;

/// Distances from the range of all other units beyond which a unit is outside the farm's band.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Band {
    /// Dead time of the valve, ms.
    pub dead_time_ms: f32,
    /// Lag of the valve, ms.
    pub lag_ms: f32,
    /// Zero of the sensor, cmH2O.
    pub sensor_zero_cmh2o: f32,
}

impl Default for Band {
    /// Wide enough for fits of units of one type on lungs that differ.
    fn default() -> Self {
        Self { dead_time_ms: 4.0, lag_ms: 12.0, sensor_zero_cmh2o: 0.8 }
    }
}

/// A number of a unit that is outside the band.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Outside {
    /// The unit.
    pub unit: UnitName,
    /// What deviates, with the unit's value and the range of the other units.
    pub message: String,
}

impl Band {
    /// The numbers outside the band, unit by unit. Two units or fewer have no band: it is not clear which one deviates.
    pub fn outside(&self, units: &[(UnitName, Calibration)]) -> Vec<Outside> {
        let mut found = Vec::new();
        if units.len() < 3 {
            return found;
        }
        for (number, (unit, _)) in units.iter().enumerate() {
            for (name, of, tolerance, measure) in self.numbers() {
                let value = of(&units[number].1);
                let rest =
                    units.iter().enumerate().filter(|(n, _)| *n != number).map(|(_, (_, unit))| of(unit));
                let (low, high) =
                    rest.fold((f32::INFINITY, f32::NEG_INFINITY), |(low, high), x| (low.min(x), high.max(x)));
                // A NaN is outside.
                if !(value >= low - tolerance && value <= high + tolerance) {
                    let message =
                        format!("{name} {value:.1} {measure}, other units {low:.1} to {high:.1} {measure}");
                    found.push(Outside { unit: unit.clone(), message });
                }
            }
        }
        found
    }

    fn numbers(&self) -> [Number; 3] {
        [
            ("dead time", |unit| unit.dead_time_ms, self.dead_time_ms, "ms"),
            ("lag of the valve", |unit| unit.lag_ms, self.lag_ms, "ms"),
            ("sensor zero", |unit| unit.sensor_zero, self.sensor_zero_cmh2o, "cmH2O"),
        ]
    }
}

/// A number of a calibration: its name, how to read it, its tolerance and its unit.
type Number = (&'static str, fn(&Calibration) -> f32, f32, &'static str);

#[cfg(test)]
mod tests {
    use super::*;

    fn units(dead_times: &[f32]) -> Vec<(UnitName, Calibration)> {
        let unit = |(number, dead_time_ms): (usize, &f32)| {
            let calibration = Calibration {
                sensor_zero: 0.0,
                sensor_gain: 1.0,
                dead_time_ms: *dead_time_ms,
                lag_ms: 25.0,
                valve_flow: [0.2, 0.5, 1.0, 1.6],
                measured_at: 0,
            };
            (UnitName::numbered(number as u32 + 1), calibration)
        };
        dead_times.iter().enumerate().map(unit).collect()
    }

    #[test]
    fn a_unit_outside_the_band_is_named_with_what_is_wrong() {
        let found = Band::default().outside(&units(&[12.0, 11.0, 13.0, 19.0]));
        let [outside] = &found[..] else { panic!("{found:?}") };
        assert_eq!(outside.unit.as_str(), "4");
        assert_eq!(outside.message, "dead time 19.0 ms, other units 11.0 to 13.0 ms");
    }

    #[test]
    fn units_of_one_type_are_within_the_band_and_two_units_have_none() {
        assert_eq!(Band::default().outside(&units(&[12.0, 11.0, 13.0, 14.5])), []);
        assert_eq!(Band::default().outside(&units(&[12.0, 19.0])), []);
    }

    #[test]
    fn a_number_that_is_none_is_outside() {
        assert_eq!(Band::default().outside(&units(&[12.0, 11.0, f32::NAN])).len(), 1);
    }
}
