//! Which breaths have the same setting, where settings are measured pressures.
//!
//! A recording without set-points has its PIP and PEEP from the plateau and the end of the expiration before, and no two
//! measured values are equal. Levels within [`SAME`] of each other count as one setting, named by their mean.

/// Widest range of measured levels that count as one setting, cmH2O: about the noise and drift of a plateau.
const SAME: f64 = 1.0;

/// The settings of a recording: each measured level belongs to one.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Settled {
    /// Highest level and mean of each setting, in rising order; empty if levels are set-points, which stand for
    /// themselves.
    groups: Vec<(f64, f64)>,
}

impl Settled {
    /// Levels that are set-points: each is its own setting.
    pub(super) fn exact() -> Self {
        Self { groups: Vec::new() }
    }

    /// Measured levels of all breaths.
    pub(super) fn measured(levels: impl Iterator<Item = f64>) -> Self {
        let mut levels: Vec<f64> = levels.collect();
        levels.sort_by(f64::total_cmp);
        let mut groups = Vec::new();
        let mut rest = &levels[..];
        while let Some(lowest) = rest.first() {
            let (group, next) = rest.split_at(rest.partition_point(|level| level - lowest <= SAME));
            let mean = group.iter().sum::<f64>() / group.len() as f64;
            groups.push((group[group.len() - 1], (10.0 * mean).round() / 10.0));
            rest = next;
        }
        Self { groups }
    }

    /// The setting of a level.
    pub(super) fn setting(&self, level: f64) -> f64 {
        self.groups.iter().find(|(highest, _)| level <= *highest).map_or(level, |(_, mean)| *mean)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn noise_around_a_setting_is_one_setting_and_a_step_is_another() {
        let levels = [5.1, 4.9, 5.3, 10.2, 5.0, 10.0];
        let settled = Settled::measured(levels.into_iter());
        let settings = levels.map(|level| format!("{:.1}", settled.setting(level)));
        assert_eq!(settings, ["5.1", "5.1", "5.1", "10.1", "5.1", "10.1"]);
    }

    #[test]
    fn a_set_point_stands_for_itself() {
        assert_eq!(Settled::exact().setting(17.3).to_bits(), 17.3_f64.to_bits());
    }
}
