//! `lab torture`: runs random breaths with hostile weights.

use std::path::PathBuf;

use anyhow::bail;

use host::args::shards::ShardFolderArgs;
use host::command::bounds::within;
use host::command::{Command, Context, Output, OutputArgs};
use trials::faults::cases::LIMIT;
use trials::faults::cases::LIMITS;
use trials::faults::torture::{BREATHS_PER_RUN, Peaks, Summary, Torture};

/// Run hostile weights and random faults, and check the pressure
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  lab torture --breaths 100000
  lab torture --breaths 1000000 --seed 7 --keep torture.json --json result.json
  lab torture --limit 60
  lab torture --breaths 1000000 --shard 3/40 --out out/torture   # each task of 40, then:
  lab torture --breaths 1000000 --merge --out out/torture

The result does not depend on the number of threads. With --keep, Ctrl-C loses nothing: the same
command continues. The command fails if the true airway pressure exceeds the limit by more than
15 cmH2O.")]
pub struct Args {
    /// Number of breaths
    #[arg(long, value_name = "N", default_value_t = 10_000, value_parser = within::<u64>(1, 1_000_000_000))]
    breaths: u64,
    /// Seed of the lungs, weights and faults
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Pressure limit, cmH2O
    #[arg(long, value_name = "CMH2O", default_value_t = LIMIT, value_parser = within::<f32>(LIMITS.0, LIMITS.1))]
    limit: f32,
    /// File that keeps the progress; an existing file is continued
    #[arg(long, value_name = "FILE", conflicts_with = "out")]
    keep: Option<PathBuf>,
    #[command(flatten)]
    shards: ShardFolderArgs,
    #[command(flatten)]
    output: OutputArgs,
}

impl Command for Args {
    type Outcome = Summary;

    fn output(&self) -> Output<'_> {
        self.output.makes(self.shards.makes())
    }

    fn run(&self, context: &Context<'_>) -> anyhow::Result<Option<Summary>> {
        let torture = self.torture();
        let runs = self.breaths.div_ceil(BREATHS_PER_RUN);
        let Some(found) = self.shards.run(&torture, runs, self.keep.as_deref(), context)? else {
            return Ok(None);
        };
        let found = Summary::of(&found);
        let Summary { breaths, peaks: Peaks { peak_true, worst_run, latched, .. }, .. } = found;
        context.line(&format!(
            "{breaths} breaths: highest true airway pressure {peak_true:.1} cmH2O (run {worst_run}); \
         {latched} runs ended in the safe state"
        ));
        if context.stopped() {
            context.line("stopped; if started with --keep, the same command continues from here");
        }
        Ok(Some(found))
    }

    fn conclude(&self, outcome: Summary, _context: &Context<'_>) -> anyhow::Result<()> {
        let above_limit = outcome.peaks.above_limit;
        if above_limit > 0 {
            bail!("{above_limit} runs exceeded {} cmH2O", self.torture().bound());
        }
        Ok(())
    }
}

impl Args {
    fn torture(&self) -> Torture {
        Torture { seed: self.seed, limit: self.limit }
    }
}
