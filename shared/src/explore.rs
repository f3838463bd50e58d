//! Exploration: a random perturbation of the controller's command, one per breath, so that recordings contain varied
//! commands (Suo et al. 2021, section 4).
//!
//! *Boundary* exploration adds a step at the start of the inspiration that fades out linearly; *triangular*
//! exploration adds a ramp up and down somewhere within the inspiration. A breath's perturbation depends only on the
//! parameters, the breath's number and its inspiratory time, so device and bench explore alike.
//!
//! | module | contains |
//! |---|---|
//! | [`sines`] | a sweep of sines in place of random perturbations, to measure the gain of the loop |

pub mod sines;

use rand_chacha::ChaCha8Rng;
use rand_core::{Rng, SeedableRng};
use serde::{Deserialize, Serialize};
use thiserror::Error;

use crate::breath::{Breath, period_s};
use crate::control::COMMAND_MAX;
use sines::Sine;

/// Lower and upper end of a uniform distribution.
pub type Range = (f32, f32);

/// Parameters of exploration; the defaults are the paper's.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Exploration {
    /// Probability of boundary exploration; all other breaths get a triangle.
    pub boundary_probability: f32,
    /// Command added at the start of the breath, percent.
    pub boundary_height: Range,
    /// Time until that command has faded out, s.
    pub boundary_duration: Range,
    /// Peak of the triangle, percent.
    pub triangle_height: Range,
    /// Duration of the triangle, s.
    pub triangle_duration: Range,
    /// Seed of the random number generator.
    pub seed: u64,
}

impl Default for Exploration {
    fn default() -> Self {
        Self {
            boundary_probability: 0.15,
            boundary_height: (0.0, 100.0),
            boundary_duration: (0.05, 0.3),
            triangle_height: (-30.0, 30.0),
            triangle_duration: (0.1, 0.5),
            seed: 0,
        }
    }
}

/// An exploration parameter out of bounds.
#[derive(Clone, Copy, Debug, PartialEq, Error)]
#[error("exploration: {name} is {low} to {high}; give the lower end first, both within {min} to {max}")]
pub struct ExplorationError {
    /// Field of [`Exploration`].
    pub name: &'static str,
    /// Requested lower end.
    pub low: f32,
    /// Requested upper end.
    pub high: f32,
    /// Lowest accepted value.
    pub min: f32,
    /// Highest accepted value.
    pub max: f32,
}

impl Exploration {
    /// Checks that every range is ordered and within its bounds.
    ///
    /// # Errors
    /// The first range that is not.
    pub fn validate(&self) -> Result<(), ExplorationError> {
        let p = self.boundary_probability;
        let ranges = [
            ("boundary_probability", (p, p), 0.0, 1.0),
            ("boundary_height", self.boundary_height, -COMMAND_MAX, COMMAND_MAX),
            ("boundary_duration", self.boundary_duration, 0.001, 5.0),
            ("triangle_height", self.triangle_height, -COMMAND_MAX, COMMAND_MAX),
            ("triangle_duration", self.triangle_duration, 0.001, 5.0),
        ];
        for (name, (low, high), min, max) in ranges {
            if !(low >= min && low <= high && high <= max) {
                return Err(ExplorationError { name, low, high, min, max });
            }
        }
        Ok(())
    }

    /// Perturbation of the breath with this number.
    pub fn perturbation(&self, breath: &Breath, number: u32) -> Perturbation {
        debug_assert!(self.validate().is_ok(), "parameters are validated where they arrive");
        let mut rng = ChaCha8Rng::seed_from_u64(self.seed);
        rng.set_stream(u64::from(number));
        let mut draw = |(low, high): Range| low + (high - low) * unit(rng.next_u32());
        if draw((0.0, 1.0)) < self.boundary_probability {
            let height = draw(self.boundary_height);
            Perturbation { height, start: 0.0, peak: 0.0, end: draw(self.boundary_duration) }
        } else {
            let inspiration = breath.settings().inspiratory_time;
            let height = draw(self.triangle_height);
            let duration = draw(self.triangle_duration).min(inspiration);
            let start = draw((0.0, inspiration - duration));
            debug_assert!(start >= 0.0 && duration > 0.0, "a triangle lies within the inspiration");
            Perturbation { height, start, peak: start + 0.5 * duration, end: start + duration }
        }
    }
}

