//! `trainer tune-pid`: searches the best P, I, PI and PID controllers per lung, and over all lungs.

use std::path::Path;

use anyhow::ensure;
use serde::Serialize;
use shared::breath::{PAPER_PIPS, PERIOD_BOUNDS_US};
use shared::control::Controller;
use shared::control::pid::{Pid, PidGains};

use crate::args::bench::BenchesArgs;
use crate::args::gains::format_gains;
use crate::args::plant::{PlantArgs, period_us};
use crate::args::settings::SettingsArgs;
use crate::args::shards::{ShardArgs, ShardFolderArgs};
use crate::args::waveforms::pips;
use crate::command::bounds::{some, within};
use crate::command::{Command, Context, OutFile, Output, OutputArgs};
use data::kind::Kind;
use data::provenance::Provenance;
use plant::bench::BenchConfig;
use score::baselines::{
    Best, Candidate, FAULT_SCORE, Grid, LungResult, PidKind, PidSearch, Search, TuneResult, tune_pid,
};
use score::evaluate::{Ground, Plan, SourceGround, at_pips};
use show::report::{Block, Cell, HeatMap, Report, Section, Table};
use ventilator::PlantSource;

/// Search for the best P, I, PI and PID controllers for lungs
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  trainer tune-pid --bench R20C20
  trainer tune-pid --bench R5C50 --bench R50C10 --report tuned.html
  trainer tune-pid --bench paper --grid authors --json tuned.json
  trainer tune-pid --plant tcp:localhost:7000 --grid coarse
  trainer tune-pid --bench paper --shard 3/9 --out out/pids   # each task, then:
  trainer tune-pid --bench paper --merge --out out/pids

Gains are P in percent per cmH2O, I in percent per cmH2O and second, D in percent per cmH2O/s.
Ctrl-C ends the search with the best gains found so far.

A shard searches some of the lungs, and keeps those that are complete after Ctrl-C. The merge adds
the search for the best PID over all lungs.")]
pub struct Args {
    #[command(flatten)]
    benches: BenchesArgs,
    #[command(flatten)]
    plant: PlantArgs,
    /// Points to search: `fine`, screened on few breaths first; `coarse`, an eighth of them over the same range, for a slow plant;
    /// `exhaustive`, the fine ones in full, without screening; or `authors`, the grid of the paper's authors
    #[arg(long, value_enum, value_name = "NAME", hide_possible_values = true, default_value_t = GridName::Fine)]
    grid: GridName,
    /// PIPs of the waveforms, cmH2O
    #[arg(long, value_name = "CMH2O,..", value_delimiter = ',', default_values_t = PAPER_PIPS, value_parser = pips())]
    pips: Vec<f32>,
    /// Scored breaths per waveform
    #[arg(long, value_name = "N", default_value_t = Plan::default().breaths, value_parser = some())]
    breaths: usize,
    #[command(flatten)]
    settings: SettingsArgs,
    /// Control period, microseconds [default: 1000, or that of the plant]
    #[arg(long, value_name = "US", value_parser = within::<u32>(PERIOD_BOUNDS_US.0, PERIOD_BOUNDS_US.1))]
    period_us: Option<u32>,
    /// Seed of the sensor noise
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Write tables and score maps to an HTML report
    #[arg(long, value_name = "FILE.html", value_parser = OutFile::of(Kind::Page))]
    report: Option<OutFile>,
    #[command(flatten)]
    shards: ShardFolderArgs,
    #[command(flatten)]
    output: OutputArgs,
}

/// The grids by name.
#[derive(Clone, Copy, Debug, clap::ValueEnum)]
enum GridName {
    Fine,
    Coarse,
    Exhaustive,
    Authors,
}

/// The content of `--json`.
#[derive(Debug, Serialize)]
pub struct Summary {
    seed: u64,
    plan: Plan,
    #[serde(flatten)]
    result: TuneResult,
}

impl Command for Args {
    type Outcome = Summary;

