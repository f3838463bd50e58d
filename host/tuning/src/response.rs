//! Response of a loop at one frequency.

use num_complex::Complex64;
use serde::{Deserialize, Serialize};

/// Response at one frequency.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct ResponsePoint {
    /// Frequency, Hz.
    pub hz: f64,
    /// Loop gain L.
    #[serde(rename = "loop")]
    pub loop_gain: Complex64,
    /// From an addition to the command to the measured pressure in closed loop, P S, cmH2O per percent.
    pub path: Complex64,
}

impl ResponsePoint {
    /// Sensitivity S = 1 / (1 + L).
    pub fn sensitivity(&self) -> Complex64 {
        Complex64::ONE / (Complex64::ONE + self.loop_gain)
    }

    /// Response P of the plant to the command, cmH2O per percent.
    pub fn plant(&self) -> Complex64 {
        self.path / self.sensitivity()
    }
}
