//! One plant of a family: its waveform and noise, and the breaths of a controller on it.

use serde::{Deserialize, Serialize};
use shared::breath::{Breath, DEFAULT_PERIOD_US};
use shared::control::ControlLaw;
use shared::settings::Settings;

use plant::bench::BenchConfig;
use plant::bench::family::Family;
use plant::prescriptions::Prescriptions;
use score::evaluate::{InspirationRecord, Score, ValveEffort, plateau_tolerance};
use ventilator::{BenchSource, SourceError, seeds};

/// Breaths that are scored in full, by their numbers from 1.
pub const SCORED: [u32; 3] = [1, 6, 20];
/// A later breath may be worse than the first by this share of its score, or by this many cmH2O if that is more.
const WORSE_SHARE: f64 = 0.05;
const WORSE_CMH2O: f64 = 0.3;

/// A plant, its settings and the seed of its noise.
#[derive(Clone, Debug, PartialEq)]
pub struct PlantRun {
    /// The plant.
    pub bench: BenchConfig,
    /// Settings of its waveform: its prescription.
    pub settings: Settings,
    /// Seed of the sensor noise, the same for every controller.
    pub noise: u64,
    /// Number of breaths.
    pub breaths: u32,
    /// Go on after the pressure limit has ended an inspiration: a drawn limit is so close to PIP that an overshoot reaches it.
    pub goes_on: bool,
}

impl PlantRun {
    /// The plant with this number. Listed waveforms take turns, drawn ones are drawn for each plant.
    pub fn new(family: &Family, prescriptions: &Prescriptions, seed: u64, number: u32, breaths: u32) -> Self {
        Self {
            bench: family.draw(seed, number),
            settings: prescriptions.draw(seed, number),
            noise: seeds::plant(seed, u64::from(number)),
            breaths,
            goes_on: !prescriptions.are_listed(),
        }
    }
}

/// Score of one breath.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct BreathScore {
    /// Mean absolute error over the inspiration, cmH2O.
    pub score: f64,
    /// Highest pressure above PIP, cmH2O, at least 0.
    pub overshoot: f64,
    /// Valve effort over the plateau.
    pub effort: ValveEffort,
}

/// The breaths of a controller on a plant, up to the last one or to the ventilator's safe state.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct PlantBreaths {
    /// Mean absolute error of every breath, cmH2O.
    pub every: Vec<f64>,
    /// The breaths whose numbers are in [`SCORED`].
    pub scored: Vec<BreathScore>,
    /// Whether the pressure oscillated on the plateau of a breath by more than the plateau may be off.
    pub unstable: bool,
    /// Whether the pressure limit ended an inspiration.
    pub cut: bool,
}

impl PlantBreaths {
    /// Whether a later breath is worse than the first by more than 5 % and by more than 0.3 cmH2O.
    pub fn worsened(&self) -> bool {
        let Some((first, later)) = self.every.split_first() else { return false };
        let allowed = (first * (1.0 + WORSE_SHARE)).max(first + WORSE_CMH2O);
        later.iter().any(|score| *score > allowed)
    }
}

/// Runs a controller on a plant from rest.
///
/// # Errors
/// A bench or settings that are refused.
pub fn breaths<C: ControlLaw + Clone>(run: &PlantRun, controller: &C) -> Result<PlantBreaths, SourceError> {
    let PlantRun { bench, settings, noise, breaths, goes_on } = run;
    let source = BenchSource::new(bench, controller.clone(), settings, DEFAULT_PERIOD_US, *noise)?;
    let mut source = if *goes_on { source.going_on() } else { source };
    let planned = Breath::new(settings, DEFAULT_PERIOD_US).map_err(SourceError::from)?;
    let mut found = PlantBreaths::default();
    for number in 1..=*breaths {
        let mut record = InspirationRecord::default();
        match source.breathe(settings, &mut |tick| record.add_planned(tick, &planned)) {
            Err(SourceError::Fault { .. }) => break,
            outcome => outcome?,
        }
        let score = record.score(settings, DEFAULT_PERIOD_US);
        found.every.push(score.score);
        found.cut |= score.cut > 0.0;
        found.unstable |=
            record.oscillation(settings, DEFAULT_PERIOD_US) > 2.0 * plateau_tolerance(settings.pip);
        if SCORED.contains(&number) {
            let Score { score, overshoot, effort, .. } = score;
            found.scored.push(BreathScore { score, overshoot, effort });
        }
    }
    Ok(found)
}
