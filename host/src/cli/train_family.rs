//! `trainer train-family`: one controller for all units of a family.

use std::path::PathBuf;

use anyhow::Context as _;
use shared::control::pid::PidGains;

use super::train::{ResultArgs, Summary};
use crate::args::controller::learned;
use crate::args::gains::{format_gains, gains};
use crate::command::bounds::{some, within};
use crate::command::{Command, Context, Makes, Output};
use data::workspace::Workspace;
use learn::pipeline::family::FamilyRun;
use plant::bench::family::Family;

/// Train one controller for a whole family of units
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  trainer train-family --out out/adult                                       (the shipped adult)
  trainer train-family --out out/neonate --family neonate --ripple 0.4 --margin-price 4 --iterations 16000
                                                                             (the shipped neonate)
  trainer train-family --out out/blower --family blower --start-from adult --ripple 0.4 --margin-price 4 --iterations 16000
                                                                             (the shipped blower)
  trainer train-family --family my-machines.toml --units 32 --iterations 3000 --out out/mine
  lab robust --controller out/adult/controller.safetensors

The command records some units of the family with the known-good PID at the prescriptions, fits a
physical simulator to each, draws thousands of units around them, and trains on those over
consecutive breaths: the controller sees the error and the command of earlier breaths. The defaults
take about a quarter of an hour on two idle cores. Ctrl-C stops; the same command continues where it
stopped.")]
pub struct Args {
    /// Family of plants: a shipped one, or a TOML file
    #[arg(long, value_name = "NAME|FILE", default_value = "adult")]
    family: String,
    /// What to train for: the family's waveforms (paper), all that is set at the bedside, or a TOML file
    #[arg(long, value_name = "NAME|FILE", default_value = "bedside")]
    prescriptions: String,
    /// Units to record and train on; a quarter as many validate
    #[arg(long, value_name = "N", default_value_t = FamilyRun::default().units, value_parser = within::<u32>(4, 100_000))]
    units: u32,
    /// Gains P,I,D of the PID that records, percent of the valve per cmH2O, cmH2O s and cmH2O/s
    #[arg(long, value_name = "P,I,D", value_parser = gains, default_value = format_gains(&FamilyRun::default().collector))]
    collector: PidGains,
    /// Gains P,I,D of the PID under the residual, percent of the valve per cmH2O, cmH2O s and cmH2O/s; soft, because it must suit every unit
    /// [default: the family's soft PID or, if it has none, that of adults]
    #[arg(long, value_name = "P,I,D", value_parser = gains)]
    gains: Option<PidGains>,
    /// Trained controller to start from, over the PID under it: a shipped one or a file; the steps begin at half of the rate
    #[arg(long, value_name = "NAME|FILE")]
    start_from: Option<PathBuf>,
    /// Gradient steps
    #[arg(long, value_name = "N", default_value_t = FamilyRun::default().train.iterations, value_parser = some())]
    iterations: usize,
    /// Inspirations per gradient step
    #[arg(long, value_name = "N", default_value_t = FamilyRun::default().train.batch, value_parser = within::<usize>(1, 65_536))]
    batch: usize,
    /// Price of moving the valve after the first 40 % of the inspiration, cmH2O per percent of change per tick
    #[arg(long, value_name = "PRICE", default_value_t = FamilyRun::default().train.effort_price, value_parser = within::<f32>(0.0, 1e6))]
    effort_price: f32,
    /// Largest amplitude of a ripple late in the inspiration, in the pressure or in its reading, cmH2O: it trains for stability margins
    #[arg(long, value_name = "CMH2O", default_value_t = FamilyRun::default().train.ripple, value_parser = within::<f32>(0.0, 1e6))]
    ripple: f32,
    /// Price of stability margins: of a sensitivity of the loop that is 1 above its bound, cmH2O
    #[arg(long, value_name = "PRICE", default_value_t = FamilyRun::default().train.margin_price, value_parser = within::<f32>(0.0, 1e6))]
    margin_price: f32,
    #[command(flatten)]
    result: ResultArgs,
}

impl Command for Args {
    type Outcome = Summary;

    fn output(&self) -> Output<'_> {
        self.result.output.makes(Makes::Folder(&self.result.out))
    }

    fn run(&self, context: &Context<'_>) -> anyhow::Result<Option<Summary>> {
        self.result.check_key()?;
        let family = Family::find(&self.family)?;
        let folder = Workspace::new(&self.result.out);
        let config = self.config(&family)?;
        let trained = context.progress(|progress| config.run(&family, Some(&folder), progress))?;
        let summary = self.result.saved(&trained, Vec::new(), context)?;
        summary.show("validation units, geometric mean over the first breaths", context);
        Ok(Some(summary))
    }
}

impl Args {
    fn config(&self, family: &Family) -> anyhow::Result<FamilyRun> {
        let prescriptions = family.prescriptions(&self.prescriptions)?;
        let mut config = FamilyRun {
            seed: self.result.seed,
            units: self.units,
            held_out: self.units.div_ceil(4),
            collector: self.collector,
            ..FamilyRun::of(family, &prescriptions)
        };
        if let Some(path) = &self.start_from {
            let start = learned(path)?;
            let residual = start.residual().expect("a weights image contains a residual");
            config.start_from(residual).with_context(|| path.display().to_string())?;
        }
        config.gains = self.gains.unwrap_or(config.gains);
        config.train.iterations = self.iterations;
        config.train.batch = self.batch;
        config.train.effort_price = self.effort_price;
        config.train.ripple = self.ripple;
        config.train.margin_price = self.margin_price;
        Ok(config)
    }
}
