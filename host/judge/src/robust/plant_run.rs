//! One plant of a family: its waveform and noise, and the breaths of a controller on it.

use serde::{Deserialize, Serialize};
use shared::breath::{DEFAULT_PERIOD_US, PAPER_PIPS, paper_settings};
use shared::control::Controller;
use shared::settings::Settings;

use crate::evaluate::InspirationRecord;
use plant::bench::BenchConfig;
use plant::bench::family::Family;
use ventilator::{BenchSource, SourceError, seeds};

/// Breaths that are scored, by their numbers from 1.
pub const SCORED: [u32; 3] = [1, 6, 20];

/// A plant, its settings and the seed of its noise.
#[derive(Clone, Debug, PartialEq)]
pub struct PlantRun {
    /// The plant.
    pub bench: BenchConfig,
    /// Settings of its waveform.
    pub settings: Settings,
    /// Seed of the sensor noise, the same for every controller.
    pub noise: u64,
    /// Number of breaths.
    pub breaths: u32,
}

impl PlantRun {
    /// The plant with this number. The paper's waveforms take turns.
    pub fn new(family: &Family, seed: u64, number: u32, breaths: u32) -> Self {
        Self {
            bench: family.draw(seed, number),
            settings: paper_settings(PAPER_PIPS[number as usize % PAPER_PIPS.len()]),
            noise: seeds::plant(seed, u64::from(number)),
            breaths,
        }
    }
}

/// Score of one breath.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct BreathScore {
    /// Mean absolute error over the inspiration, cmH2O.
    pub score: f64,
    /// Highest pressure above PIP, cmH2O, at least 0.
    pub overshoot: f64,
}

/// Runs a controller on a plant from rest; returns the [`SCORED`] breaths up to the end or to the ventilator's safe state.
///
/// # Errors
/// A bench or settings that are refused.
pub fn breaths(run: &PlantRun, controller: &Controller) -> Result<Vec<BreathScore>, SourceError> {
    let mut source =
        BenchSource::new(&run.bench, controller.clone(), &run.settings, DEFAULT_PERIOD_US, run.noise)?;
    let mut scores = Vec::with_capacity(SCORED.len());
    for number in 1..=run.breaths {
        let mut record = InspirationRecord::default();
        let scored = SCORED.contains(&number);
        let mut sink = |tick: &_| {
            if scored {
                record.add(tick);
            }
        };
        match source.breathe(&run.settings, &mut sink) {
            Err(SourceError::Fault { .. }) => break,
            outcome => outcome?,
        }
        if scored {
            let score = record.score(&run.settings, DEFAULT_PERIOD_US);
            scores.push(BreathScore { score: score.score, overshoot: score.overshoot });
        }
    }
    Ok(scores)
}
