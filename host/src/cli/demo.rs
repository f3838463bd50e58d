//! `trainer demo`: the main job from end to end on one lung.

use std::path::PathBuf;

#[cfg(unix)]
use anyhow::ensure;
use shared::breath::DEFAULT_PERIOD_US;

use super::bars::with_bars;
use super::common::BenchArgs;
use super::output::OutputArgs;
#[cfg(unix)]
use super::qemu::ImageArgs;
use judge::baselines::Search;
use learn::pipeline::PipelineConfig;
use study::demo::{DemoConfig, Venue, run as run_demo};

/// Run the whole pipeline on one lung: search the best PID, record, fit, train, compare, report
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  trainer demo
  trainer demo --seed 2 --out out/seed-2
  trainer demo --lung R50C10 --rounds 4 --out out/stiff
  trainer demo --period-us 30000 --out out/paper
  trainer demo --board qemu --out out/board

With --board qemu breaths are recorded and compared by the real firmware in QEMU, the weights
flashed over its link; the table is the same to the last bit. The images come from `cargo xtask
firmware`, QEMU from `cargo xtask setup`.

Ctrl-C stops it; the same command goes on where it was. Scores are of the true airway pressure,
which the bench knows; PID and learned controller meet the same noise, under seeds that neither
tuning nor training has seen.")]
pub struct Args {
    /// Folder to write summary.json, report.html, the recording, simulator, controller and weights image to
    #[arg(long, value_name = "DIR", default_value = "out/demo")]
    out: PathBuf,
    #[command(flatten)]
    bench: BenchArgs,
    /// Rounds of collect, fit and train
    #[arg(long, value_name = "N", default_value_t = PipelineConfig::default().rounds)]
    rounds: usize,
    /// Control period, microseconds
    #[arg(long, value_name = "US", default_value_t = DEFAULT_PERIOD_US)]
    period_us: u32,
    /// Seed of everything
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Let a board breathe instead of this process: `qemu` is the virtual one
    #[cfg(unix)]
    #[arg(long, value_name = "BOARD")]
    board: Option<Board>,
    #[cfg(unix)]
    #[command(flatten)]
    images: ImageArgs,
    #[command(flatten)]
    output: OutputArgs,
}

/// Boards to choose from.
#[cfg(unix)]
#[derive(Clone, Copy, Debug, clap::ValueEnum)]
enum Board {
    Qemu,
}

pub fn run(args: &Args) -> anyhow::Result<()> {
    let config = DemoConfig {
        bench: args.bench.one()?,
        search: Search::default(),
        pipeline: PipelineConfig {
            seed: args.seed,
            rounds: args.rounds,
            ..PipelineConfig::for_period(args.period_us)
        },
        venue: args.venue()?,
    };
    let demo = with_bars(|progress| run_demo(&config, &args.out, progress))?;

    let summary = &demo.summary;
    args.output.table(&summary.table());
    let gains = summary.pid_gains;
    args.output.line(&format!(
        "best PID: P {:.3}, I {:.1}, D {:.4}; mean error {:.3} cmH2O, P only {:.3}, I only {:.3}\n\
         learned:  mean error {:.3} cmH2O, {:.0} % of the best PID's; {:.3} on its learned simulator\n\
         simulator: open-loop distance {:.3} cmH2O on held-out breaths\n\
         report: {}",
        gains.p,
        gains.i,
        gains.d,
        summary.mean.pid,
        summary.mean.p_only,
        summary.mean.i_only,
        summary.mean.learned,
        100.0 * summary.ratio(),
        summary.mean.learned_on_simulator,
        summary.open_loop_distance,
        args.out.join("report.html").display()
    ));
    if !summary.improved {
        args.output
            .line("The residual did not beat its PID on the held-out simulator: the PID alone was kept.");
    }
    if !demo.outcome.complete {
        args.output.line("Stopped early: this is the controller so far; the same command goes on from here.");
    }
    args.output.finish(summary)
}

impl Args {
    /// Where to breathe.
    #[cfg(unix)]
    fn venue(&self) -> anyhow::Result<Venue> {
        let Some(Board::Qemu) = self.board else { return Ok(Venue::InProcess) };
        ensure!(
            self.period_us == DEFAULT_PERIOD_US,
            "the firmware's control period is {DEFAULT_PERIOD_US} us; leave out --period-us with --board"
        );
        Ok(Venue::Board(self.images.board()))
    }

    #[cfg(not(unix))]
    fn venue(&self) -> anyhow::Result<Venue> {
        Ok(Venue::InProcess)
    }
}