/// The upper 24 bits as a number in `0.0..1.0`.
fn unit(bits: u32) -> f32 {
    (bits >> 8) as f32 / 16_777_216.0
}

/// A linear rise and fall of the command within one breath; times in seconds from the start of the breath.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Perturbation {
    /// Command added at the peak, percent.
    pub height: f32,
    /// Start of the rise.
    pub start: f32,
    /// Time of the peak; equal to `start` for boundary exploration.
    pub peak: f32,
    /// End of the fall.
    pub end: f32,
}

impl Perturbation {
    /// Command to add at `tick` of the breath, percent.
    pub fn at(&self, tick: u32, period_us: u32) -> f32 {
        let time = tick as f32 * period_s(period_us);
        if time < self.start || time >= self.end {
            0.0
        } else if time < self.peak {
            self.height * ((time - self.start) / (self.peak - self.start))
        } else {
            self.height * ((self.end - time) / (self.end - self.peak))
        }
    }
}

/// What is added to the commands of a breath.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum Addition {
    /// Nothing.
    #[default]
    Nothing,
    /// A random perturbation.
    Perturbation(Perturbation),
    /// A sine, of which the control law is not told.
    Sine(Sine),
}

impl Addition {
    /// Command to add at `tick` of the breath, percent.
    #[inline]
    pub fn at(&self, tick: u32, period_us: u32) -> f32 {
        match self {
            Self::Nothing => 0.0,
            Self::Perturbation(perturbation) => perturbation.at(tick, period_us),
            Self::Sine(sine) => sine.at(tick),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::breath::{DEFAULT_PERIOD_US, paper_settings};
    use proptest::prelude::*;

    fn breath() -> Breath {
        Breath::new(&paper_settings(20.0), DEFAULT_PERIOD_US).unwrap()
    }

    #[test]
    fn the_papers_defaults_are_valid() {
        assert_eq!(Exploration::default().validate(), Ok(()));
    }

    #[test]
    fn boundary_exploration_starts_high_and_fades_out() {
        let only_boundary = Exploration { boundary_probability: 1.0, ..Exploration::default() };
        for number in 0..200 {
            let p = only_boundary.perturbation(&breath(), number);
            assert!((p.at(0, DEFAULT_PERIOD_US) - p.height).abs() < 1e-4);
            assert!((0.0..100.0).contains(&p.height) && (0.05..0.3).contains(&p.end));
            let left = 1.0 - 0.03 / p.end;
            assert!((p.at(30, DEFAULT_PERIOD_US) - p.height * left).abs() < 1e-3);
            assert!(p.at(300, DEFAULT_PERIOD_US).abs() < 1e-9);
        }
    }

    #[test]
    fn the_share_of_boundary_exploration_is_its_probability() {
        let exploration = Exploration::default();
        let boundary =
            (0..10_000).filter(|n| exploration.perturbation(&breath(), *n).peak.abs() < 1e-9).count();
        assert!((1350..1650).contains(&boundary), "{boundary} of 10000, expected 1500");
    }

    #[test]
    fn a_breaths_perturbation_depends_on_seed_and_number_alone() {
        let (one, two) = (Exploration::default(), Exploration { seed: 1, ..Exploration::default() });
        assert_eq!(one.perturbation(&breath(), 7), one.perturbation(&breath(), 7));
        assert_ne!(one.perturbation(&breath(), 7), one.perturbation(&breath(), 8));
        assert_ne!(one.perturbation(&breath(), 7), two.perturbation(&breath(), 7));
    }

    #[test]
    fn a_falling_range_is_refused_by_name() {
        let wrong = Exploration { triangle_height: (30.0, -30.0), ..Exploration::default() };
        assert_eq!(wrong.validate().unwrap_err().name, "triangle_height");
    }

    proptest! {
        #[test]
        fn perturbations_are_bounded_and_end_within_the_inspiration(seed: u64, number: u32, tick in 0u32..3000) {
            let p = Exploration { seed, ..Exploration::default() }.perturbation(&breath(), number);
            prop_assert!(p.at(tick, DEFAULT_PERIOD_US).abs() <= p.height.abs() + 1e-3);
            prop_assert!(tick < 1000 || p.at(tick, DEFAULT_PERIOD_US).abs() < 1e-9);
        }
    }
}
