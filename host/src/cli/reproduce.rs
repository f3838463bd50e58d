//! `trainer reproduce`: runs the paper's experiments and writes a report.

use std::path::PathBuf;

use clap::ValueEnum;

use super::bars::with_bars;
use super::output::OutputArgs;
use super::shard_args::ShardArgs;
use paper::shards::Shards;
use paper::{Budget, Experiment, Reproduction, headline, lungs_table, run as reproduce};
use plant::bench::BenchConfig;

/// Run the paper's experiments on nine lungs of the virtual bench and write a report
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  trainer reproduce --quick --out out/quick
  trainer reproduce --seed 1 --out out/paper
  trainer reproduce --only unseen --only iso --out out/paper
  trainer reproduce --out out/paper --shard 3/20    # each task of 20, at the same time, then:
  trainer reproduce --out out/paper --merge

Each experiment keeps its result in the folder and reuses the results it finds there, so Ctrl-C
loses nothing: the same command continues. results.json contains all figures; report.html and
results.md show them.

Most experiments need the results of earlier experiments. A shard runs the earlier ones that no
other task has started, and waits for the rest. So start all shards at the same time.")]
pub struct Args {
    /// Folder for all results
    #[arg(long, value_name = "DIR", default_value = "out/reproduce")]
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

pub fn run(args: &Args) -> anyhow::Result<()> {
    let reproduction = Reproduction {
        seed: args.seed,
        budget: if args.quick { Budget::quick() } else { Budget::full() },
        lungs: BenchConfig::paper_lungs(),
        out: args.out.clone(),
        only: if args.only.is_empty() { Experiment::value_variants().to_vec() } else { args.only.clone() },
    };
    if args.shards.divides() {
        let work = Shards(&reproduction);
        if args.shards.divided(&work, work.pieces(), &args.out, &args.output)?.is_none() {
            return Ok(());
        }
    }
    let results = with_bars(|progress| reproduce(&reproduction, progress))?;
    if !results.lungs.is_empty() {
        args.output.table(&lungs_table(&results));
    }
    args.output.line(&headline(&results));
    args.output.line(&format!("report: {}", args.out.join("report.html").display()));
    args.output.finish(&results)
}
