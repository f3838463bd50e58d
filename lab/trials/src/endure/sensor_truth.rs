//! What the bench knows of a pressure sensor in a breath.

use shared::safety::reading_monitor::SENSOR_RANGE;

/// Movement of the true pressure during identical readings that makes them frozen, cmH2O.
const MOVED: f64 = 1.0;

/// Truth about one sensor in a breath: its errors against the pressure where it sits.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct SensorTruth {
    /// Readings that were no number.
    pub missing: u32,
    /// Largest error, cmH2O.
    pub worst: f64,
    /// Whether a reading was outside the range of a pressure sensor.
    pub beyond: bool,
    /// Longest run of the same reading while the pressure moved, ms.
    pub frozen_ms: u32,
    count: u32,
    sum: f64,
    squares: f64,
    last: f32,
    same: u32,
    /// Pressure range since the reading changed last.
    range: (f64, f64),
}

impl SensorTruth {
    /// Adds a reading, and the pressure where the sensor sits, cmH2O.
    pub(super) fn add(&mut self, reading: f32, pressure: f64) {
        if reading.is_nan() {
            self.missing += 1;
            return;
        }
        if self.count > 0 && reading.to_bits() == self.last.to_bits() {
            self.same += 1;
            self.range = (self.range.0.min(pressure), self.range.1.max(pressure));
            if self.range.1 - self.range.0 > MOVED {
                self.frozen_ms = self.frozen_ms.max(self.same);
            }
        } else {
            (self.last, self.same, self.range) = (reading, 0, (pressure, pressure));
        }
        self.beyond |= !(SENSOR_RANGE.0..=SENSOR_RANGE.1).contains(&reading);
        let error = f64::from(reading) - pressure;
        self.worst = self.worst.max(error.abs());
        self.count += 1;
        self.sum += error;
        self.squares += error * error;
    }

    /// Mean error, cmH2O.
    pub fn offset(&self) -> f64 {
        self.sum / f64::from(self.count.max(1))
    }

    /// Standard deviation of the error, cmH2O.
    pub fn noise(&self) -> f64 {
        let mean = self.offset();
        (self.squares / f64::from(self.count.max(1)) - mean * mean).max(0.0).sqrt()
    }
}