    fn output(&self) -> Output<'_> {
        self.output.makes(self.shards.makes())
    }

    fn run(&self, context: &Context<'_>) -> anyhow::Result<Option<Summary>> {
        let plant = self.plant.connect()?;
        let search = search(self);
        let plan = Plan {
            period_us: period_us(self.period_us, plant.as_ref())?,
            waveforms: at_pips(&self.pips, &self.settings.checked(&self.pips)?),
            breaths: self.breaths,
            ..Plan::tuning(self.seed)
        };
        if let Some(link) = plant {
            ensure!(
                self.shards.folder().is_none(),
                "a plant behind a link serves one search: leave out --out"
            );
            // Every evaluation sets its own gains.
            let idle = Controller::Pid(Pid::new(PidGains::default(), plan.period_us)?);
            let source = PlantSource::new(link, idle, plan.period_us, self.seed);
            return tune(self, &[SourceGround::new(source)], "", (search, plan), context).map(Some);
        }
        let benches = self.benches.benches()?;
        if let Some((out, shards)) = self.shards.folder() {
            return divided(self, shards, out, &PidSearch { lungs: benches, search, plan }, context);
        }
        tune(self, &benches, &parameters(&benches), (search, plan), context).map(Some)
    }
}

/// Parameters of all lungs, for the report.
fn parameters(benches: &[BenchConfig]) -> String {
    benches.iter().map(BenchConfig::to_toml).collect::<Vec<_>>().join("\n")
}

/// Searches on these lungs, then prints and writes the results.
fn tune<G: Ground>(
    args: &Args,
    lungs: &[G],
    parameters: &str,
    (search, plan): (Search, Plan),
    context: &Context<'_>,
) -> anyhow::Result<Summary> {
    let result = context.progress(|progress| tune_pid(lungs, &search, &plan, progress))?;
    show(args, parameters, (&search, plan), result, context)
}

/// Searches a shard of the lungs; or merges the shards, searches the best PID over all lungs, and prints and writes the results.
fn divided(
    args: &Args,
    shards: &ShardArgs,
    out: &Path,
    work: &PidSearch,
    context: &Context<'_>,
) -> anyhow::Result<Option<Summary>> {
    let Some(known) = shards.divided(work, work.lungs.len() as u64, out, context)? else {
        return Ok(None);
    };
    let result = context.progress(|progress| work.finish(known.sums(), progress))?;
    show(args, &parameters(&work.lungs), (&work.search, work.plan.clone()), result, context).map(Some)
}

/// Prints and writes the results.
fn show(
    args: &Args,
    parameters: &str,
    (search, plan): (&Search, Plan),
    result: TuneResult,
    context: &Context<'_>,
) -> anyhow::Result<Summary> {
    context.table(&table(&result));
    if !result.complete {
        context.line("stopped: the best gains found so far");
    }
    context.report(args.report.as_deref(), || {
        Ok(report(args, &plan, parameters, search, &result, &context.bench_option()))
    })?;
    Ok(Summary { seed: args.seed, plan, result })
}

fn search(args: &Args) -> Search {
    match args.grid {
        GridName::Fine => Search::default(),
        GridName::Coarse => Search { grid: Grid::coarse(), ..Search::default() },
        GridName::Exhaustive => Search { exhaustive: true, ..Search::default() },
        GridName::Authors => Search::authors(),
    }
}

fn table(result: &TuneResult) -> Table {
    let mut table = Table::new("Mean absolute error of the airway pressure, cmH2O", &["lung"]);
    table.header.extend(PidKind::ALL.iter().flat_map(|kind| {
        let gains = match kind {
            PidKind::POnly => "P",
            PidKind::IOnly => "I",
            PidKind::Pi => "P,I",
            PidKind::Pid => "P,I,D",
        };
        [gains.to_owned(), format!("score {}", kind.name())]
    }));
    for lung in &result.lungs {
        table.row(row(&lung.lung, &lung.best));
    }
    if result.lungs.len() > 1 {
        table.row(row("all, by their mean", &result.over_all));
    }
    table
}

