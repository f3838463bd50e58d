//! Backup ventilation: the mean command profile of the last good breaths, for a machine without a sound pressure sensor.
//!
//! While pressure control works, the commands of each good inspiration are averaged in time bins. A lung that has not changed
//! answers the same commands with nearly the same pressure. Before the first good breath a constant flow delivers what fills
//! the stiffest adult lung to PIP. The supervisor closes the valve when the lung estimate predicts the pressure limit.

use crate::breath::Breath;
use crate::math;

/// Time bins of an inspiration.
const BINS: usize = 64;
/// Weight of a new breath in the mean profile.
const NEW_BREATH: f32 = 0.3;
/// Compliance that is assumed before the first good breath, L/cmH2O: that of a stiff adult lung.
const STIFFEST: f32 = 0.01;
/// Flow of the valve per command that is assumed before the first good breath, (L/s)/%: its mean slope at small commands.
const FLOW_PER_COMMAND: f32 = 0.009;

/// The mean commands of the last good breaths, and those of the running one.
#[derive(Clone, Debug, PartialEq)]
pub struct Backup {
    /// Mean commands of the last good breaths, percent; none before the first.
    profile: Option<[f32; BINS]>,
    /// Rise from PEEP to PIP of those breaths, cmH2O.
    rise: f32,
    /// Sums of the running inspiration's commands.
    sums: [f32; BINS],
    counts: [u16; BINS],
}

impl Backup {
    /// Before the first breath.
    pub const fn new() -> Self {
        Self { profile: None, rise: 0.0, sums: [0.0; BINS], counts: [0; BINS] }
    }

    /// Starts an inspiration.
    pub fn start_breath(&mut self) {
        (self.sums, self.counts) = ([0.0; BINS], [0; BINS]);
    }

    /// Records the command of a tick of an inspiration, percent.
    #[inline]
    pub fn record(&mut self, breath: &Breath, tick: u32, command: f32) {
        let bin = bin(breath, tick);
        self.sums[bin] += command;
        self.counts[bin] = self.counts[bin].saturating_add(1);
    }

    /// Adds the running inspiration, which was a good one, to the mean.
    pub fn accept(&mut self, breath: &Breath) {
        let settings = breath.settings();
        let rise = settings.pip - settings.peep;
        let changed = rise.to_bits() != self.rise.to_bits();
        // Commands for another rise are no part of this mean.
        let weight = if self.profile.is_none() || changed { 1.0 } else { NEW_BREATH };
        let profile = self.profile.get_or_insert([0.0; BINS]);
        for ((mean, sum), count) in profile.iter_mut().zip(&self.sums).zip(&self.counts) {
            if *count > 0 {
                *mean += weight * (sum / f32::from(*count) - *mean);
            }
        }
        self.rise = rise;
    }

    /// The command of a tick of an inspiration, percent.
    #[inline]
    pub fn command(&self, breath: &Breath, tick: u32) -> f32 {
        let settings = breath.settings();
        let rise = settings.pip - settings.peep;
        match &self.profile {
            Some(profile) => {
                let scale = math::limit(rise / self.rise, 0.0, 1.0);
                scale * profile[bin(breath, tick)]
            }
            None => rise * STIFFEST / settings.inspiratory_time / FLOW_PER_COMMAND,
        }
    }
}

impl Default for Backup {
    fn default() -> Self {
        Self::new()
    }
}

