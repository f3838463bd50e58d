//! `trainer evaluate --breathing`: triggered and timed breaths of breathing patients.

use serde::Serialize;
use shared::control::pid::PidGains;

use score::breathing::{BreathingScores, Kinds};
use show::report::{Cell, Table};

/// Columns of scores, with the number of decimals.
type Column = (&'static str, usize, fn(&Kinds) -> Option<f64>);

const COLUMNS: [Column; 5] = [
    ("passive", 3, |kinds| kinds.passive),
    ("timed", 3, |kinds| kinds.timed),
    ("triggered", 3, |kinds| kinds.triggered),
    ("triggered / timed", 3, Kinds::triggered_to_timed),
    ("triggered / passive", 3, Kinds::triggered_to_passive),
];

/// The content of `--json`.
#[derive(Debug, Serialize)]
pub struct Summary {
    /// Seed of sensor noise and efforts.
    pub seed: u64,
    /// Name of the evaluated controller.
    pub controller: String,
    /// Its weights, if it has any.
    pub weights_id: Option<String>,
    /// Gains of the PID.
    pub gains: PidGains,
    /// Control period, microseconds.
    pub period_us: u32,
    /// Scored breaths of every run.
    pub breaths: usize,
    /// Names of the controllers, in the order of the scores.
    pub controllers: Vec<String>,
    /// The scores.
    #[serde(flatten)]
    pub breathing: BreathingScores,
}

/// The scores as a table: patients by lung and effort, then the mean.
pub fn table(breathing: &BreathingScores, controllers: &[String], title: &str) -> Table {
    let mut table = Table::new(title, &["lung", "effort, cmH2O", "controller"]);
    table.header.extend(COLUMNS.map(|(name, ..)| name.to_owned()));
    for patients in &breathing.patients {
        let effort = Cell::number(patients.effort_cmh2o, 0);
        rows(&mut table, &patients.lung, &effort, controllers, &patients.controllers);
    }
    rows(&mut table, "mean", &Cell::right(""), controllers, &breathing.mean);
    table
}

fn rows(table: &mut Table, lung: &str, effort: &Cell, controllers: &[String], scores: &[Kinds]) {
    for (controller, kinds) in controllers.iter().zip(scores) {
        let mut row = vec![Cell::text(lung), effort.clone(), Cell::text(controller.as_str())];
        row.extend(COLUMNS.map(|(_, decimals, value)| Cell::known(value(kinds), decimals)));
        table.row(row);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use score::breathing::Patients;

    #[test]
    fn a_row_shows_scores_and_ratios_and_a_dash_for_none() {
        let kinds = Kinds { passive: Some(1.0), timed: Some(1.25), triggered: Some(1.5) };
        let none = Kinds { triggered: None, ..kinds };
        let patients = Patients {
            lung: "R20C20".into(),
            effort_cmh2o: 6.0,
            timed_breaths: 4,
            triggered_breaths: 8,
            controllers: vec![kinds, none],
        };
        let breathing = BreathingScores { patients: vec![patients], mean: vec![kinds, none] };
        let text = table(&breathing, &["PID".to_owned(), "learned".to_owned()], "").to_plain();
        assert_eq!((text.matches("1.200").count(), text.matches("1.500").count()), (2, 4), "{text}");
        assert_eq!(text.matches(" -").count(), 6, "{text}");
    }
}
