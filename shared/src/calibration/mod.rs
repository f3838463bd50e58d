//! The calibration of a unit: how its airway sensor, its inspiratory valve and its delays differ from the nominal machine.
//!
//! [`Calibration`] holds values as measured or received; a [`SensorCorrection`] is the part that the control loop sees, built
//! from a validated one. The bounds are narrow, so that a wrong calibration can do little harm: within the hard pressure limit
//! it shifts a reading by a few cmH2O.
//!
//! | module | contains |
//! |---|---|
//! | [`stored`] | the calibrations of a device, in its flash |

pub mod stored;

use serde::{Deserialize, Serialize};
use thiserror::Error;

use crate::safety::reading_monitor::SENSOR_RANGE;

/// Number of points of the valve's curve.
pub const VALVE_POINTS: usize = 4;
/// Words of a calibration in flash.
const WORDS: usize = 5 + VALVE_POINTS;
/// Length of a calibration in flash, bytes.
pub const CALIBRATION_BYTES: usize = 4 * WORDS;

/// Measured values of a unit, not yet validated.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Calibration {
    /// Reading of the airway sensor at zero pressure, without any correction, cmH2O.
    pub sensor_zero: f32,
    /// Change of that reading per change of the pressure.
    pub sensor_gain: f32,
    /// Dead time from a command of the inspiratory valve to the pressure, ms.
    pub dead_time_ms: f32,
    /// Time constant of the lag that follows the dead time, ms.
    pub lag_ms: f32,
    /// Flow of the inspiratory valve at 25, 50, 75 and 100 % of its command, L/s.
    pub valve_flow: [f32; VALVE_POINTS],
    /// Time of the measurement, seconds since 1970 (UTC).
    pub measured_at: u32,
}

/// A bounded quantity of a [`Calibration`]. The order of the variants is part of the link's protocol: append only.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Quantity {
    /// [`Calibration::sensor_zero`].
    SensorZero,
    /// [`Calibration::sensor_gain`].
    SensorGain,
    /// [`Calibration::dead_time_ms`].
    DeadTime,
    /// [`Calibration::lag_ms`].
    Lag,
    /// [`Calibration::valve_flow`].
    ValveFlow,
}

impl Quantity {
    /// Name and unit, as printed.
    pub const fn name(self) -> &'static str {
        match self {
            Self::SensorZero => "zero of the sensor (cmH2O)",
            Self::SensorGain => "gain of the sensor",
            Self::DeadTime => "dead time (ms)",
            Self::Lag => "lag (ms)",
            Self::ValveFlow => "flow of the valve (L/s)",
        }
    }

    /// Lowest and highest accepted value.
    pub const fn bounds(self) -> (f32, f32) {
        match self {
            // As far as the zero check of the self-test accepts.
            Self::SensorZero => (-2.0, 2.0),
            Self::SensorGain => (0.9, 1.1),
            Self::DeadTime => (0.0, 100.0),
            Self::Lag => (0.0, 200.0),
            Self::ValveFlow => (0.0, 5.0),
        }
    }

    fn check(self, value: f32) -> Result<(), CalibrationError> {
        let (min, max) = self.bounds();
        // In this form a NaN fails too.
        if value >= min && value <= max {
            Ok(())
        } else {
            Err(CalibrationError::OutOfBounds { quantity: self, value })
        }
    }
}

/// Why a calibration is refused. The order of the variants is part of the link's protocol: append only.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Error)]
pub enum CalibrationError {
    /// A value is out of bounds.
    #[error(
        "{} = {value} is outside {} to {}; repair the unit, or repeat the measurement",
        .quantity.name(), .quantity.bounds().0, .quantity.bounds().1
    )]
    OutOfBounds {
        /// The quantity.
        quantity: Quantity,
        /// Its value.
        value: f32,
    },
    /// The valve passes less flow at a higher command.
    #[error(
        "the flow of the valve falls from {from} to {to} L/s as its command rises; repeat the measurement"
    )]
    FlowFalls {
        /// Flow at the lower command, L/s.
        from: f32,
        /// Flow at the higher command, L/s.
        to: f32,
    },
}

