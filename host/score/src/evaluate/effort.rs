//! Valve effort: how much a controller moves the inspiratory valve while the pressure should be constant.

use serde::{Deserialize, Serialize};

/// Movement of the command over the plateau, the last 0.3 s of the inspiration. Noise of the sensor causes it, through the
/// controller's gains; it wears the valve, and a limit cycle shows in it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct ValveEffort {
    /// Sum of the command's changes, percent per second.
    pub total_variation: f64,
    /// Standard deviation of the command, percent.
    pub deviation: f64,
}

impl ValveEffort {
    /// The effort of these commands, percent, which are `period_s` seconds apart.
    pub fn of(commands: &[f64], period_s: f64) -> Self {
        let Some(intervals) = commands.len().checked_sub(1).filter(|intervals| *intervals > 0) else {
            return Self::default();
        };
        let changes: f64 = commands.windows(2).map(|pair| (pair[1] - pair[0]).abs()).sum();
        let count = commands.len() as f64;
        let mean = commands.iter().sum::<f64>() / count;
        let variance = commands.iter().map(|command| (command - mean).powi(2)).sum::<f64>() / count;
        Self { total_variation: changes / (intervals as f64 * period_s), deviation: variance.sqrt() }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_command_that_alternates_varies_by_its_height_at_each_step() {
        let commands: Vec<f64> = (0..301).map(|tick| 20.0 + 2.0 * f64::from(tick % 2)).collect();
        let effort = ValveEffort::of(&commands, 1e-3);
        assert!((effort.total_variation - 2000.0).abs() < 1e-6, "{effort:?}");
        assert!((effort.deviation - 1.0).abs() < 1e-4, "{effort:?}");
    }

    #[test]
    fn a_constant_command_and_a_single_one_are_no_effort() {
        assert_eq!(ValveEffort::of(&[20.0; 300], 1e-3), ValveEffort::default());
        assert_eq!(ValveEffort::of(&[20.0], 1e-3), ValveEffort::default());
        assert_eq!(ValveEffort::of(&[], 1e-3), ValveEffort::default());
    }

    #[test]
    fn the_variation_of_a_ramp_is_its_slope_at_any_period() {
        for period_s in [1e-3, 1e-2] {
            let commands: Vec<f64> = (0..30).map(|tick| 50.0 * f64::from(tick) * period_s).collect();
            assert!((ValveEffort::of(&commands, period_s).total_variation - 50.0).abs() < 1e-9);
        }
    }
}
