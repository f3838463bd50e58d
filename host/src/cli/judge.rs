//! `trainer judge`: a verdict on recordings from any ventilator.

mod picture;
mod tables;

use std::path::PathBuf;

use anyhow::{Context as _, ensure};
use serde::Serialize;

use crate::args::map::{MapArgs, load};
use crate::command::bounds::{MOST, not_negative, within};
use crate::command::{Command, Context, Output, OutputArgs};
use verdict::{Band, Judged, Kind, Limits, Verdict, judge};

/// Judge recordings from any ventilator, breath by breath
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  trainer judge first.parquet
  trainer judge CT_AIR.csv NPV_AIR.csv --plots sore-spots
  trainer judge measured.csv --map columns.toml --json verdict.json
  trainer judge first.parquet --accuracy 2,4 --overshoot 2     # fails if a breath violates a limit

Prints the fields of a pressure-control test report and the mean figures for each lung and pair of
settings, the accuracy at the end of inspiration and expiration as ±(A cmH2O + B %), and the sore
spots: for each lung the worst breath of each kind of trouble, the most severe first, with its
likely cause where figures show one. With flow, asynchronies of patient and ventilator follow.
Figures of each breath are in the JSON. docs/JUDGE.md defines them, and says what happens with
missing ticks, missing flows, missing set-points and breaths that are cut short.

Exit status: 0 if every declared limit is kept (or none is declared), 1 if a file cannot be judged,
2 for wrong arguments, 3 if a breath violates a declared limit.")]
pub struct Args {
    /// Recordings: Parquet, the file of a known ventilator or, with --map, a table; each one is judged alone
    #[arg(value_name = "FILE", required = true)]
    files: Vec<PathBuf>,
    #[command(flatten)]
    map: MapArgs,
    /// Judge the measured pressure even if the true one is recorded
    #[arg(long)]
    measured: bool,
    /// Number of sore spots of each file to print and draw
    #[arg(long, value_name = "N", default_value_t = 10, value_parser = within::<usize>(0, MOST))]
    worst: usize,
    /// Draw each printed sore spot's breath into this folder (SVG): target, pressure, commands
    #[arg(long, value_name = "DIR")]
    plots: Option<PathBuf>,
    #[command(flatten)]
    output: OutputArgs,
    // Last, because its heading applies to all options after it.
    #[command(flatten)]
    limits: LimitArgs,
}

/// Declared limits.
#[derive(Debug, clap::Args)]
#[command(next_help_heading = "Limits")]
struct LimitArgs {
    /// Plateau error at most A cmH2O + B % of the target
    #[arg(long, value_name = "A,B")]
    accuracy: Option<Band>,
    /// Distance from PEEP at the end of the expiration at most A cmH2O + B % of PEEP
    #[arg(long, value_name = "A,B")]
    peep_accuracy: Option<Band>,
    /// Highest overshoot, cmH2O
    #[arg(long, value_name = "CMH2O", value_parser = not_negative())]
    overshoot: Option<f64>,
    /// Deepest fall below the target after the first peak, cmH2O
    #[arg(long, value_name = "CMH2O", value_parser = not_negative())]
    undershoot: Option<f64>,
    /// Largest swing of an oscillation (three swings or more), cmH2O
    #[arg(long, value_name = "CMH2O", value_parser = not_negative())]
    oscillation: Option<f64>,
    /// Longest rise time, ms
    #[arg(long, value_name = "MS", value_parser = not_negative())]
    rise: Option<f64>,
    /// Steepest plateau, rising or falling, cmH2O/s
    #[arg(long, value_name = "CMH2O/S", value_parser = not_negative())]
    slope: Option<f64>,
    /// Largest mean absolute error over an inspiration, cmH2O
    #[arg(long, value_name = "CMH2O", value_parser = not_negative())]
    error: Option<f64>,
}

impl LimitArgs {
    fn limits(&self) -> Limits {
        let plain = |limit: Option<f64>| limit.map(|fixed| Band { fixed, percent: 0.0 });
        Limits::default()
            .with(Kind::Plateau, self.accuracy)
            .with(Kind::Baseline, self.peep_accuracy)
            .with(Kind::Overshoot, plain(self.overshoot))
            .with(Kind::Undershoot, plain(self.undershoot))
            .with(Kind::Oscillation, plain(self.oscillation))
            .with(Kind::Rise, plain(self.rise))
            .with(Kind::Slope, plain(self.slope))
            .with(Kind::Error, plain(self.error))
    }
}

/// The content of `--json`.
#[derive(Debug, Serialize)]
pub struct Summary {
    /// Whether no breath violates a declared limit; those in which a limited figure is unknown do not count.
    pass: bool,
    files: Vec<FileVerdict>,
}

#[derive(Debug, Serialize)]
pub struct FileVerdict {
    file: String,
    #[serde(flatten)]
    verdict: Verdict,
}

impl Command for Args {
    type Outcome = Summary;

    /// A breath violates a declared limit.
    const REFUSED: u8 = 3;

    fn output(&self) -> Output<'_> {
        self.output.json()
    }

    fn run(&self, context: &Context<'_>) -> anyhow::Result<Option<Summary>> {
        let limits = self.limits.limits();
        let judged = if self.measured { Judged::Measured } else { Judged::True };
        let mut files = Vec::new();
        for file in &self.files {
            let recording = load(file, &self.map, context)?;
            let name = file.display().to_string();
            let verdict =
                judge(&recording, judged, &limits).with_context(|| format!("cannot judge {name}"))?;
            tables::print(context, &name, &verdict, self.worst);
            if let Some(folder) = &self.plots {
                for path in picture::draw(folder, file, &recording, &verdict, self.worst)? {
                    context.saved(&path);
                }
            }
            files.push(FileVerdict { file: name, verdict });
        }
        let violated = violating_breaths(&files);
        Ok(Some(Summary { pass: violated == 0, files }))
    }

    fn conclude(&self, outcome: Summary, _context: &Context<'_>) -> anyhow::Result<()> {
        let files = &outcome.files;
        let judged: usize = files.iter().map(|file| file.verdict.breaths.len()).sum();
        ensure!(
            outcome.pass,
            "{} of {judged} judged breaths violate a declared limit",
            violating_breaths(files)
        );
        Ok(())
    }
}

fn violating_breaths(files: &[FileVerdict]) -> usize {
    files.iter().map(|file| file.verdict.violating_breaths()).sum()
}
