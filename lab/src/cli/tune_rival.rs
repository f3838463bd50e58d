//! `lab tune-rival`: searches the best parameters of a rival for a family or for lungs.

use serde::Serialize;

use crate::args::law::rival_names;
use host::args::bench::benches;
use host::command::{Command, Context, Makes, Output, OutputArgs};
use laws::rivals::Rival;
use laws::rivals::tuning::{Tuned, TuningPlan, tune};
use plant::bench::family::Family;
use show::report::{Cell, Table};

/// Search for the best parameters of a rival from the literature
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  lab tune-rival variable-gain
  lab tune-rival iterative --family my-machines.toml --json tuned.json
  lab tune-rival feed-forward --bench R5C50

variable-gain is a PID with a higher gain on errors outside a dead zone (Hunnekens et al. 2020).
iterative is iterative learning control over a PID: what it adds to the command is learned from the
errors of earlier breaths. feed-forward inverts a model of the valve, the circuit and the lung,
which it identifies from its own breaths, and corrects the rest with a PID. gated is the learned
controller adult with iterative learning over it; a correction that did not make a breath better is
dropped.

The score is the mean absolute error over the first breaths from rest: 3 for variable-gain, 6 for
feed-forward and 20 for iterative and gated, which learn longest. A coarse grid is screened on a few
plants; from its best points the search steps to better neighbours on all of them, with ever smaller
steps. The plants of a family are apart from those of `lab robust`. The values for the family
adult are the defaults of --controller NAME; the printed ones can be tried with --parameters. A
search for a family gives feed-forward the nominal machine of that family, and so do robust and
margins with --family; other commands give it the nominal machine for adults. Ctrl-C ends the search
with the best found so far.")]
pub struct Args {
    /// The rival: variable-gain, iterative, feed-forward or gated
    #[arg(value_name = "NAME", value_parser = rival)]
    rival: Rival,
    /// Family of plants: adult, neonate, blower, or a TOML file
    #[arg(long, value_name = "NAME|FILE", default_value = "adult", conflicts_with = "bench")]
    family: String,
    /// Virtual bench, in place of a family: a lung as in R20C20, `paper` for its nine lungs, or a TOML file; repeat it for more
    #[arg(long, value_name = "LUNG|FILE")]
    bench: Vec<String>,
    #[command(flatten)]
    output: OutputArgs,
}

/// The content of `--json`.
#[derive(Debug, Serialize)]
pub struct Summary {
    rival: &'static str,
    /// Names of the parameters, in the order of the values.
    parameters: Vec<&'static str>,
    runs: usize,
    #[serde(flatten)]
    tuned: Tuned,
}

fn rival(name: &str) -> Result<Rival, String> {
    Rival::find(name).ok_or_else(|| format!("there is no such rival: choose {}", rival_names()))
}

impl Command for Args {
    type Outcome = Summary;

    fn output(&self) -> Output<'_> {
        self.output.makes(Makes::Experiment)
    }

    fn run(&self, context: &Context<'_>) -> anyhow::Result<Option<Summary>> {
        let rival = self.rival;
        let plan = if self.bench.is_empty() {
            TuningPlan::of_family(&Family::find(&self.family)?, rival)
        } else {
            TuningPlan::of_benches(&benches(&self.bench)?, rival)?
        };
        let tuned = context.progress(|progress| tune(rival, &plan, progress))?;
        context.table(&table(rival, &tuned));
        let values: Vec<String> = tuned.values.iter().map(ToString::to_string).collect();
        context.line(&format!("--controller {} --parameters {}", rival.name(), values.join(",")));
        context.line(&format!(
            "mean error {:.3} cmH2O over {} plants and waveforms and {} breaths each{}",
            tuned.score,
            plan.runs(),
            rival.breaths_tuned(),
            first_and_last(&tuned.by_breath)
        ));
        if !tuned.complete {
            context.line("stopped: the best parameters found so far");
        }
        let parameters = rival.parameters().iter().map(|parameter| parameter.name).collect();
        Ok(Some(Summary { rival: rival.name(), parameters, runs: plan.runs(), tuned }))
    }
}

/// The errors of the first and the last breath, as the end of a sentence.
fn first_and_last(by_breath: &[f64]) -> String {
    match by_breath {
        [first, .., last] => format!(": {first:.3} in the first, {last:.3} in the last"),
        _ => String::new(),
    }
}

fn table(rival: Rival, tuned: &Tuned) -> Table {
    let title = format!("{}: best of {} points scored in full", rival.name(), tuned.scored);
    let mut table = Table::new(title, &["parameter", "value", "unit", "meaning"]);
    for (parameter, value) in rival.parameters().iter().zip(&tuned.values) {
        table.row(vec![
            Cell::text(parameter.name),
            Cell::right(value.to_string()),
            Cell::text(parameter.unit),
            Cell::text(parameter.meaning),
        ]);
    }
    table
}
