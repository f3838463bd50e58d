//! Torture test: random lungs, settings and weights and, in about half of the runs, a random fault. No true airway
//! pressure may exceed its bound, whatever the network computes. Verifies: breath-cut.
//!
//! Runs of a few breaths each are drawn from one seed and are independent, so the result depends neither on the number
//! of threads nor on where an earlier test was stopped.

use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::SeedableRng;
use rand_distr::StandardNormal;
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
use campaign::{CampaignOf, Sums, Work, WorkspaceError};
use plant::bench::{BenchConfig, Failure};
use progress::{Stage, Task};
use ventilator::SourceError;

/// Hostile controllers: breaths.
pub const TORTURE: Stage = Stage("torture, breaths");

/// Number of breaths per run.
pub const BREATHS_PER_RUN: u64 = 10;
/// Highest true airway pressure above the pressure limit, cmH2O.
pub const ABOVE_LIMIT: f64 = 15.0;
/// Highest PIP, cmH2O.
const HIGHEST_PIP: f32 = 50.0;
/// Earliest time of a fault, ms: the lung estimator needs two breaths first.
const WARM_UP_MS: u32 = 6000;
/// Ranges of resistance, cmH2O/(L/s), and compliance, mL/cmH2O.
const LUNGS: [(f64, f64); 2] = [(5.0, 50.0), (10.0, 50.0)];

/// Why a torture test cannot continue.
#[derive(Debug, Error)]
pub enum TortureError {
    /// A run failed.
    #[error(transparent)]
    Source(#[from] SourceError),
    /// The test cannot be kept or continued.
    #[error(transparent)]
    Workspace(#[from] WorkspaceError),
}

/// A torture test; its units are the runs.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Torture {
    /// Seed of all random numbers.
    pub seed: u64,
    /// Pressure limit, cmH2O.
    pub limit: f32,
}

impl Torture {
    /// Highest true airway pressure allowed, cmH2O.
    pub fn bound(&self) -> f64 {
        f64::from(self.limit) + ABOVE_LIMIT
    }
}

impl Work for Torture {
    type Question = Self;
    type Sums = Peaks;
    type Error = TortureError;

    fn question(&self) -> Self {
        self.clone()
    }

    fn nothing(&self) -> Peaks {
        Peaks::default()
    }

    fn stage(&self) -> (Stage, f64) {
        (TORTURE, BREATHS_PER_RUN as f64)
    }

    fn unit(&self, number: u64, task: &Task<'_>) -> Result<Option<RunResult>, TortureError> {
        let (peak_true, latched) = torment(self.seed, self.limit, number)?;
        task.advance(BREATHS_PER_RUN as usize);
        Ok(Some(RunResult { peak_true, above_limit: peak_true > self.bound(), latched }))
    }
}

/// Result of a run.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RunResult {
    /// Highest true airway pressure, cmH2O.
    pub peak_true: f64,
    /// Whether that is above the bound.
    pub above_limit: bool,
    /// Whether the run ended in the latched safe state.
    pub latched: bool,
}

/// Results of all runs so far.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Peaks {
    /// Highest true airway pressure, cmH2O.
    pub peak_true: f64,
    /// Number of the first run with this pressure.
    pub worst_run: u64,
    /// Number of runs with a pressure above the bound.
    pub above_limit: u64,
    /// Number of runs that ended in the latched safe state.
    pub latched: u64,
}

impl Sums for Peaks {
    type Unit = RunResult;

    fn add(&mut self, number: u64, result: RunResult) {
        let RunResult { peak_true, above_limit, latched } = result;
        let (above_limit, latched) = (u64::from(above_limit), u64::from(latched));
        self.absorb(Self { peak_true, worst_run: number, above_limit, latched });
    }

    fn absorb(&mut self, other: Self) {
        let order = other.peak_true.total_cmp(&self.peak_true);
        if order.then(self.worst_run.cmp(&other.worst_run)).is_gt() {
            (self.peak_true, self.worst_run) = (other.peak_true, other.worst_run);
        }
        self.above_limit += other.above_limit;
        self.latched += other.latched;
    }
}

/// What a torture test has found.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Summary {
    /// The test.
    #[serde(flatten)]
    pub torture: Torture,
    /// Number of breaths done.
    pub breaths: u64,
    /// What they have shown.
    #[serde(flatten)]
    pub peaks: Peaks,
}

impl Summary {
    /// The results of a test so far.
    pub fn of(campaign: &CampaignOf<Torture>) -> Self {
        let breaths = campaign.units() * BREATHS_PER_RUN;
        Self { torture: campaign.question().clone(), breaths, peaks: campaign.sums().clone() }
    }
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
    use campaign::Campaign;
    use progress::Progress;

    fn tortured(runs: u64) -> Summary {
        let torture = Torture { seed: 3, limit: LIMIT };
        let mut campaign = Campaign::new(&torture);
        campaign.advance(&torture, runs, None, &Progress::silent()).unwrap();
        Summary::of(&campaign)
    }

    #[test]
    fn no_random_controller_and_no_random_fault_exceeds_the_bound() {
        let found = tortured(300);
        assert_eq!((found.breaths, found.peaks.above_limit), (3000, 0), "{found:?}");
        assert!(found.peaks.peak_true > 35.0, "a torture that hurts nobody is none: {found:?}");
    }

    #[test]
    fn the_worst_run_is_the_first_with_the_highest_pressure_in_any_order() {
        let run = |peak_true, above_limit, latched| RunResult { peak_true, above_limit, latched };
        let runs = [(4, run(41.0, false, true)), (1, run(56.0, true, true)), (9, run(56.0, true, false))];
        let found = |order: [usize; 3]| {
            let mut peaks = Peaks::default();
            for place in order {
                peaks.add(runs[place].0, runs[place].1);
            }
            peaks
        };
        let wanted = Peaks { peak_true: 56.0, worst_run: 1, above_limit: 2, latched: 2 };
        assert!([[0, 1, 2], [2, 1, 0], [1, 2, 0]].into_iter().all(|order| found(order) == wanted));
    }
}
