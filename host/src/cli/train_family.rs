//! `trainer train-family`: one controller for all units of a family.

use std::path::PathBuf;

use serde::Serialize;
use shared::control::pid::PidGains;

use super::bars::with_bars;
use super::common::gains;
use super::key_args::KeyArgs;
use super::output::{OutputArgs, write};
use learn::controller::CurvePoint;
use learn::pipeline::Folder;
use learn::pipeline::family::FamilyRun;
use plant::bench::family::Family;

/// Train one controller, which learns from breath to breath, for a whole family of units
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  trainer train-family --out out/adult                       (the shipped controller, adult)
  trainer train-family --family my-machines.toml --units 32 --iterations 3000 --out out/mine
  trainer robust --controller out/adult/controller.safetensors

The command records some units of the family with the known-good PID, fits a physical simulator to
each, draws thousands of units around them, and trains on those over consecutive breaths: the
controller sees the error and the command of earlier breaths. The defaults take about ten minutes on
two idle cores. Ctrl-C stops; the same command continues where it stopped.")]
pub struct Args {
    /// Folder for the controller (controller.safetensors) and the state needed to continue
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Family of plants: a shipped one, or a TOML file
    #[arg(long, value_name = "NAME|FILE", default_value = "adult")]
    family: String,
    /// Units to record and train on; a quarter as many validate
    #[arg(long, value_name = "N", default_value_t = FamilyRun::default().units, value_parser = clap::value_parser!(u32).range(4..))]
    units: u32,
    /// Gains P,I,D of the PID that records [default: 3,30,0]
    #[arg(long, value_name = "P,I,D", value_parser = gains)]
    collector: Option<PidGains>,
    /// Gains P,I,D of the PID under the residual: soft, because it must suit every unit [default: 2.5,60,0.08]
    #[arg(long, value_name = "P,I,D", value_parser = gains)]
    gains: Option<PidGains>,
    /// Gradient steps
    #[arg(long, value_name = "N", default_value_t = FamilyRun::default().train.iterations)]
    iterations: usize,
    /// Inspirations per gradient step
    #[arg(long, value_name = "N", default_value_t = FamilyRun::default().train.batch)]
    batch: usize,
    /// Price of moving the valve after the first 40 % of the inspiration, cmH2O per percent of change per tick
    #[arg(long, value_name = "PRICE", value_parser = price, default_value_t = FamilyRun::default().train.effort_price)]
    effort_price: f32,
    /// Seed of all random numbers
    #[arg(long, default_value_t = 1)]
    seed: u64,
    #[command(flatten)]
    key: KeyArgs,
    #[command(flatten)]
    output: OutputArgs,
}

/// The content of `--json`.
#[derive(Debug, Serialize)]
struct Summary {
    seed: u64,
    controller: PathBuf,
    validation: f64,
    base: f64,
    improved: bool,
    complete: bool,
    train_curve: Vec<CurvePoint>,
}

pub fn run(args: &Args) -> anyhow::Result<()> {
    let family = Family::find(&args.family)?;
    let folder = Folder::new(&args.out);
    let config = args.config(&family);
    let trained = with_bars(|progress| config.run(&family, Some(&folder), progress))?;
    let controller = args.out.join("controller.safetensors");
    trained.learned.save(&controller)?;
    if args.key.key.is_some() {
        let weights = args.out.join("weights.bin");
        write(&weights, &args.key.signed(trained.learned.image()?)?)?;
        args.output.saved(&weights);
    }
    let origin = &trained.learned.origin;
    args.output.line(&format!(
        "validation units, geometric mean over the first breaths: learned {:.3} cmH2O, PID alone {:.3}\ncontroller: {}",
        origin.validation,
        origin.base,
        controller.display()
    ));
    if !trained.complete {
        args.output.line("Stopped early: this is the controller so far. Run the command again to continue.");
    }
    args.output.finish(&Summary {
        seed: args.seed,
        controller,
        validation: origin.validation,
        base: origin.base,
        improved: trained.improved,
        complete: trained.complete,
        train_curve: trained.curve,
    })
}

/// Parses a price.
fn price(text: &str) -> Result<f32, String> {
    match text.parse() {
        Ok(price) if (0.0..f32::INFINITY).contains(&price) => Ok(price),
        _ => Err("write a number of at least 0, such as 0.02".to_owned()),
    }
}

impl Args {
    fn config(&self, family: &Family) -> FamilyRun {
        let mut config = FamilyRun {
            seed: self.seed,
            units: self.units,
            held_out: self.units.div_ceil(4),
            ..FamilyRun::of(family)
        };
        config.collector = self.collector.unwrap_or(config.collector);
        config.gains = self.gains.unwrap_or(config.gains);
        config.train.iterations = self.iterations;
        config.train.batch = self.batch;
        config.train.effort_price = self.effort_price;
        config
    }
}
