//! `lab bound`: a reference bound per lung and waveform, from commands optimised on a fully known lung.

use anyhow::bail;
use serde::Serialize;
use shared::breath::{DEFAULT_PERIOD_US, PERIOD_BOUNDS_US};

use host::args::bench::BenchesArgs;
use host::args::waveforms::WaveformsArgs;
use host::command::bounds::within;
use host::command::{Command, Context, Makes, Output, OutputArgs};
use plant::bench::BenchConfig;
use score::bound::{Bound, BoundConfig, WaveformBound, bounds, triggering};
use score::breathing::STRENGTHS;
use score::evaluate::{Plan, waveform_name};
use show::report::{Cell, Table};

/// Number of the breath from rest that is searched for prescriptions: one for which the search ends, even where a lung keeps its gas.
const PRESCRIBED_BREATH: u32 = 20;
/// Title of the table.
const TITLE: &str = "Reference bound: smallest mean absolute error of the true airway pressure found, cmH2O";

/// Compute a reference bound: the best commands for a known lung
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  lab bound --bench R20C20
  lab bound --bench R5C50 --bench R50C10 --pips 15,35
  lab bound --bench paper --json bound.json
  lab bound --bench R20C20 --trace --json - | jq '.lungs[0].waveforms[0].trace.u_in'
  lab bound --bench paper --breathing
  lab bound --bench R20C20 --prescriptions bedside --json bound.json

The search knows every parameter of the bench, has no sensor noise and may repeat a breath as often
as it needs. It is a search, not a proof: better commands may exist. Check with --effort 2; where
this was tried, scores improved by less than 1 %. Scores are those of `trainer evaluate`: errors of
the true airway pressure. With --breathing, the search knows each effort in advance, as no
controller can: efforts of 3, 6 and 10 cmH2O. With --prescriptions, the breath is the 20th from rest. Ctrl-C ends the search and prints the waveforms completed so far.")]
pub struct Args {
    #[command(flatten)]
    benches: BenchesArgs,
    #[command(flatten)]
    waveforms: WaveformsArgs,
    /// Control period in microseconds: the shortest time between two changes of the command
    #[arg(long, value_name = "US", default_value_t = DEFAULT_PERIOD_US, value_parser = within::<u32>(PERIOD_BOUNDS_US.0, PERIOD_BOUNDS_US.1))]
    period_us: u32,
    /// Factor on the length of the search; if 2 gives the same result, 1 was enough
    #[arg(long, value_name = "N", default_value_t = BoundConfig::default().effort, value_parser = within::<u32>(1, 100))]
    effort: u32,
    /// Add triggered breaths: each lung also with efforts that start every breath
    #[arg(long, conflicts_with = "prescriptions")]
    breathing: bool,
    /// Time from the beginning of an effort to the breath that it triggers, ms
    #[arg(long, value_name = "MS", default_value_t = BoundConfig::default().trigger_delay_ms, value_parser = within::<u32>(0, 1000))]
    trigger_delay_ms: u32,
    /// Include pressure, target and command of every waveform in the JSON
    #[arg(long)]
    trace: bool,
    /// Seed of the search, and of drawn prescriptions
    #[arg(long, default_value_t = BoundConfig::default().seed)]
    seed: u64,
    #[command(flatten)]
    output: OutputArgs,
}

/// The content of `--json`.
#[derive(Debug, Serialize)]
pub struct Summary {
    search: BoundConfig,
    period_us: u32,
    lungs: Vec<Bound>,
    complete: bool,
}

impl Command for Args {
    type Outcome = Summary;