impl Calibration {
    /// Checks all values.
    ///
    /// # Errors
    /// [`CalibrationError`] with the first value that is out of bounds or not a number.
    pub fn validate(&self) -> Result<(), CalibrationError> {
        Quantity::SensorZero.check(self.sensor_zero)?;
        Quantity::SensorGain.check(self.sensor_gain)?;
        Quantity::DeadTime.check(self.dead_time_ms)?;
        Quantity::Lag.check(self.lag_ms)?;
        for flow in self.valve_flow {
            Quantity::ValveFlow.check(flow)?;
        }
        match self.valve_flow.windows(2).find(|pair| pair[1] < pair[0]) {
            Some(pair) => Err(CalibrationError::FlowFalls { from: pair[0], to: pair[1] }),
            None => Ok(()),
        }
    }

    /// The calibration as it is in flash: each value in four bytes, little endian, in the order of the fields.
    pub fn to_bytes(&self) -> [u8; CALIBRATION_BYTES] {
        let Self { sensor_zero, sensor_gain, dead_time_ms, lag_ms, valve_flow: [a, b, c, d], measured_at } =
            *self;
        let values = [sensor_zero, sensor_gain, dead_time_ms, lag_ms, a, b, c, d];
        let words = values.into_iter().map(f32::to_bits).chain([measured_at]);
        let mut bytes = [0; CALIBRATION_BYTES];
        for (place, word) in bytes.chunks_exact_mut(4).zip(words) {
            place.copy_from_slice(&word.to_le_bytes());
        }
        bytes
    }

    /// The inverse of [`Self::to_bytes`]; not validated.
    pub fn from_bytes(bytes: &[u8; CALIBRATION_BYTES]) -> Self {
        let (words, _) = bytes.as_chunks();
        let word = |index: usize| words.get(index).map_or(0, |word| u32::from_le_bytes(*word));
        let value = |index| f32::from_bits(word(index));
        Self {
            sensor_zero: value(0),
            sensor_gain: value(1),
            dead_time_ms: value(2),
            lag_ms: value(3),
            valve_flow: core::array::from_fn(|point| value(4 + point)),
            measured_at: word(WORDS - 1),
        }
    }
}

/// Correction of the airway sensor's reading.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SensorCorrection {
    zero: f32,
    gain: f32,
}

impl SensorCorrection {
    /// The correction of a calibration.
    ///
    /// # Errors
    /// [`CalibrationError`] if any value of the calibration is refused.
    pub fn new(calibration: &Calibration) -> Result<Self, CalibrationError> {
        calibration.validate()?;
        Ok(Self { zero: calibration.sensor_zero, gain: calibration.sensor_gain })
    }

    /// The pressure at a reading, both cmH2O. A reading that no working sensor gives is returned as it is: a correction must not
    /// hide it from [`crate::safety::reading_monitor`].
    #[inline]
    pub fn corrected(&self, reading: f32) -> f32 {
        debug_assert!(self.gain > 0.0, "validated");
        debug_assert!(self.zero.is_finite(), "validated");
        let (lowest, highest) = SENSOR_RANGE;
        if reading >= lowest && reading <= highest { (reading - self.zero) / self.gain } else { reading }
    }

