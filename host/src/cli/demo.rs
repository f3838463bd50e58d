//! `trainer demo`: the whole pipeline on one lung.

use std::path::PathBuf;

#[cfg(unix)]
use anyhow::ensure;
use shared::breath::{DEFAULT_PERIOD_US, PERIOD_BOUNDS_US};

#[cfg(unix)]
use super::qemu::{IMAGES, board};
use crate::args::bench::BenchArgs;
use crate::args::port::{USUAL, load_and_watch};
use crate::command::bounds::within;
use crate::command::{Command, Context, Makes, Output, OutputArgs, quoted, write};
use learn::controller::{EFFORT_PRICE, TrainConfig};
use learn::pipeline::PipelineConfig;
use plant::prescriptions::Prescriptions;
use score::baselines::Search;
use show::report::Section;
use study::demo::{DemoConfig, DemoSummary, Venue, run as run_demo};

/// Run the whole pipeline on one lung and write a report
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  trainer demo
  trainer demo --seed 2 --out out/seed-2
  trainer demo --bench R50C10 --rounds 4 --out out/stiff
  trainer demo --period-us 30000 --out out/paper
  trainer demo --breathing --out out/breathing
  trainer demo --board --out out/board

With --board the real firmware in QEMU records and compares the breaths, and the weights are
flashed over its link; the table is the same to the last bit. `cargo xtask firmware` builds the
images, `cargo xtask setup` installs QEMU.

Ctrl-C stops the demo; the same command continues where it stopped. Scores are computed from the
true airway pressure, which the bench knows. The PID and the learned controller meet the same sensor
noise, under seeds that neither tuning nor training has used.")]
pub struct Args {
    /// Folder for summary.json, report.html, the recording, simulator, controller and weights image
    #[arg(long, value_name = "PATH", default_value = "out/demo")]
    out: PathBuf,
    #[command(flatten)]
    bench: BenchArgs,
    /// Number of rounds of collect, fit and train
    #[arg(long, value_name = "N", default_value_t = PipelineConfig::default().rounds, value_parser = within::<usize>(1, 100))]
    rounds: usize,
    /// Prescriptions that half of the recordings and of the training are drawn from: bedside, paper, or a TOML file
    #[arg(long, value_name = "NAME|FILE", default_value = "bedside")]
    prescriptions: String,
    /// Train on breathing patients too: efforts pull on the simulated pressure in two of five breaths
    #[arg(long)]
    breathing: bool,
    /// Control period, microseconds
    #[arg(long, value_name = "US", default_value_t = DEFAULT_PERIOD_US, value_parser = within::<u32>(PERIOD_BOUNDS_US.0, PERIOD_BOUNDS_US.1))]
    period_us: u32,
    /// Seed of all random numbers
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Run the breaths on the virtual board in place of this process, with the firmware images in this folder [default: none; without
    /// a folder target/firmware]
    #[cfg(unix)]
    #[arg(long, value_name = "DIR", num_args = ..=1, default_missing_value = IMAGES)]
    board: Option<PathBuf>,
    #[command(flatten)]
    output: OutputArgs,
}

impl Command for Args {
    type Outcome = DemoSummary;

    fn output(&self) -> Output<'_> {
        self.output.makes(Makes::Folder(&self.out))
    }

    fn run(&self, context: &Context<'_>) -> anyhow::Result<Option<DemoSummary>> {
        let mut pipeline = PipelineConfig::for_period(self.period_us);
        (pipeline.seed, pipeline.rounds) = (self.seed, self.rounds);
        if self.breathing {
            pipeline.train = TrainConfig::breathing();
        }
        pipeline.train.effort_price = EFFORT_PRICE;
        pipeline.prescribe(&Prescriptions::find(&self.prescriptions)?);
        let config = DemoConfig {
            bench: self.bench.one()?,
            search: Search::default(),
            pipeline,
            venue: self.venue()?,
        };
        let demo = context.progress(|progress| run_demo(&config, &self.out, progress))?;

        let summary = &demo.summary;
        context.table(&summary.table());
        let gains = summary.pid_gains;
        let [pid_effort, effort] = summary.means().map(|score| score.effort.total_variation);
        context.line(&format!(
            "best PID: P {:.3}, I {:.1}, D {:.4}; mean error {:.3} cmH2O, P only {:.3}, I only {:.3}\n\
         learned:  mean error {:.3} cmH2O, {:.0} % of the best PID's; {:.3} on its learned simulator\n\
         valve:    effort on the plateau {pid_effort:.0} %/s under the PID, {effort:.0} under the learned controller\n\
         simulator: open-loop distance {:.3} cmH2O on held-out breaths",
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
        ));
        if !summary.improved {
            context.line(
                "The residual did not beat its PID on the held-out simulator, so the PID alone was kept.",
            );
        }
        if !demo.outcome.complete {
            context.line("Stopped early: this is the controller so far. Run the command again to continue.");
        }
        let picture = self.out.join("one-inspiration.svg");
        write(&picture, demo.picture()?.as_bytes())?;
        context.saved(&picture);
        context.report(Some(&self.out.join("report.html")), || {
            let mut report = demo.report();
            report.sections.push(self.next());
            Ok(report)
        })?;
        Ok(Some(demo.summary))
    }
}

impl Args {
    fn next(&self) -> Section {
        let controller = quoted(self.out.join("controller.safetensors"));
        let [load, watch] = load_and_watch(self.out.join("weights.bin"), USUAL);
        Section::next(&[
            (
                "Compare the controller with its PID on another lung:",
                format!("trainer evaluate --controller {controller} --bench R50C10 --report evaluation.html"),
            ),
            load,
            watch,
            (
                "Watch simulated devices, each lung with a PID and with a learned controller:",
                "trainer serve --demo".into(),
            ),
        ])
    }

    /// Where the breaths run.
    #[cfg(unix)]
    fn venue(&self) -> anyhow::Result<Venue> {
        let Some(images) = &self.board else { return Ok(Venue::InProcess) };
        ensure!(
            self.period_us == DEFAULT_PERIOD_US,
            "the firmware's control period is {DEFAULT_PERIOD_US} us: omit --period-us with --board"
        );
        Ok(Venue::Board(board(images)))
    }

    #[cfg(not(unix))]
    fn venue(&self) -> anyhow::Result<Venue> {
        Ok(Venue::InProcess)
    }
}
