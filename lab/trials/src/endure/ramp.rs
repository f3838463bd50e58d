//! What changes slowly: in a few steps, since a fault of the bench begins at once.

use plant::bench::{FaultConfig, Faulty};

/// Steps of a slow change.
const STEPS: u32 = 8;

/// A slow change.
#[derive(Clone, Copy, Debug)]
pub(super) struct Ramp {
    /// Beginning, s.
    pub(super) from_s: f64,
    /// Time from the beginning to the end, s.
    pub(super) lasts_s: f64,
}

impl Ramp {
    /// Time of each step, s, and the share of the change with it, 1 for the last.
    pub(super) fn steps(self) -> impl Iterator<Item = (f64, f64)> {
        (1..=STEPS).map(move |step| {
            let share = f64::from(step) / f64::from(STEPS);
            (self.from_s + self.lasts_s * share, share)
        })
    }

    /// Faults of which each replaces the one before: of a factor, in equal ratios up to `last`.
    pub(super) fn replaced(self, last: f64, what: impl Fn(f64) -> Faulty) -> Vec<FaultConfig> {
        self.steps().map(|(from_s, share)| lasting(from_s, what(last.powf(share)))).collect()
    }

    /// Faults that act together: each adds an equal part of the factor `last`.
    pub(super) fn together(self, last: f64, what: impl Fn(f64) -> Faulty) -> Vec<FaultConfig> {
        let part = last.powf(1.0 / f64::from(STEPS));
        self.steps().map(|(from_s, _)| lasting(from_s, what(part))).collect()
    }
}

/// A fault that stays.
pub(super) fn lasting(from_s: f64, what: Faulty) -> FaultConfig {
    FaultConfig { from_s, to_s: None, repeats: None, what }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_ramp_ends_with_its_full_size() {
        let ramp = Ramp { from_s: 100.0, lasts_s: 80.0 };
        let size = |fault: &FaultConfig| match fault.what {
            Faulty::Lung { resistance, .. } => resistance,
            _ => f64::NAN,
        };
        let narrow = |resistance: f64| Faulty::Lung { resistance, compliance: 1.0 };
        let replaced = ramp.replaced(16.0, narrow);
        assert!((replaced[7].from_s - 180.0).abs() < 1e-9 && (size(&replaced[7]) - 16.0).abs() < 1e-9);
        assert!((size(&replaced[3]) - 4.0).abs() < 1e-9, "half of the way");
        let together: f64 = ramp.together(16.0, narrow).iter().map(size).product();
        assert!((together - 16.0).abs() < 1e-9);
    }
}
