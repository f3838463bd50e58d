//! `lab test-table`: the rows of the pressure-control test table.

use std::path::{Path, PathBuf};

use anyhow::bail;
use serde::Serialize;
use shared::breath::{DEFAULT_PERIOD_US, ISO_ROWS, IsoRow};
use shared::control::Controller;

use host::args::controller::learned;
use host::command::{Command, Context, Makes, Output, OutputArgs};
use plant::bench::{BenchConfig, is_neonatal};
use score::evaluate::{EVALUATE, plateau_tolerance};
use show::report::{Cell, Table};
use trials::test_table::{MOST_OVERSHOOT, Outcome, outcome};

/// Run the 21 pressure-control rows of ISO 80601-2-12
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  lab test-table
  lab test-table --adult out/adult/controller.safetensors --json -
  lab test-table --seed 7

Rows 1 to 8 run on the machine for adults, rows 9 to 21 on the one for newborns. Each row runs six
breaths from rest; the sixth is measured. A row passes if the mean plateau error is at most
2 cmH2O + 4 % of PIP and the overshoot at most 2 cmH2O. The rows were transcribed by the
open-ventilator community and not checked against the standard.

The exit status is 1 if a row fails.")]
pub struct Args {
    /// Learned controller for rows 1 to 8: a shipped one or a file
    #[arg(long, value_name = "NAME|FILE", default_value = "adult")]
    adult: PathBuf,
    /// Learned controller for rows 9 to 21: a shipped one or a file
    #[arg(long, value_name = "NAME|FILE", default_value = "neonate")]
    neonate: PathBuf,
    /// Seed of the sensor noise
    #[arg(long, default_value_t = 1)]
    seed: u64,
    #[command(flatten)]
    output: OutputArgs,
}

/// A row and its result, for `--json`.
#[derive(Debug, Serialize)]
pub struct RowResult {
    row: u8,
    resistance: f32,
    compliance: f32,
    pip: f32,
    peep: f32,
    machine: &'static str,
    /// Plateau error that is allowed, cmH2O.
    tolerance: f64,
    /// Overshoot that is allowed, cmH2O.
    overshoot_allowed: f64,
    expected_volume: f32,
    /// None if the ventilator entered its safe state.
    outcome: Option<Outcome>,
    pass: bool,
}

impl Command for Args {
    type Outcome = Vec<RowResult>;

    fn output(&self) -> Output<'_> {
        self.output.makes(Makes::Experiment)
    }

    fn run(&self, context: &Context<'_>) -> anyhow::Result<Option<Vec<RowResult>>> {
        let adult = controller(&self.adult)?;
        let neonate = controller(&self.neonate)?;
        let benches = BenchConfig::iso_matched();
        let rows: Vec<RowResult> = context.progress(|progress| {
            let task = progress.task(EVALUATE, benches.len());
            let rows = ISO_ROWS.iter().zip(&benches).map(|(row, bench)| {
                let newborn = is_neonatal(row);
                let controller = if newborn { &neonate } else { &adult };
                let result = row_result(row, newborn, outcome(row, bench, controller, self.seed)?);
                task.advance(1);
                Ok(result)
            });
            rows.collect::<anyhow::Result<_>>()
        })?;
        context.table(&table(&rows));
        Ok(Some(rows))
    }

    fn conclude(&self, outcome: Vec<RowResult>, _context: &Context<'_>) -> anyhow::Result<()> {
        let failed = outcome.iter().filter(|row| !row.pass).count();
        if failed > 0 {
            bail!("{failed} of {} rows fail", outcome.len());
        }
        Ok(())
    }
}

/// The learned controller with this name or in this file.
fn controller(which: &Path) -> anyhow::Result<Controller> {
    let chosen = learned(which)?;
    if chosen.period_us != DEFAULT_PERIOD_US {
        bail!(
            "{} has a control period of {} us: choose one for {DEFAULT_PERIOD_US} us",
            chosen.name,
            chosen.period_us
        );
    }
    Ok(chosen.chip()?.clone())
}

fn row_result(row: &IsoRow, newborn: bool, outcome: Option<Outcome>) -> RowResult {
    RowResult {
        row: row.number,
        resistance: row.resistance,
        compliance: row.compliance,
        pip: row.pip,
        peep: row.peep,
        machine: if newborn { "neonate" } else { "adult" },
        tolerance: plateau_tolerance(row.pip),
        overshoot_allowed: MOST_OVERSHOOT,
        expected_volume: row.tidal_volume,
        outcome,
        pass: outcome.is_some_and(|outcome| outcome.steady()),
    }
}

fn table(rows: &[RowResult]) -> Table {
    let figure = |row: &RowResult, decimals: usize, of: fn(&Outcome) -> f64| {
        row.outcome.map_or_else(|| Cell::right("stopped"), |outcome| Cell::number(of(&outcome), decimals))
    };
    Table::of(
        format!("Test table: pressures in cmH2O, overshoot at most {MOST_OVERSHOOT}"),
        rows,
        &[
            ("row", &|row| Cell::count(row.row.into())),
            ("machine", &|row| Cell::text(row.machine)),
            ("R", &|row| Cell::right(row.resistance.to_string())),
            ("C", &|row| Cell::right(row.compliance.to_string())),
            ("PIP", &|row| Cell::right(row.pip.to_string())),
            ("PEEP", &|row| Cell::right(row.peep.to_string())),
            ("plateau error", &|row| figure(row, 2, |outcome| outcome.score.plateau_error)),
            ("allowed", &|row| Cell::number(row.tolerance, 1)),
            ("overshoot", &|row| figure(row, 2, |outcome| outcome.score.overshoot)),
            ("rise, ms", &|row| figure(row, 0, |outcome| outcome.score.rise_ms)),
            ("volume, mL", &|row| figure(row, 0, |outcome| outcome.tidal_volume)),
            ("expected", &|row| Cell::right(row.expected_volume.to_string())),
            ("passes", &|row| Cell::text(if row.pass { "yes" } else { "no" })),
        ],
    )
}