fn row(name: &str, best: &Best) -> Vec<Cell> {
    let mut cells = vec![Cell::text(name)];
    let lowest = PidKind::ALL.iter().map(|kind| best.of(*kind).score).fold(f64::INFINITY, f64::min);
    for kind in PidKind::ALL {
        let Candidate { gains, score } = best.of(kind);
        let text = match kind {
            PidKind::POnly => format!("{:.3}", gains.p),
            PidKind::IOnly => format!("{:.2}", gains.i),
            PidKind::Pi => format!("{:.3},{:.2}", gains.p, gains.i),
            PidKind::Pid => format!("{:.3},{:.2},{:.4}", gains.p, gains.i, gains.d),
        };
        cells.push(Cell::right(text));
        cells.push(score_cell(score).best_if(score <= lowest));
    }
    cells
}

fn score_cell(score: f64) -> Cell {
    if score < FAULT_SCORE { Cell::number(score, 3) } else { Cell::right("fault") }
}

fn report(
    args: &Args,
    plan: &Plan,
    parameters: &str,
    search: &Search,
    result: &TuneResult,
    bench: &str,
) -> Report {
    let best = result.over_all.pid;
    let mut overview = vec![Block::Table(table(result))];
    if !result.complete {
        overview.push(Block::Text("The search was stopped early: these are the best gains so far.".into()));
    }
    let mut sections = vec![Section {
        heading: "Best gains".into(),
        text: format!("Best single PID: {} with {:.3} cmH2O.", format_gains(&best.gains), best.score),
        blocks: overview,
    }];
    sections.extend(result.lungs.iter().map(map_section));
    let train = format!("trainer train{bench} --gains {} --out out/controller", format_gains(&best.gains));
    sections.push(Section::next(&[("Learn a controller that adds to this PID:", train)]));
    let plant = result.lungs.iter().map(|lung| lung.lung.clone()).collect::<Vec<_>>().join(", ");
    Report {
        title: "PID search".into(),
        subtitle: plant.clone(),
        sections,
        provenance: Some(Provenance {
            seed: args.seed,
            plant,
            plant_parameters: parameters.to_owned(),
            settings: serde_json::json!({ "search": search, "breaths": args.breaths }),
            ..Provenance::new(plan.period_us, "trainer tune-pid")
        }),
    }
}

/// The score map of one lung. Its gains include zero, which a logarithmic axis cannot show, so both axes are lists.
fn map_section(lung: &LungResult) -> Section {
    let map = &lung.map;
    let finite = |score: &Option<f64>| score.filter(|score| *score < FAULT_SCORE);
    Section {
        heading: format!("Scores of {}", lung.lung),
        text: "Every PI of the grid; a blank cell ended in the safe state or was not run.".into(),
        blocks: vec![Block::HeatMap(HeatMap {
            title: format!("{}: mean absolute error, cmH2O", lung.lung),
            x_label: "I, percent per cmH2O and second".into(),
            y_label: "P, percent per cmH2O".into(),
            x: map.i.iter().map(|i| f64::from(*i)).collect(),
            y: map.p.iter().map(|p| f64::from(*p)).collect(),
            values: map.score.iter().map(|row| row.iter().map(finite).collect()).collect(),
            ..HeatMap::default()
        })],
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use shared::control::pid::PidGains;

    fn best(scores: [f64; 4]) -> Best {
        let [p_only, i_only, pi, pid] =
            scores.map(|score| Candidate { gains: PidGains { p: 1.0, i: 2.0, d: 0.0 }, score });
        Best { p_only, i_only, pi, pid }
    }

    #[test]
    fn a_fault_is_no_score_and_the_best_is_marked() {
        let result = TuneResult {
            lungs: vec![LungResult {
                lung: "R20C20".into(),
                best: best([FAULT_SCORE, 2.0, 1.5, 1.25]),
                map: score::baselines::ScoreMap { p: vec![], i: vec![], score: vec![] },
                complete: true,
            }],
            over_all: best([1.0; 4]),
            complete: true,
        };
        let text = table(&result).to_plain();
        assert!(text.contains("fault") && text.contains("1.250*"), "{text}");
        assert!(!text.contains("all, by their mean"), "one lung needs no mean: {text}");
    }
}
