//! Efforts of a breathing patient as a disturbance of training: how they pull on the airway pressure.
//!
//! The learned simulators know passive lungs only. While the inspiratory valve delivers a flow, the muscle pressure of an
//! effort lowers the airway pressure by nearly its own amount, delayed by the time constant of the airway resistance and
//! the circuit's compliance. So each breath gets a half sine behind a lag, which no command can change, and its
//! gradient with respect to everything learned is that of the pressure it is subtracted from.

use std::f32::consts::PI;

use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};

use engine::{LANES, Lane};

/// Ranges from which the efforts of training are drawn, each uniformly.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct EffortConfig {
    /// Share of the breaths that an effort triggers.
    pub triggered: f32,
    /// Share of the breaths with an effort at any time; the rest has none.
    pub at_any_time: f32,
    /// Peak muscle pressure, cmH2O.
    pub peak: (f32, f32),
    /// Duration of an effort, s.
    pub duration: (f32, f32),
    /// Time from the beginning of an effort to the breath that it triggers, s.
    pub trigger_delay: (f32, f32),
    /// Time constant between muscle and airway pressure, s: 20 cmH2O/(L/s) with 1.5 mL/cmH2O have 0.03 s.
    pub lag: (f32, f32),
}

impl Default for EffortConfig {
    fn default() -> Self {
        Self {
            triggered: 0.3,
            at_any_time: 0.1,
            peak: (0.0, 12.0),
            duration: (0.5, 1.2),
            trigger_delay: (0.02, 0.1),
            lag: (0.005, 0.08),
        }
    }
}

/// An effort during one inspiration.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Effort {
    /// Peak muscle pressure, cmH2O.
    peak: f32,
    /// Duration, s.
    duration: f32,
    /// Beginning, s after that of the inspiration.
    begins: f32,
    /// Time constant between muscle and airway pressure, s.
    lag: f32,
}

impl Effort {
    /// Muscle pressure at a time after the start of the inspiration, cmH2O.
    fn muscle_pressure(&self, time: f32) -> f32 {
        let since = time - self.begins;
        if (0.0..self.duration).contains(&since) {
            self.peak * (PI * since / self.duration).sin()
        } else {
            0.0
        }
    }

    /// Fall of the airway pressure at every tick of the inspiration, cmH2O.
    fn pull(&self, ticks: usize, period: f32) -> Vec<f32> {
        let factor = period / (self.lag + period);
        let before = (-self.begins / period).ceil().max(0.0) as usize;
        let mut pull = 0.0;
        let mut at_tick = |tick: usize| {
            pull += factor * (self.muscle_pressure((tick as f32 - before as f32) * period) - pull);
            pull
        };
        (0..before + ticks).map(&mut at_tick).skip(before).collect()
    }
}

impl EffortConfig {
    /// Draws a shard's efforts: the fall of the airway pressure at every tick, cmH2O. `period` is the control period, s.
    pub(super) fn draw(&self, ticks: usize, period: f32, rng: &mut ChaCha8Rng) -> Vec<Lane> {
        let pulls: Vec<Vec<f32>> = (0..LANES)
            .map(|_| {
                let effort = self.effort(ticks as f32 * period, rng);
                effort.map_or_else(|| vec![0.0; ticks], |effort| effort.pull(ticks, period))
            })
            .collect();
        (0..ticks).map(|tick| Lane::from_fn(|l| pulls[l][tick])).collect()
    }

    /// The effort of one inspiration of this length, s, if there is one.
    fn effort(&self, inspiration: f32, rng: &mut ChaCha8Rng) -> Option<Effort> {
        let kind: f32 = rng.random_range(0.0..1.0);
        let mut within = |(low, high): (f32, f32)| low + (high - low) * rng.random_range(0.0..1.0);
        let (peak, duration, lag) = (within(self.peak), within(self.duration), within(self.lag));
        let begins = if kind < self.triggered {
            -within(self.trigger_delay)
        } else if kind < self.triggered + self.at_any_time {
            within((-duration, inspiration))
        } else {
            return None;
        };
        Some(Effort { peak, duration, begins, lag })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand_chacha::rand_core::SeedableRng;

    fn drawn(config: &EffortConfig) -> Vec<Lane> {
        config.draw(1000, 1e-3, &mut ChaCha8Rng::seed_from_u64(3))
    }

    #[test]
    fn an_effort_that_triggers_a_breath_has_begun_before_it() {
        let effort = Effort { peak: 10.0, duration: 0.8, begins: -0.05, lag: 1e-6 };
        let pull = effort.pull(1000, 1e-3);
        let half_sine = |time: f32| 10.0 * (PI * time / 0.8).sin();
        assert!((pull[0] - half_sine(0.05)).abs() < 1e-3 && (pull[350] - 10.0).abs() < 1e-3, "{}", pull[0]);
        assert!(pull[749] > 0.01 && pull[751..].iter().all(|p| p.abs() < 1e-3), "it ends after 0.8 s");
    }

    #[test]
    fn the_airway_follows_the_muscles_by_the_lag() {
        let effort = |lag| Effort { peak: 10.0, duration: 1.0, begins: -0.05, lag }.pull(1000, 1e-3);
        let (prompt, late) = (effort(1e-6), effort(0.03));
        assert!(late[0] < 0.8 * prompt[0] && late[0] > 0.2 * prompt[0], "it began before the breath");
        // While a half sine is nearly straight, a lag is a delay.
        assert!((late[150] - prompt[120]).abs() < 0.1, "{} {}", late[150], prompt[120]);
    }

    #[test]
    fn kinds_of_breaths_have_their_shares_and_values_their_ranges() {
        let passive = EffortConfig { triggered: 0.0, at_any_time: 0.0, ..EffortConfig::default() };
        assert!(drawn(&passive).iter().all(|pull| pull.sum().abs() < 1e-9));
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        let efforts: Vec<_> = (0..4000).map(|_| EffortConfig::default().effort(1.0, &mut rng)).collect();
        let share = |count: usize| count as f32 / 4000.0;
        let some: Vec<Effort> = efforts.iter().flatten().copied().collect();
        let triggers = |effort: &&Effort| (-0.1..=-0.02).contains(&effort.begins);
        assert!((share(some.len()) - 0.4).abs() < 0.03);
        assert!((share(some.iter().filter(triggers).count()) - 0.305).abs() < 0.03, "and a few others");
        for effort in some {
            assert!((0.0..=12.0).contains(&effort.peak) && (0.5..=1.2).contains(&effort.duration));
            assert!((0.005..=0.08).contains(&effort.lag) && (-1.2..=1.0).contains(&effort.begins));
        }
    }

    #[test]
    fn the_same_seed_gives_the_same_efforts() {
        let config = EffortConfig::default();
        assert_eq!(drawn(&config)[400].0.map(f32::to_bits), drawn(&config)[400].0.map(f32::to_bits));
        assert!(drawn(&config).iter().any(|pull| pull.sum() > 1.0));
    }
}
