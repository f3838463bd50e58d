//! `trainer fit`: learns a simulator from recordings and scores it on held-out breaths.

mod report;
#[cfg(test)]
mod tests;

use std::path::{Path, PathBuf};

use anyhow::Context as _;
use clap::ValueEnum;

use crate::args::preset::Preset;
use crate::command::bounds::{some, within};
use crate::command::{Command, Context, Makes, OutFile, Output, OutputArgs, quoted};
use data::kind;
use data::recording::Recording;
use learn::recipe::{self, HeldOut, Recipe};
use learn::simulator::episode::episodes;
use learn::simulator::open_loop::OpenLoop;
use show::report::{Cell, Section, Table};
use verdict::fit_summary::{FitSummary, RESPONSE_S};

/// Learn a differentiable simulator from recordings
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  trainer fit first.parquet --out simulator.safetensors
  trainer fit first.parquet second.parquet --out simulator.safetensors --report fit.html
  trainer fit slow.parquet --out paper.safetensors --architecture stitched
  trainer fit slow.parquet --out paper.safetensors --preset paper-30ms
  trainer fit air.parquet --hold-out-lung 5:20 --hold-out-lung 50:20 --json -

The open-loop distance is the mean absolute error over the inspiration when recorded commands are
replayed from rest, without pressure feedback. Ctrl-C ends the fit and saves the simulator trained
so far.

A recording that names R and C of its lungs gets one simulator for all of them; --hold-out-lung
keeps a lung out of the fit, to score the simulator on a lung it has never seen. If the recording
has flows, the same breaths are also predicted by classical identification, from the measured flow.")]
pub struct Args {
    /// Recordings of one ventilator; several files are joined
    #[arg(value_name = "FILE.parquet", required = true)]
    data: Vec<PathBuf>,
    /// File to write the simulator to (.safetensors)
    #[arg(long, value_name = "PATH", value_parser = OutFile::of(kind::Kind::Tensors))]
    out: Option<OutFile>,
    /// Use third-party settings, which the recording must match: paper-30ms is those of the paper's authors
    #[arg(long, value_enum, value_name = "NAME", hide_possible_values = true)]
    preset: Option<Preset>,
    /// Model: `state-space`, or `hybrid` (a learned ventilator with a lung of known R and C), both trained open loop on
    /// whole breaths; or `stitched`, the networks of the paper's authors, trained on single steps of about 30 ms
    /// [default: hybrid if the recording names R and C, else state-space; or that of the preset]
    #[arg(long, value_enum, value_name = "NAME")]
    architecture: Option<Kind>,
    /// Passes over the recording [default: enough for 10000 gradient steps, 15000 for hybrid; 500 for stitched]
    #[arg(long, value_name = "N", value_parser = some())]
    epochs: Option<usize>,
    /// Breaths per gradient step [default: 16, or 64 for stitched]
    #[arg(long, value_name = "N", value_parser = within::<u16>(1, u16::MAX))]
    batch: Option<u16>,
    /// State-space and hybrid: number of states [default: 16, or 8 for hybrid]
    #[arg(long, value_name = "N", value_parser = within::<u16>(1, 256))]
    states: Option<u16>,
    /// State-space and hybrid: number of hidden units [default: 64, or 24 for hybrid]
    #[arg(long, value_name = "N", value_parser = within::<u16>(1, 512))]
    hidden: Option<u16>,
    /// State-space and hybrid: number of past command blocks that a step sees [default: 4, or 8 for hybrid]
    #[arg(long, value_name = "N", value_parser = within::<u16>(1, 64))]
    history: Option<u16>,
    /// Hold out every N-th breath of each lung or test run from the fit, to score it
    #[arg(long, value_name = "N", default_value_t = 5, value_parser = within::<u16>(2, u16::MAX))]
    hold_out: u16,
    /// Hold out every breath of the lung with this nominal resistance and compliance, or with this name; repeatable
    #[arg(long, value_name = "R:C|NAME")]
    hold_out_lung: Vec<HeldOut>,
    /// Seed of the initial parameters and the order of breaths
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Write curves and held-out predictions to an HTML report
    #[arg(long, value_name = "FILE.html", value_parser = OutFile::of(kind::Kind::Page))]
    report: Option<OutFile>,
    #[command(flatten)]
    output: OutputArgs,
}

/// The kinds of models.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum Kind {
    StateSpace,
    Hybrid,
    Stitched,
}

impl From<Kind> for recipe::Kind {
    fn from(kind: Kind) -> Self {
        match kind {
            Kind::StateSpace => Self::StateSpace,
            Kind::Hybrid => Self::Hybrid,
            Kind::Stitched => Self::Stitched,
        }
    }
}

impl Command for Args {
    type Outcome = FitSummary;

