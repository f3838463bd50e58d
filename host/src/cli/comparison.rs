//! The table that compares a controller with a PID, waveform by waveform.

use score::evaluate::{Comparison, Pair, Score};
use show::report::{Cell, Table};

/// A comparison as a table that marks the better score of each waveform; `beside` is the controller that is not the PID.
pub fn table(comparison: &Comparison, beside: &str, title: &str) -> Table {
    let mut table = Table::new(
        title,
        &[
            "waveform",
            "controller",
            "score",
            "rise, ms",
            "overshoot",
            "plateau error",
            "late error",
            "valve, %/s",
            "valve, %",
        ],
    );
    for waveform in &comparison.waveforms {
        rows(&mut table, &waveform.name(), beside, &waveform.pair);
    }
    rows(&mut table, "mean", beside, &comparison.mean);
    table
}

fn rows(table: &mut Table, name: &str, beside: &str, pair: &Pair) {
    let better = |score: &Score, than: Option<Score>| than.is_some_and(|other| score.score <= other.score);
    let both = [("PID", Some(pair.pid), pair.learned), (beside, pair.learned, Some(pair.pid))];
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
            Cell::number(score.effort.total_variation, 0),
            Cell::number(score.effort.deviation, 1),
        ]);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use score::evaluate::WaveformPair;

    fn text(pid: f64, learned: Option<f64>) -> String {
        let score = |score| Score { score, rise_ms: 90.0, ..Score::default() };
        let pair = Pair { pid: score(pid), learned: learned.map(score) };
        table(&Comparison::new(vec![WaveformPair { pip: 15.0, settings: None, pair }]), "learned", "")
            .to_plain()
    }

    #[test]
    fn the_better_score_is_marked_where_there_are_two() {
        let both = text(2.0, Some(1.5));
        assert!(both.contains("1.500*") && !both.contains("2.000*"), "{both}");
        assert!(!text(2.0, None).contains('*'));
    }
}