    /// The inverse of [`Self::corrected`]: the reading at a pressure, both cmH2O. A host that measures a calibrated device gets
    /// corrected readings in its telemetry, and a [`Calibration`] refers to the sensor's own.
    pub fn reading(&self, pressure: f32) -> f32 {
        pressure * self.gain + self.zero
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use proptest::prelude::*;
    use std::string::ToString;

    /// A calibration of a plausible unit.
    pub const SOUND: Calibration = Calibration {
        sensor_zero: 0.5,
        sensor_gain: 1.05,
        dead_time_ms: 12.0,
        lag_ms: 25.0,
        valve_flow: [0.25, 0.75, 1.25, 1.75],
        measured_at: 1_800_000_000,
    };

    /// A calibration with this value of a quantity.
    type With = fn(f32) -> Calibration;

    #[test]
    fn values_at_their_bounds_are_accepted_and_those_beyond_refused() {
        let with: [(Quantity, With); 5] = [
            (Quantity::SensorZero, |value| Calibration { sensor_zero: value, ..SOUND }),
            (Quantity::SensorGain, |value| Calibration { sensor_gain: value, ..SOUND }),
            (Quantity::DeadTime, |value| Calibration { dead_time_ms: value, ..SOUND }),
            (Quantity::Lag, |value| Calibration { lag_ms: value, ..SOUND }),
            (Quantity::ValveFlow, |value| Calibration { valve_flow: [value; 4], ..SOUND }),
        ];
        for (quantity, with) in with {
            let (min, max) = quantity.bounds();
            assert_eq!(with(min).validate().and(with(max).validate()), Ok(()), "{quantity:?}");
            for value in [min.next_down(), max.next_up(), f32::INFINITY, f32::NEG_INFINITY] {
                let refused = Err(CalibrationError::OutOfBounds { quantity, value });
                assert_eq!(with(value).validate(), refused);
                assert_eq!(SensorCorrection::new(&with(value)).map(|_| ()), refused);
            }
            assert!(with(f32::NAN).validate().is_err(), "{quantity:?}");
        }
    }

    #[test]
    fn a_valve_whose_flow_falls_is_refused_at_any_point_of_its_curve() {
        assert_eq!(Calibration { valve_flow: [1.0; 4], ..SOUND }.validate(), Ok(()), "a flat curve");
        for valve_flow in [[1.0, 0.5, 2.0, 3.0], [0.5, 1.0, 0.5, 3.0], [0.2, 0.3, 1.0, 0.5]] {
            let refused = Calibration { valve_flow, ..SOUND }.validate();
            assert_eq!(refused, Err(CalibrationError::FlowFalls { from: 1.0, to: 0.5 }), "{valve_flow:?}");
        }
        let one_nan = Calibration { valve_flow: [0.2, f32::NAN, 1.0, 1.5], ..SOUND };
        assert!(one_nan.validate().is_err());
    }

    #[test]
    fn an_error_names_quantity_value_bounds_and_remedy() {
        let error = Calibration { sensor_gain: 1.25, ..SOUND }.validate().unwrap_err().to_string();
        assert_eq!(
            error,
            "gain of the sensor = 1.25 is outside 0.9 to 1.1; repair the unit, or repeat the measurement"
        );
    }

    #[test]
    fn no_correction_hides_a_reading_that_no_working_sensor_gives() {
        let shrinks = Calibration { sensor_zero: 2.0, sensor_gain: 1.1, ..SOUND };
        let correction = SensorCorrection::new(&shrinks).unwrap();
        assert!(correction.corrected(f32::NAN).is_nan());
        for reading in [SENSOR_RANGE.1 + 0.1, SENSOR_RANGE.0 - 0.1, f32::INFINITY, f32::NEG_INFINITY] {
            assert_eq!(correction.corrected(reading).to_bits(), reading.to_bits());
        }
        assert!(correction.corrected(SENSOR_RANGE.1) < SENSOR_RANGE.1);
    }

    proptest! {
        #[test]
        fn a_corrected_reading_is_the_pressure(pressure in -20.0f32..80.0, zero in -2.0f32..=2.0, gain in 0.9f32..=1.1) {
            let calibration = Calibration { sensor_zero: zero, sensor_gain: gain, ..SOUND };
            let correction = SensorCorrection::new(&calibration).unwrap();
            let reading = pressure * gain + zero;
            prop_assert!((correction.corrected(reading) - pressure).abs() < 1e-4);
            prop_assert_eq!(correction.reading(pressure).to_bits(), reading.to_bits());
        }

        #[test]
        fn a_calibration_survives_its_bytes(words: [u32; WORDS]) {
            let mut bytes = [0; CALIBRATION_BYTES];
            for (place, word) in bytes.chunks_exact_mut(4).zip(words) {
                place.copy_from_slice(&word.to_le_bytes());
            }
            prop_assert_eq!(Calibration::from_bytes(&bytes).to_bytes(), bytes);
        }
    }
}
