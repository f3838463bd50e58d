//! `trainer faults`: the fault matrix on the virtual bench.

use anyhow::{anyhow, bail};
use serde::Serialize;
use shared::safety::alarms::{ALARMS, Action, Fault};
use shared::safety::monitors::Monitors;
use std::path::PathBuf;

use super::common::{bar, benches, stop};
use super::output::OutputArgs;
use data::provenance::Provenance;
use judge::faults::matrix::{FaultRow, false_alarms, matrix, sound_pid};
use plant::bench::BenchConfig;
use progress::Watch;
use shared::breath::DEFAULT_PERIOD_US;
use show::report::{Block, Cell, Report, Section, Table};

/// Break sensor, valves, tube and controller on the virtual bench: does the right monitor fire in time?
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  trainer faults
  trainer faults --lung R5C10 --json faults.json --html faults.html
  trainer faults --without reading-frozen --lung R20C20     # what this monitor is there for
  trainer faults --mutate                                   # the same for each monitor
  trainer faults --nominal 10000                            # false alarms with effort and coughs

A row passes if its monitors fire under every seed, the command to vent follows within 200 ms of a
reading above the limit, and the true airway pressure stays under its bound. A row that fails makes
the command fail.")]
pub struct Args {
    /// Lung as in R20C20, or `paper` for its nine lungs; may be repeated
    #[arg(long, value_name = "NAME", default_value = "paper")]
    lung: Vec<String>,
    /// Seeds of the noise
    #[arg(long, value_name = "N,..", value_delimiter = ',', default_values_t = [1, 2])]
    seeds: Vec<u64>,
    /// Leave out this monitor
    #[arg(long, value_name = "ID")]
    without: Option<String>,
    /// Leave out each monitor in turn and demand that a row fails
    #[arg(long, conflicts_with = "without")]
    mutate: bool,
    /// Breathe so many breaths with nothing wrong, and demand that no alarm comes
    #[arg(long, value_name = "BREATHS", conflicts_with_all = ["without", "mutate"])]
    nominal: Option<u32>,
    /// Write the matrix as a page
    #[arg(long, value_name = "FILE")]
    html: Option<PathBuf>,
    #[command(flatten)]
    output: OutputArgs,
}

/// What `--json` gives.
#[derive(Debug, Serialize)]
struct Summary {
    rows: Vec<FaultRow>,
}

/// Runs the command.
pub fn run(args: &Args) -> anyhow::Result<()> {
    let lungs = benches(&args.lung, &[])?;
    match (args.nominal, args.mutate) {
        (Some(breaths), _) => nominal(args, &lungs, breaths),
        (None, true) => mutate(args, &lungs),
        (None, false) => faults(args, &lungs),
    }
}

fn tried(
    what: &str,
    args: &Args,
    lungs: &[BenchConfig],
    monitors: Monitors,
) -> anyhow::Result<Vec<FaultRow>> {
    let bar = bar(what, 0);
    let progress = |done: u64, total: u64| {
        bar.set_length(total);
        bar.set_position(bar.position().max(done));
    };
    let rows = matrix(lungs, &args.seeds, monitors, &Watch::new(&progress, stop()));
    bar.finish_and_clear();
    Ok(rows?)
}

fn faults(args: &Args, lungs: &[BenchConfig]) -> anyhow::Result<()> {
    let monitors = match &args.without {
        Some(id) => Monitors::ALL.without(named(id)?),
        None => Monitors::ALL,
    };
    let rows = tried("faults", args, lungs, monitors)?;
    let table = table(&rows);
    args.output.table(&table);
    if let Some(path) = &args.html {
        report(table).save(path.clone())?;
    }
    let (failed, all) = (rows.iter().filter(|row| !row.pass).count(), rows.len());
    args.output.finish(&Summary { rows })?;
    if failed > 0 {
        bail!("{failed} of {all} rows failed");
    }
    args.output.line(&format!("all {all} rows passed"));
    Ok(())
}

fn mutate(args: &Args, lungs: &[BenchConfig]) -> anyhow::Result<()> {
    let mut table = Table::new("What fails without a monitor", &["without", "rows that fail"]);
    let mut unnoticed = Vec::new();
    for fault in Fault::all() {
        let id = fault.alarm().id;
        let rows = tried(id, args, lungs, Monitors::ALL.without(fault))?;
        let mut failed: Vec<&str> = rows.iter().filter(|row| !row.pass).map(|row| row.fault).collect();
        failed.dedup();
        if failed.is_empty() {
            unnoticed.push(id);
        }
        table.row(vec![Cell::text(id), Cell::text(failed.join("; "))]);
    }
    args.output.table(&table);
    if !unnoticed.is_empty() {
        bail!("nothing fails without {}: a monitor that nobody misses proves nothing", unnoticed.join(", "));
    }
    Ok(())
}

fn nominal(args: &Args, lungs: &[BenchConfig], breaths: u32) -> anyhow::Result<()> {
    let each = breaths.div_ceil(lungs.len() as u32);
    let alarms = false_alarms(lungs, each, &sound_pid()?, &Watch::new(&|_, _| (), stop()))?;
    for (lung, fault) in &alarms {
        args.output.line(&format!("{lung}: {}", fault.alarm().text));
    }
    if !alarms.is_empty() {
        bail!("{} false alarms in {breaths} breaths", alarms.len());
    }
    args.output.line(&format!("no alarm in {breaths} breaths"));
    Ok(())
}

fn named(id: &str) -> anyhow::Result<Fault> {
    let found = ALARMS.iter().find(|alarm| alarm.id == id).map(|alarm| alarm.fault);
    found.ok_or_else(|| {
        let all: Vec<&str> = ALARMS.iter().map(|alarm| alarm.id).collect();
        anyhow!("no monitor is called {id}: there are {}", all.join(", "))
    })
}

fn table(rows: &[FaultRow]) -> Table {
    let mut table = Table::new(
        "Faults; times in ms, pressures in cmH2O",
        &["fault", "lung", "monitor", "found", "action", "peak", "allowed", "back at PEEP", "pass"],
    );
    let time = |ms: Option<u32>| ms.map_or_else(|| Cell::right("-"), |ms| Cell::right(ms.to_string()));
    for row in rows {
        let action = match row.action {
            None => "none",
            Some(Action::Tell) => "tell",
            Some(Action::Pid) => "PID",
            Some(Action::CappedPid) => "capped PID",
            Some(Action::Vent) => "vent",
        };
        table.row(vec![
            Cell::text(row.fault),
            Cell::text(&row.lung),
            Cell::text(row.monitor.join(", ")),
            time(row.detect_ms),
            Cell::text(action),
            Cell::number(row.peak_true, 1),
            Cell::number(row.peak_allowed, 0),
            time(row.back_at_peep_ms),
            Cell::text(if row.pass { "yes" } else { "NO" }),
        ]);
    }
    table
}

fn report(table: Table) -> Report {
    Report {
        title: "Faults and the monitors that find them".into(),
        subtitle: "Every fault on every lung of the virtual bench, alarm limit at 40 cmH2O.".into(),
        sections: vec![Section {
            heading: "Matrix".into(),
            text: "The longest time over the seeds from the fault to the alarm, and the highest true airway pressure after it."
                .into(),
            blocks: vec![Block::Table(table)],
        }],
        provenance: Some(Provenance::new(DEFAULT_PERIOD_US, "faults")),
    }
}
