//! The demo's scores, as `summary.json` and as the table in the terminal.

use serde::{Deserialize, Serialize};
use shared::control::pid::PidGains;

use super::{Contestant, DemoConfig};
use learn::pipeline::{Outcome, Round};
use score::baselines::Best;
use score::evaluate::Score;
use show::report::{Cell, Table};

/// PID and learned controller on one waveform, on the true bench under the same noise.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Compared {
    /// PIP, cmH2O.
    pub pip: f32,
    /// The best PID found.
    pub pid: Score,
    /// The learned controller.
    pub learned: Score,
}

/// Mean scores over the waveforms, cmH2O.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct ContestantMeans {
    /// Best P-only controller.
    pub p_only: f64,
    /// Best I-only controller.
    pub i_only: f64,
    /// Best PID.
    pub pid: f64,
    /// Learned controller.
    pub learned: f64,
    /// Learned controller on the held-out simulator.
    pub learned_on_simulator: f64,
}

/// The content of `summary.json`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct DemoSummary {
    /// Seed of the demo.
    pub seed: u64,
    /// Name of the lung.
    pub lung: String,
    /// Duration of this run, s; excludes earlier runs that it continued.
    pub wall_s: f64,
    /// Scores of each waveform.
    pub waveforms: Vec<Compared>,
    /// Means over the waveforms.
    pub mean: ContestantMeans,
    /// Gains of the best PID: P %/cmH2O, I %/(cmH2O s), D % s/cmH2O.
    pub pid_gains: PidGains,
    /// Open-loop distance of the simulator to the true airway pressure on held-out breaths, cmH2O.
    pub open_loop_distance: f64,
    /// Whether the residual beat its PID on the held-out simulator (if not, the PID alone was kept).
    pub improved: bool,
    /// The rounds of collect, fit and train.
    pub rounds: Vec<Round>,
}

impl DemoSummary {
    pub(super) fn new(
        config: &DemoConfig,
        best: &Best,
        outcome: &Outcome,
        contestants: &[Contestant],
    ) -> Self {
        let mean = |n: usize| contestants[n].evaluation.mean.score;
        let waveforms = contestants[2].evaluation.waveforms.iter().zip(&contestants[3].evaluation.waveforms);
        let last = outcome.rounds.last();
        let saved = last.and_then(|round| round.open_loop.first());
        Self {
            seed: config.pipeline.seed,
            lung: config.bench.name.clone(),
            wall_s: 0.0,
            waveforms: waveforms
                .map(|(pid, learned)| Compared { pip: pid.pip, pid: pid.score, learned: learned.score })
                .collect(),
            mean: ContestantMeans {
                p_only: mean(0),
                i_only: mean(1),
                pid: mean(2),
                learned: mean(3),
                learned_on_simulator: outcome.learned.origin.validation,
            },
            pid_gains: best.pid.gains,
            open_loop_distance: saved.map_or(f64::NAN, |o| o.truth.unwrap_or(o.measured)),
            improved: last.is_some_and(|round| round.improved),
            rounds: outcome.rounds.clone(),
        }
    }

    /// Learned score as a share of the best PID's.
    pub fn ratio(&self) -> f64 {
        self.mean.learned / self.mean.pid
    }

    /// The comparison, waveform by waveform.
    pub fn table(&self) -> Table {
        let title = format!(
            "{}: best PID found and learned controller on the true bench (rise in ms, all else in cmH2O)",
            self.lung
        );
        let mut table = Table::new(title, &["PIP"]);
        table.header.extend(COLUMNS.iter().flat_map(|(name, ..)| [format!("{name} PID"), "learned".into()]));
        for row in &self.waveforms {
            table.row(cells(row.pip.to_string(), &row.pid, &row.learned));
        }
        let [pid, learned] = self.means();
        table.row(cells("mean".into(), &pid, &learned));
        table
    }

    /// Means of the best PID and of the learned controller over the waveforms.
    pub fn means(&self) -> [Score; 2] {
        let mean =
            |of: fn(&Compared) -> Score| Score::mean(&self.waveforms.iter().map(of).collect::<Vec<_>>());
        [mean(|row| row.pid), mean(|row| row.learned)]
    }
}

/// Selects one value of a score.
type Figure = fn(&Score) -> f64;

/// Name, value and number of decimals of each pair of columns.
const COLUMNS: [(&str, Figure, usize); 4] = [
    ("error", |score| score.score, 3),
    ("rise", |score| score.rise_ms, 0),
    ("overshoot", |score| score.overshoot, 2),
    ("plateau", |score| score.plateau_error, 3),
];

/// A row: each value of the PID beside that of the learned controller, with the better one marked.
fn cells(name: String, pid: &Score, learned: &Score) -> Vec<Cell> {
    let mut cells = vec![Cell::right(name)];
    for (_, figure, decimals) in COLUMNS {
        let (pid, learned) = (figure(pid), figure(learned));
        cells.push(Cell::number(pid, decimals).best_if(pid < learned));
        cells.push(Cell::number(learned, decimals).best_if(learned < pid));
    }
    cells
}

#[cfg(test)]
mod tests {
    use super::*;

    fn score(scale: f64) -> Score {
        Score {
            score: scale,
            rise_ms: 50.0 * scale,
            overshoot: 2.0 * scale,
            plateau_error: 0.1 * scale,
            late_error: 0.2 * scale,
            ..Score::default()
        }
    }

    fn summary() -> DemoSummary {
        DemoSummary {
            seed: 1,
            lung: "R20C20".into(),
            wall_s: 100.0,
            waveforms: [10.0, 35.0]
                .map(|pip| Compared { pip, pid: score(1.2), learned: score(0.9) })
                .to_vec(),
            mean: ContestantMeans {
                p_only: 2.0,
                i_only: 3.0,
                pid: 1.2,
                learned: 0.9,
                learned_on_simulator: 0.88,
            },
            pid_gains: PidGains { p: 2.0, i: 30.0, d: 0.0 },
            open_loop_distance: 0.12,
            improved: true,
            rounds: Vec::new(),
        }
    }

    #[test]
    fn the_table_shows_both_controllers_and_their_mean() {
        insta::assert_snapshot!(summary().table().to_plain());
    }

    #[test]
    fn the_json_has_the_names_that_scripts_rely_on() {
        let json = serde_json::to_value(summary()).unwrap();
        for name in ["seed", "lung", "wall_s", "waveforms", "mean", "pid_gains", "open_loop_distance"] {
            assert!(json.get(name).is_some(), "{name}");
        }
        for name in ["p_only", "i_only", "pid", "learned", "learned_on_simulator"] {
            assert!(json["mean"].get(name).is_some(), "mean.{name}");
        }
        for (controller, name) in ["pid", "learned"]
            .iter()
            .flat_map(|c| ["score", "rise_ms", "overshoot", "plateau_error"].map(|n| (c, n)))
        {
            assert!(json["waveforms"][0][controller].get(name).is_some(), "{controller}.{name}");
        }
        assert!((summary().ratio() - 0.75).abs() < 1e-12);
    }
}