    fn output(&self) -> Output<'_> {
        self.output.makes(Makes::Experiment)
    }

    fn run(&self, context: &Context<'_>) -> anyhow::Result<Option<Summary>> {
        let search = BoundConfig {
            seed: self.seed,
            effort: self.effort,
            trigger_delay_ms: self.trigger_delay_ms,
            trace: self.trace,
            breath: self.waveforms.prescriptions.is_some().then_some(PRESCRIBED_BREATH),
        };
        let plan = Plan { period_us: self.period_us, ..Plan::default() };
        let plan = self.waveforms.on(plan, self.seed)?;
        let mut benches = self.benches.benches()?;
        if self.breathing {
            benches = breathing(&benches, &plan)?;
        }
        let lungs = context.progress(|progress| bounds(&benches, &plan, &search, progress))?;
        if lungs.iter().all(|lung| lung.waveforms.is_empty()) {
            bail!("stopped before the first waveform was complete");
        }
        context.table(&if self.waveforms.prescriptions.is_some() {
            by_prescription(&lungs)
        } else {
            by_pip(&plan, &lungs)
        });
        if context.stopped() {
            context.line("stopped: only the completed waveforms are shown");
        }
        let complete = lungs.iter().all(|lung| lung.complete);
        Ok(Some(Summary { search, period_us: self.period_us, lungs, complete }))
    }
}

/// Each bench, followed by its patients who trigger every breath.
fn breathing(benches: &[BenchConfig], plan: &Plan) -> anyhow::Result<Vec<BenchConfig>> {
    let mut all = Vec::new();
    for bench in benches {
        all.push(bench.clone());
        for strength in STRENGTHS {
            all.push(triggering(bench, strength, &plan.waveforms[0], plan.period_us)?);
        }
    }
    Ok(all)
}

/// A row for every lung, a column for every PIP.
fn by_pip(plan: &Plan, lungs: &[Bound]) -> Table {
    let pips: Vec<f32> = plan.waveforms.iter().map(|waveform| waveform.pip).collect();
    let mut table = Table::new(TITLE, &["lung"]);
    table.header.extend(pips.iter().map(|pip| waveform_name(*pip, None)));
    table.header.extend(["mean".to_owned(), "spread of starts".to_owned()]);
    for lung in lungs {
        table.row(row(&pips, lung));
    }
    table
}

fn row(pips: &[f32], lung: &Bound) -> Vec<Cell> {
    let mut cells = vec![Cell::text(&lung.lung)];
    cells.extend(pips.iter().map(|pip| {
        let own = lung.waveforms.iter().find(|waveform| waveform.pip.total_cmp(pip).is_eq());
        own.map_or(Cell::right("-"), |waveform| Cell::number(waveform.score.score, 3))
    }));
    cells.push(if lung.complete { Cell::number(lung.mean.score, 3) } else { Cell::right("-") });
    let widest = lung.waveforms.iter().map(|waveform| waveform.spread).fold(0.0, f64::max);
    cells.push(Cell::number(widest, 4));
    cells
}

/// A row for every lung and prescription: too many for columns.
fn by_prescription(lungs: &[Bound]) -> Table {
    let mut table = Table::new(TITLE, &["lung", "waveform", "score", "spread of starts"]);
    let mut row = |lung: &str, waveform: &str, score: Cell, spread: Cell| {
        table.row(vec![Cell::text(lung), Cell::text(waveform), score, spread]);
    };
    for lung in lungs {
        for WaveformBound { pip, settings, score, spread, .. } in &lung.waveforms {
            let name = waveform_name(*pip, settings.as_ref());
            row(&lung.lung, &name, Cell::number(score.score, 3), Cell::number(*spread, 4));
        }
        if lung.complete {
            row(&lung.lung, "mean", Cell::number(lung.mean.score, 3), Cell::right(""));
        }
    }
    table
}

#[cfg(test)]
mod tests {
    use super::*;
    use score::evaluate::{Score, at_pips};
    use shared::settings::Settings;

    fn lung(complete: bool) -> Bound {
        let score = Score { score: 0.75, ..Score::default() };
        Bound {
            lung: "R20C20".into(),
            waveforms: vec![WaveformBound { pip: 15.0, settings: None, score, spread: 0.002, trace: None }],
            mean: score,
            complete,
        }
    }

    #[test]
    fn a_waveform_that_is_missing_shows_and_leaves_no_mean() {
        let plan = |pips| Plan { waveforms: at_pips(pips, &Settings::default()), ..Plan::default() };
        let whole = by_pip(&plan(&[15.0]), &[lung(true)]).to_plain();
        assert_eq!(whole.matches("0.750").count(), 2, "{whole}");
        let part = by_pip(&plan(&[15.0, 35.0]), &[lung(false)]).to_plain();
        assert_eq!((part.matches("0.750").count(), part.matches(" -").count()), (1, 2), "{part}");
    }
}
