//! A learned controller beside its PID, waveform by waveform: the figures that commands print and write.

use serde::Serialize;

use judge::evaluate::Score;
use show::report::{Cell, Table};

/// Figures under the same noise.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Pair {
    /// The PID alone.
    pub pid: Score,
    /// The learned controller, if there is one.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub learned: Option<Score>,
}

/// One waveform's figures.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct WaveformPair {
    /// PIP, cmH2O.
    pub pip: f32,
    /// Its figures.
    #[serde(flatten)]
    pub pair: Pair,
}

/// A comparison over all waveforms.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Comparison {
    /// By waveform, as in the plan.
    pub waveforms: Vec<WaveformPair>,
    /// Mean over the waveforms.
    pub mean: Pair,
}

impl Comparison {
    /// Adds the mean to figures by waveform; it has a learned controller if all waveforms have.
    pub fn new(waveforms: Vec<WaveformPair>) -> Self {
        let pid: Vec<Score> = waveforms.iter().map(|w| w.pair.pid).collect();
        let learned: Option<Vec<Score>> = waveforms.iter().map(|w| w.pair.learned).collect();
        let learned = learned.filter(|scores| !scores.is_empty()).map(|scores| Score::mean(&scores));
        Self { waveforms, mean: Pair { pid: Score::mean(&pid), learned } }
    }

    /// As a table; the better score of each waveform is marked.
    pub fn table(&self, title: &str) -> Table {
        let mut table = Table::new(
            title,
            &["waveform", "controller", "score", "rise, ms", "overshoot", "plateau error", "late error"],
        );
        for waveform in &self.waveforms {
            rows(&mut table, &format!("PIP {}", waveform.pip), &waveform.pair);
        }
        rows(&mut table, "mean", &self.mean);
        table
    }
}

fn rows(table: &mut Table, name: &str, pair: &Pair) {
    let better = |score: &Score, than: Option<Score>| than.is_some_and(|other| score.score <= other.score);
    let both = [("PID", Some(pair.pid), pair.learned), ("learned", pair.learned, Some(pair.pid))];
    for (controller, score, other) in both {
        let Some(score) = score else { continue };
        table.row(vec![
            Cell::text(name),
            Cell::text(controller),
            Cell::number(score.score, 3).best_if(better(&score, other)),
            Cell::number(score.rise_ms, 0),
            Cell::number(score.overshoot, 2),
            Cell::number(score.plateau_error, 3),
            Cell::number(score.late_error, 3),
        ]);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    fn comparison(pid: f64, learned: Option<f64>) -> Comparison {
        let score = |score| Score { score, rise_ms: 90.0, ..Score::default() };
        let pair = Pair { pid: score(pid), learned: learned.map(score) };
        Comparison::new(vec![WaveformPair { pip: 15.0, pair }, WaveformPair { pip: 20.0, pair }])
    }

    #[test]
    fn an_entry_holds_pid_and_learned_side_by_side() {
        let json = serde_json::to_value(comparison(2.0, Some(1.5))).unwrap();
        let entry = &json["waveforms"][0];
        assert_eq!((&entry["pip"], &entry["pid"]["score"]), (&15.0.into(), &2.0.into()));
        assert_eq!(entry["learned"]["score"], 1.5);
        assert_eq!(json["mean"]["learned"]["rise_ms"], 90.0);
    }

    #[test]
    fn a_pid_alone_has_no_learned_figures_and_no_winner() {
        let alone = comparison(2.0, None);
        assert!(serde_json::to_value(&alone).unwrap()["waveforms"][0].get("learned").is_none());
        assert!(!alone.table("").to_plain().contains('*'));
    }

    #[test]
    fn the_better_score_is_marked() {
        let text = comparison(2.0, Some(1.5)).table("").to_plain();
        assert!(text.contains("1.500*") && !text.contains("2.000*"), "{text}");
    }
}
