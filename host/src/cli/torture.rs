//! `trainer torture`: runs random breaths with hostile weights.

use std::path::PathBuf;

use anyhow::bail;

use super::bars::with_bars;
use super::common::stopped;
use super::output::OutputArgs;
use judge::faults::cases::LIMIT;
use judge::faults::torture::Torture;

/// Run random breaths with hostile weights, random lungs and random faults, and check the highest true pressure
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  trainer torture --breaths 100000
  trainer torture --breaths 1000000 --seed 7 --keep torture.json --json result.json
  trainer torture --limit 60

The result does not depend on the number of threads. With --keep, Ctrl-C loses nothing: the same
command continues. The command fails if the true airway pressure exceeds the limit by more than
15 cmH2O.")]
pub struct Args {
    /// Number of breaths
    #[arg(long, default_value_t = 10_000)]
    breaths: u64,
    /// Seed of the lungs, weights and faults
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Pressure limit, cmH2O
    #[arg(long, value_name = "CMH2O", default_value_t = LIMIT, value_parser = super::faults::limit)]
    limit: f32,
    /// File that keeps the progress; an existing file is continued
    #[arg(long, value_name = "FILE")]
    keep: Option<PathBuf>,
    #[command(flatten)]
    output: OutputArgs,
}

pub fn run(args: &Args) -> anyhow::Result<()> {
    let mut torture = match &args.keep {
        Some(file) => Torture::resume(file, args.seed, args.limit)?,
        None => Torture::new(args.seed, args.limit),
    };
    with_bars(|progress| torture.advance(args.breaths, args.keep.as_deref(), progress))?;
    let Torture { breaths, peak_true, worst_run, above_limit, latched, .. } = torture;
    args.output.line(&format!(
        "{breaths} breaths: highest true airway pressure {peak_true:.1} cmH2O (run {worst_run}); \
         {latched} runs ended in the safe state"
    ));
    args.output.finish(&torture)?;
    if stopped() {
        args.output.line("stopped; if started with --keep, the same command continues from here");
    }
    if above_limit > 0 {
        bail!("{above_limit} runs exceeded {} cmH2O", torture.bound());
    }
    Ok(())
}
