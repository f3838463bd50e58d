//! `lab reproduce`: runs the paper's experiments and writes a report.

use std::path::PathBuf;

use clap::ValueEnum;

use host::args::shards::ShardArgs;
use host::command::{Command, Context, Output, OutputArgs};
use paper::shards::Shards;
use paper::{Budget, Experiment, Reproduction, Results, headline, lungs_table, run as reproduce};
use plant::bench::BenchConfig;

/// Run the paper's experiments on nine lungs and write a report
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  lab reproduce --quick --out out/quick
  lab reproduce --seed 1 --out out/paper
  lab reproduce --only unseen --only iso --out out/paper
  lab reproduce --out out/paper --shard 3/20    # each task of 20, at the same time, then:
  lab reproduce --out out/paper --merge

Each experiment keeps its result in the folder and reuses the results it finds there, so Ctrl-C
loses nothing: the same command continues. results.json contains all figures; report.html and
results.md show them.

Most experiments need the results of earlier experiments. A shard runs the earlier ones that no
other task has started, and waits for the rest. So start all shards at the same time.")]
pub struct Args {
    /// Folder for all results
    #[arg(long, value_name = "PATH", default_value = "out/reproduce")]
    out: PathBuf,
    /// Run shorter versions of the experiments: the same trends in a few minutes
    #[arg(long)]
    quick: bool,
    /// Run only this experiment and those it needs; repeatable [default: all]
    #[arg(long, value_name = "NAME")]
    only: Vec<Experiment>,
    /// Seed of all random numbers
    #[arg(long, default_value_t = 1)]
    seed: u64,
    #[command(flatten)]
    shards: ShardArgs,
    #[command(flatten)]
    output: OutputArgs,
}

impl Command for Args {
    type Outcome = Results;

    fn output(&self) -> Output<'_> {
        self.output.makes(self.shards.makes(&self.out))
    }

    fn run(&self, context: &Context<'_>) -> anyhow::Result<Option<Results>> {
        let reproduction = Reproduction {
            seed: self.seed,
            budget: if self.quick { Budget::quick() } else { Budget::full() },
            lungs: BenchConfig::paper_lungs(),
            out: self.out.clone(),
            only: if self.only.is_empty() {
                Experiment::value_variants().to_vec()
            } else {
                self.only.clone()
            },
        };
        if self.shards.divides() {
            let work = Shards(&reproduction);
            if self.shards.divided(&work, work.pieces(), &self.out, context)?.is_none() {
                return Ok(None);
            }
        }
        let results = context.progress(|progress| reproduce(&reproduction, progress))?;
        if !results.lungs.is_empty() {
            context.table(&lungs_table(&results));
        }
        context.line(&headline(&results));
        context.line(&format!("report: {}", self.out.join("report.html").display()));
        Ok(Some(results))
    }
}