/// The bin of a tick; short inspirations leave bins empty, which nothing reads.
fn bin(breath: &Breath, tick: u32) -> usize {
    let bin = tick as usize * BINS / breath.inspiration_ticks().max(1) as usize;
    bin.min(BINS - 1)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::breath::{DEFAULT_PERIOD_US, paper_settings};
    use crate::settings::Settings;

    fn breath(pip: f32) -> Breath {
        Breath::new(&paper_settings(pip), DEFAULT_PERIOD_US).unwrap()
    }

    /// A good breath with a command per tick.
    fn good(backup: &mut Backup, breath: &Breath, command: impl Fn(u32) -> f32) {
        backup.start_breath();
        for tick in 0..breath.inspiration_ticks() {
            backup.record(breath, tick, command(tick));
        }
        backup.accept(breath);
    }

    #[test]
    fn the_commands_of_good_breaths_return() {
        let (breath, mut backup) = (breath(25.0), Backup::new());
        let command = |tick: u32| if tick < 300 { 80.0 } else { 20.0 };
        for _ in 0..5 {
            good(&mut backup, &breath, command);
        }
        for tick in [0, 150, 290, 320, 600, 999] {
            assert!((backup.command(&breath, tick) - command(tick)).abs() < 1e-3, "tick {tick}");
        }
    }

    #[test]
    fn a_new_breath_has_three_tenths_of_the_mean() {
        let (breath, mut backup) = (breath(25.0), Backup::new());
        good(&mut backup, &breath, |_| 30.0);
        good(&mut backup, &breath, |_| 40.0);
        assert!((backup.command(&breath, 500) - 33.0).abs() < 1e-3);
    }

    #[test]
    fn a_breath_that_was_not_good_is_forgotten() {
        let (breath, mut backup) = (breath(25.0), Backup::new());
        good(&mut backup, &breath, |_| 30.0);
        backup.start_breath();
        for tick in 0..1000 {
            backup.record(&breath, tick, 100.0);
        }
        backup.start_breath();
        assert!((backup.command(&breath, 500) - 30.0).abs() < 1e-4);
    }

    #[test]
    fn before_the_first_good_breath_a_stiff_lung_is_filled_to_pip() {
        // 200 mL within a second: 20 cmH2O in a lung of 10 mL/cmH2O.
        let command = Backup::new().command(&breath(25.0), 0);
        assert!((command * FLOW_PER_COMMAND - 0.2).abs() < 1e-4, "{command} %");
        let short = Settings { inspiratory_time: 0.5, ..paper_settings(25.0) };
        let short = Breath::new(&short, DEFAULT_PERIOD_US).unwrap();
        let command = Backup::new().command(&short, 0);
        assert!((command * FLOW_PER_COMMAND - 0.4).abs() < 1e-4, "{command} % in half a second");
    }

    #[test]
    fn other_settings_never_deliver_more_than_the_profile() {
        let mut backup = Backup::new();
        good(&mut backup, &breath(25.0), |_| 40.0);
        assert!((backup.command(&breath(15.0), 10) - 20.0).abs() < 1e-3);
        assert!((backup.command(&breath(35.0), 10) - 40.0).abs() < 1e-3);
        good(&mut backup, &breath(15.0), |_| 10.0);
        assert!((backup.command(&breath(15.0), 10) - 10.0).abs() < 1e-3, "a mean of one kind of breath");
    }

    #[test]
    fn an_inspiration_of_few_ticks_uses_few_bins_and_leaves_the_others() {
        let of = |inspiratory_time| {
            Breath::new(&Settings { inspiratory_time, ..paper_settings(25.0) }, 20_000).unwrap()
        };
        let (breath, mut backup) = (of(0.4), Backup::new());
        good(&mut backup, &breath, |tick| tick as f32);
        for tick in 0..breath.inspiration_ticks() {
            assert!((backup.command(&breath, tick) - tick as f32).abs() < 1e-4);
        }
        good(&mut backup, &of(0.6), |_| 10.0);
        let means = [0, 1, 2].map(|tick| backup.command(&breath, tick));
        let expected = [3.0, 1.0, 4.4];
        assert!(means.iter().zip(expected).all(|(mean, e)| (mean - e).abs() < 1e-4), "{means:?}");
    }

    #[test]
    fn a_tick_after_the_inspiration_has_the_last_command() {
        let (breath, mut backup) = (breath(25.0), Backup::new());
        good(&mut backup, &breath, |tick| if tick < 985 { 10.0 } else { 50.0 });
        assert!((backup.command(&breath, 5000) - 50.0).abs() < 1e-3);
    }
}
