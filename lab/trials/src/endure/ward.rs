//! The two kinds of patients, adults and newborns: their lungs and machines, what is set for them, and who controls.

use std::sync::LazyLock;

use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use shared::breath::DEFAULT_PERIOD_US;
use shared::control::Controller;
use shared::control::pid::Pid;
use shared::settings::Settings;

use super::chance::uniform;
use crate::faults::volume::passive_volume_ml;
use plant::bench::BenchConfig;
use plant::bench::family::Family;

/// Share of the newborns.
const NEWBORNS: f64 = 0.15;
/// Least volume of a passive breath that an operator accepts, mL.
const LEAST_VOLUME_ML: f64 = 5.0;
/// The operator's attempts to find such settings.
const ATTEMPTS: usize = 100;

/// A kind of patients.
#[derive(Debug)]
pub(super) struct Kind {
    family: Family,
    /// Whether they are newborns.
    pub(super) newborn: bool,
    /// Highest PEEP, cmH2O.
    pub(super) highest_peep: f32,
}

static KINDS: LazyLock<[Kind; 2]> =
    LazyLock::new(|| [Kind::shipped("adult", false), Kind::shipped("neonate", true)]);

impl Kind {
    fn shipped(name: &str, newborn: bool) -> Self {
        let family = Family::find(name).expect("a shipped family is valid");
        let peeps = family.bedside.drawn.iter().find(|(drawn, _)| drawn == "peep");
        let highest_peep =
            peeps.and_then(|(_, peeps)| peeps.ends()).map_or(0.0, |(_, highest)| highest as f32);
        Self { family, newborn, highest_peep }
    }

    /// Draws the kind of a patient.
    pub(super) fn draw(rng: &mut ChaCha8Rng) -> &'static Self {
        &KINDS[usize::from(rng.random_bool(NEWBORNS))]
    }

    /// Draws a lung and a machine.
    pub(super) fn bench(&self, rng: &mut ChaCha8Rng) -> BenchConfig {
        self.family.draw(rng.random(), 0)
    }

    /// Draws what an operator sets for a lung.
    pub(super) fn prescription(&self, rng: &mut ChaCha8Rng, bench: &BenchConfig) -> Settings {
        let seed = rng.random();
        let mut drawn = (0..ATTEMPTS as u32).map(|number| self.family.bedside.draw(seed, number));
        let last = self.family.bedside.draw(seed, ATTEMPTS as u32);
        drawn.find(|settings| ventilates(bench, settings)).unwrap_or(last)
    }

    /// One of two ranges: that of adults or that of newborns.
    pub(super) fn uniform(&self, rng: &mut ChaCha8Rng, adults: (f64, f64), newborns: (f64, f64)) -> f64 {
        uniform(rng, if self.newborn { newborns } else { adults })
    }
}

/// Whether a passive lung gets a breath at these settings.
pub(super) fn ventilates(bench: &BenchConfig, settings: &Settings) -> bool {
    passive_volume_ml(bench, settings) >= LEAST_VOLUME_ML
}

/// The controller of a patient: the chosen one, which is an adult's, or the best PID of newborns.
pub(super) fn controller(chosen: &Controller, newborn: bool) -> Controller {
    let gains = KINDS[1].family.bedside_pid.filter(|_| newborn);
    let pid = gains.and_then(|gains| Pid::new(gains, DEFAULT_PERIOD_US).ok());
    pid.map_or_else(|| chosen.clone(), Controller::Pid)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::endure::sound_controller;
    use rand_chacha::rand_core::SeedableRng;

    #[test]
    fn a_newborn_has_a_pid_of_its_own() {
        let (chosen, _) = sound_controller().unwrap();
        assert_eq!([false, true].map(|newborn| controller(&chosen, newborn) == chosen), [true, false]);
    }

    #[test]
    fn every_prescription_is_valid_and_ventilates() {
        let mut rng = ChaCha8Rng::seed_from_u64(2);
        for _ in 0..500 {
            let kind = Kind::draw(&mut rng);
            let bench = kind.bench(&mut rng);
            let settings = kind.prescription(&mut rng, &bench);
            assert_eq!(settings.validate(), Ok(()));
            assert!(ventilates(&bench, &settings) && settings.peep <= kind.highest_peep);
        }
    }
}