    fn output(&self) -> Output<'_> {
        self.output.makes(Makes::Experiment)
    }

    fn run(&self, context: &Context<'_>) -> anyhow::Result<Option<FitSummary>> {
        let recording = load(&self.data)?;
        if self.preset == Some(Preset::Paper30Ms) {
            recipe::check_paper_setting(&recording)?;
        }
        let recipe = recipe(self);
        let architecture = recipe.architecture(&recording)?;
        let all = episodes(&recording, architecture.timing());
        let parts = recipe.parts(&all, &recording.provenance.groups)?;
        let fitted =
            context.progress(|progress| recipe.fit(architecture, &recording, &parts.training, progress))?;
        if let Some(path) = &self.out {
            fitted.simulator.save(path)?;
        }
        let summary = FitSummary::new(self.seed, &fitted, &parts, &recording);
        context.table(&table(&summary));
        for line in remarks(&summary) {
            context.line(&line);
        }
        if summary.stopped {
            context.line(&format!("stopped after {} epochs", summary.epochs));
        }
        match &self.out {
            Some(path) => context.saved(path),
            None => context.line("the simulator is not kept: --out FILE.safetensors keeps it"),
        }
        context.report(self.report.as_deref(), || {
            let mut report = report::report(&summary, &fitted, &parts, &recording);
            report.sections.extend(self.out.as_ref().map(|path| next(path)));
            Ok(report)
        })?;
        Ok(Some(summary))
    }
}

fn next(simulator: &Path) -> Section {
    let train = format!("trainer train --simulator {} --out out/controller", quoted(simulator));
    Section::next(&[("Train a controller on this simulator:", train)])
}

fn recipe(args: &Args) -> Recipe {
    let of_preset = args.preset.map(|Preset::Paper30Ms| Kind::Stitched);
    Recipe {
        kind: args.architecture.or(of_preset).map(Into::into),
        epochs: args.epochs,
        batch: args.batch.map(Into::into),
        states: args.states.map(Into::into),
        hidden: args.hidden.map(Into::into),
        history: args.history.map(Into::into),
        hold_out: args.hold_out.into(),
        hold_out_lungs: args.hold_out_lung.clone(),
        seed: args.seed,
    }
}

fn load(files: &[PathBuf]) -> anyhow::Result<Recording> {
    let (first, others) = files.split_first().context("no recording given")?;
    let mut recording = Recording::load(first)?;
    for file in others {
        let more = Recording::load(file)?;
        recording
            .append(&more)
            .with_context(|| format!("cannot join {} to {}", file.display(), first.display()))?;
    }
    Ok(recording)
}

/// Notes below the table.
fn remarks(summary: &FitSummary) -> Vec<String> {
    let mut lines = Vec::new();
    if let Some(classical) = summary.classical_open_loop {
        lines.push(format!(
            "classical identification on the same held-out breaths, from the measured flow: {classical:.3} cmH2O"
        ));
    }
    let rises: Vec<_> = summary.response.iter().map(|rise| format!("{rise:+.2}")).collect();
    let times: Vec<_> = RESPONSE_S.iter().map(|time| format!("{time} s")).collect();
    lines.push(format!(
        "a command 5 percentage points higher changes the predicted pressure by {} cmH2O at {}",
        rises.join(", "),
        times.join(", ")
    ));
    if summary.response.iter().any(|rise| *rise <= 0.0) {
        lines.push(
            "a predicted pressure that does not rise with the command was learned from the recording's controller: \
             the simulator is of no use for another controller (docs/RECORDINGS.md)"
                .to_owned(),
        );
    }
    lines
}

fn table(summary: &FitSummary) -> Table {
    let title = format!(
        "Held-out breaths ({} of {}), mean absolute errors in cmH2O",
        summary.held_out_breaths,
        summary.held_out_breaths + summary.training_breaths
    );
    let mut table =
        Table::new(title, &["breaths", "number", "one step", "open loop, measured", "open loop, true"]);
    for waveform in &summary.waveforms {
        table.row(row(&format!("PIP {}", waveform.pip), waveform.episodes, &waveform.open_loop));
    }
    for group in summary.settings.iter().chain(&summary.groups) {
        table.row(row(&group.group, group.episodes, &group.open_loop));
    }
    let (one_step, measured, truth) = (summary.one_step, summary.open_loop, summary.open_loop_true);
    table.row(row("all", summary.held_out_breaths, &OpenLoop { one_step, measured, truth }));
    for group in &summary.held_out_lungs {
        table.row(row(&format!("{}, lung held out", group.group), group.episodes, &group.open_loop));
    }
    table
}

fn row(name: &str, episodes: usize, errors: &OpenLoop) -> Vec<Cell> {
    let truth = errors.truth.map_or_else(|| Cell::right("unknown"), |distance| Cell::number(distance, 3));
    vec![
        Cell::text(name),
        Cell::count(episodes),
        Cell::number(errors.one_step, 3),
        Cell::number(errors.measured, 3),
        truth,
    ]
}
