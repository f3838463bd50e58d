//! Torture test: random lungs, settings and weights and, in about half of the runs, a random fault. No true airway
//! pressure may exceed its bound, whatever the network computes.
//!
//! Runs of a few breaths each are drawn from one seed and are independent, so the result depends neither on the number
//! of threads nor on where an earlier test was stopped.

use std::io;
use std::path::{Path, PathBuf};

use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::SeedableRng;
use rand_distr::StandardNormal;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use shared::breath::{DEFAULT_PERIOD_US, paper_settings};
use shared::control::Controller;
use shared::control::network::Network;
use shared::control::pid::{Pid, PidGains};
use shared::safety::monitors::Monitors;
use shared::settings::{LIMIT_MARGIN, Settings};
use thiserror::Error;

use super::hostile::full_authority;
use super::injection::Injection;
use super::trial::{Trial, run};
use data::files::{read_json, write_json_indented};
use plant::bench::{BenchConfig, Failure};
use progress::{Progress, Stage};
use ventilator::SourceError;

/// Number of breaths per run.
pub const BREATHS_PER_RUN: u64 = 10;
/// Highest true airway pressure above the pressure limit, cmH2O.
pub const ABOVE_LIMIT: f64 = 15.0;
/// Highest PIP, cmH2O.
const HIGHEST_PIP: f32 = 50.0;
/// Earliest time of a fault, ms: the lung estimator needs two breaths first.
const WARM_UP_MS: u32 = 6000;
/// Number of runs between two checks for a stop request.
const BATCH: u64 = 500;
/// Ranges of resistance, cmH2O/(L/s), and compliance, mL/cmH2O.
const LUNGS: [(f64, f64); 2] = [(5.0, 50.0), (10.0, 50.0)];

/// Why a torture test cannot continue.
#[derive(Debug, Error)]
#[expect(missing_docs, reason = "the messages name every field")]
pub enum TortureError {
    /// A run failed.
    #[error(transparent)]
    Source(#[from] SourceError),
    /// The progress file could not be used.
    #[error("cannot use {}: {source}", path.display())]
    File { path: PathBuf, source: io::Error },
    /// The file belongs to a test with another seed or limit.
    #[error("{} belongs to seed {seed} and limit {limit}: choose another file or these", path.display())]
    OtherTest { path: PathBuf, seed: u64, limit: f32 },
}

/// Progress and results of a torture test; when saved, the test can continue later.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Torture {
    /// Seed of all random numbers.
    pub seed: u64,
    /// Pressure limit, cmH2O.
    pub limit: f32,
    /// Number of breaths done.
    pub breaths: u64,
    /// Highest true airway pressure, cmH2O.
    pub peak_true: f64,
    /// Number of the run with the highest pressure.
    pub worst_run: u64,
    /// Number of runs with a pressure above the bound.
    pub above_limit: u64,
    /// Number of runs that ended in the latched safe state.
    pub latched: u64,
}

impl Torture {
    /// A test at its beginning.
    pub fn new(seed: u64, limit: f32) -> Self {
        Self { seed, limit, breaths: 0, peak_true: 0.0, worst_run: 0, above_limit: 0, latched: 0 }
    }

    /// Highest true airway pressure allowed, cmH2O.
    pub fn bound(&self) -> f64 {
        f64::from(self.limit) + ABOVE_LIMIT
    }

    /// The progress that an earlier test with this seed and limit saved in a file, or a new test.
    ///
    /// # Errors
    /// A file that cannot be read, or that has another seed or limit.
    pub fn resume(file: &Path, seed: u64, limit: f32) -> Result<Self, TortureError> {
        let kept: Self = read_json(file).map_err(failure(file))?.unwrap_or_else(|| Self::new(seed, limit));
        if (kept.seed, kept.limit.to_bits()) == (seed, limit.to_bits()) {
            Ok(kept)
        } else {
            Err(TortureError::OtherTest { path: file.to_owned(), seed: kept.seed, limit: kept.limit })
        }
    }

    /// Continues until this number of breaths is done or it is stopped, and saves the progress if a file is given.
    ///
    /// # Errors
    /// A run that fails, or a file that cannot be written.
    pub fn advance(
        &mut self,
        breaths: u64,
        keep: Option<&Path>,
        progress: &Progress<'_>,
    ) -> Result<(), TortureError> {
        let task = progress.task(Stage::Torture, breaths as usize);
        task.reach(self.breaths as usize);
        while self.breaths < breaths && !task.stopped() {
            let first = self.breaths / BREATHS_PER_RUN;
            let last = (first + BATCH).min(breaths.div_ceil(BREATHS_PER_RUN));
            let found: Result<Vec<_>, SourceError> =
                (first..last).into_par_iter().map(|number| torment(self.seed, self.limit, number)).collect();
            for (number, (peak, latched)) in (first..).zip(found?) {
                if peak > self.peak_true {
                    (self.peak_true, self.worst_run) = (peak, number);
                }
                self.above_limit += u64::from(peak > self.bound());
                self.latched += u64::from(latched);
            }
            self.breaths = last * BREATHS_PER_RUN;
            task.reach(self.breaths as usize);
            if let Some(file) = keep {
                write_json_indented(file, self).map_err(failure(file))?;
            }
        }
        Ok(())
    }
}

