//! What an episode runs on: its plant, its waveform and the seed of its noise.

use plant::bench::BenchConfig;
use plant::bench::family::Family;
use plant::prescriptions::{Prescriptions, PrescriptionsError};
use score::breathing::{RHYTHMS, STRENGTHS, patient};
use shared::settings::Settings;
use ventilator::seeds;

use crate::EnvironmentError;

/// The plants of the episodes.
#[derive(Clone, Debug, PartialEq)]
pub enum Plants {
    /// These take turns.
    Benches(Vec<BenchConfig>),
    /// Every episode has a plant of its own, drawn from this family.
    Family(Box<Family>),
}

/// The plant, the settings of the breaths and the seed of the sensor noise of an episode.
#[derive(Clone, Debug, PartialEq)]
pub struct Draw {
    /// The plant.
    pub bench: BenchConfig,
    /// Settings of its breaths.
    pub settings: Settings,
    /// Seed of the sensor noise and of the patient's irregularity.
    pub noise: u64,
}

/// What a caller chooses of an episode; the rest follows from its number.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Choice {
    /// Number of the episode, which the following ones continue.
    pub number: Option<u32>,
    /// PIP, cmH2O.
    pub pip: Option<f32>,
    /// Seed of the sensor noise.
    pub noise: Option<u64>,
}

impl Plants {
    /// The prescriptions of this name: of a family, `paper` and `bedside` are its own.
    ///
    /// # Errors
    /// See [`PrescriptionsError`].
    pub fn prescriptions(&self, name: &str) -> Result<Prescriptions, PrescriptionsError> {
        match self {
            Self::Benches(_) => Prescriptions::find(name),
            Self::Family(family) => family.prescriptions(name),
        }
    }

    /// The waveforms of episodes without other ones: those of the paper, or of the family.
    pub fn usual(&self) -> Prescriptions {
        match self {
            Self::Benches(_) => Prescriptions::default(),
            Self::Family(family) => family.listed(),
        }
    }

    /// Number of plants before the next waveform takes its turn.
    fn per_waveform(&self) -> u32 {
        match self {
            Self::Benches(benches) => benches.len() as u32,
            Self::Family(_) => 1,
        }
    }

    /// The episode with this number, from 0, of those that a seed gives. With `breathing`, its patient breathes.
    pub(crate) fn draw(
        &self,
        prescriptions: &Prescriptions,
        seed: u64,
        number: u32,
        choice: Choice,
        breathing: bool,
    ) -> Result<Draw, EnvironmentError> {
        let turn = number / self.per_waveform();
        // Every plant meets every listed waveform; each episode has its own of those that are drawn.
        let own = prescriptions.draw(seed, if prescriptions.are_listed() { turn } else { number });
        let settings = Settings { pip: choice.pip.unwrap_or(own.pip), ..own };
        settings.validate()?;
        let mut bench = match self {
            Self::Benches(benches) => benches[number as usize % benches.len()].clone(),
            Self::Family(family) => family.draw(seed, number),
        };
        if breathing {
            let turn = turn as usize / prescriptions.pips.len().max(1);
            let rhythm = RHYTHMS[turn / STRENGTHS.len() % RHYTHMS.len()];
            bench.patient = patient(STRENGTHS[turn % STRENGTHS.len()], rhythm, &settings);
        }
        let noise = choice.noise.unwrap_or_else(|| seeds::plant(seed, u64::from(number)));
        Ok(Draw { bench, settings, noise })
    }
}