fn failure(file: &Path) -> impl FnOnce(io::Error) -> TortureError {
    let path = file.to_owned();
    move |source| TortureError::File { path, source }
}

/// Performs one run; returns its highest true pressure and whether it ended in the safe state.
fn torment(seed: u64, limit: f32, number: u64) -> Result<(f64, bool), SourceError> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    rng.set_stream(number);
    let [resistance, compliance] = LUNGS.map(|(low, high)| rng.random_range(low..=high));
    let mut bench = BenchConfig::paper(resistance, compliance);
    bench.unit.number = rng.random_range(0..1000);
    let highest = (limit - LIMIT_MARGIN).min(HIGHEST_PIP);
    let settings = Settings { pressure_limit: limit, ..paper_settings(rng.random_range(8.0_f32..=highest)) };
    let controller = hostile(&mut rng).ok_or(SourceError::Stopped)?;
    let watched_ms = 3000 * BREATHS_PER_RUN as u32;
    let onset_ms = rng.random_range(WARM_UP_MS..watched_ms / 2);
    let trial = Trial {
        bench: &bench,
        settings,
        controller: &controller,
        monitors: Monitors::ALL,
        injection: fault(&mut rng),
        onset_ms,
        watched_ms: watched_ms - onset_ms,
        judged_after_ms: 0,
        seed: rng.random(),
    };
    let outcome = run(&trial)?;
    Ok((outcome.peak_true, outcome.latched_ms.is_some()))
}

/// A network with random weights, from small to extreme, on a random PID.
fn hostile(rng: &mut ChaCha8Rng) -> Option<Controller> {
    let size = 10.0_f32.powf(rng.random_range(-1.0..2.0));
    let mut network = Network::zero();
    for weight in network.parameters_mut() {
        *weight = size * rng.sample::<f32, _>(StandardNormal);
    }
    let gains = PidGains {
        p: rng.random_range(0.0..20.0),
        i: rng.random_range(0.0..800.0),
        d: rng.random_range(0.0..0.4),
    };
    full_authority(gains, network).or_else(|| Pid::new(gains, DEFAULT_PERIOD_US).ok().map(Controller::Pid))
}

/// A fault that leaves the valves working; none for half of the runs.
fn fault(rng: &mut ChaCha8Rng) -> Injection {
    let size = rng.random_range(0.1_f32..1.0);
    match rng.random_range(0..26) {
        0 => Injection::StuckAtLast,
        1 => Injection::StuckAt(30.0 * size),
        2 => Injection::StuckAt(5.0),
        3 => Injection::Reads(f32::NAN),
        4 => Injection::Drift(4.0 * size - 2.0),
        5 => Injection::Offset(10.0 * size - 5.0),
        6 => Injection::Noise(2.0 * size),
        7 => Injection::Dropped(size),
        8 => Injection::SwappedBytes(size),
        9 => Injection::Part(Failure::TubeOccluded),
        10 => Injection::Part(Failure::Disconnected),
        11 => Injection::Part(Failure::Leak(f64::from(3.0 * size))),
        12 => Injection::MissedTicks((50.0 * size) as u32),
        _ => Injection::Controller,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::faults::cases::LIMIT;

    fn tortured(breaths: u64) -> Torture {
        let mut torture = Torture::new(3, LIMIT);
        torture.advance(breaths, None, &Progress::silent()).unwrap();
        torture
    }

    #[test]
    fn no_random_controller_and_no_random_fault_exceeds_the_bound() {
        let torture = tortured(3000);
        assert_eq!((torture.breaths, torture.above_limit), (3000, 0), "{torture:?}");
        assert!(torture.peak_true > 35.0, "a torture that hurts nobody is none: {torture:?}");
    }

    #[test]
    fn a_torture_in_two_parts_finds_what_one_in_a_single_part_finds() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("torture.json");
        for breaths in [200, 500] {
            let mut part = Torture::resume(&file, 3, LIMIT).unwrap();
            part.advance(breaths, Some(&file), &Progress::silent()).unwrap();
        }
        assert_eq!(Torture::resume(&file, 3, LIMIT).unwrap(), tortured(500));
        for (seed, limit) in [(4, LIMIT), (3, 60.0)] {
            let refused = Torture::resume(&file, seed, limit).unwrap_err().to_string();
            assert!(refused.contains("belongs to seed 3 and limit 40"), "{refused}");
        }
    }
}
