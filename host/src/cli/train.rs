//! `trainer train`: rounds of collect, fit and train on one or several benches, or one training on simulators already
//! fitted.

use std::path::{Path, PathBuf};

use anyhow::{Context, bail};
use serde::Serialize;
use shared::breath::{DEFAULT_PERIOD_US, PAPER_PIPS};
use shared::control::pid::PidGains;

use super::common::{BenchArgs, bar, gains, pid, stop, stopped};
use super::output::OutputArgs;
use super::settings_args::SettingsArgs;
use super::stage_bars::StageBars;
use crate::evaluate::seeds;
use crate::pipeline::{self, Folder, MakeSource, PipelineConfig, Round, Stage};
use crate::provenance::git_revision;
use crate::report::{Cell, Table};
use crate::simulator::model::{Architecture, Simulator};
use crate::source::{BenchSource, Source, SourceError};
use crate::train::learned::{Learned, Origin};
use crate::train::{Plant, Progress, TrainConfig, Training, Weighting};

/// Train a controller by back-propagation through learned simulators
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  trainer train --out out/train
  trainer train --lung R50C10 --gains 0.5,5 --rounds 4 --out out/stiff
  trainer train --lung paper --gains 6.1,290,0.2 --out out/all     (one controller for nine lungs)
  trainer train --simulator a.safetensors b.safetensors --gains 6.5,265,0.13 --out out/from-files

Without --simulator it records on the bench, fits and trains, round after round. With it, it
trains once; the last of several simulators is held out and judges the controller. Ctrl-C stops
it; the same command goes on where it was.")]
pub struct Args {
    /// Folder for the controller (controller.safetensors) and what is needed to go on
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    #[command(flatten)]
    bench: BenchArgs,
    /// Train on these simulators, made by `trainer fit`, instead of recording
    #[arg(long, value_name = "FILE", num_args = 1.., conflicts_with_all = ["lung", "bench"])]
    simulator: Vec<PathBuf>,
    /// Gains of the PID that collects first and lies under the residual
    #[arg(long, value_name = "P,I,D", value_parser = gains, default_value = "3,30,0")]
    gains: PidGains,
    /// Scale of the residual, 0 to 1
    #[arg(long, value_name = "L", default_value_t = PipelineConfig::default().lambda)]
    lambda: f32,
    /// Largest residual, percent of the valve
    #[arg(long, value_name = "PERCENT", default_value_t = PipelineConfig::default().authority)]
    authority: f32,
    /// Rounds of collect, fit and train
    #[arg(long, value_name = "N", default_value_t = PipelineConfig::default().rounds)]
    rounds: usize,
    /// Breaths recorded in each round
    #[arg(long, value_name = "N", default_value_t = PipelineConfig::default().collect.breaths)]
    breaths: usize,
    /// Passes over the recording in the first fit
    #[arg(long, value_name = "N", default_value_t = PipelineConfig::default().fit.epochs)]
    epochs: usize,
    /// Gradient steps of each training
    #[arg(long, value_name = "N", default_value_t = TrainConfig::default().iterations)]
    iterations: usize,
    /// Inspirations per gradient step
    #[arg(long, value_name = "N", default_value_t = TrainConfig::default().batch)]
    batch: usize,
    /// Learning rate at the start
    #[arg(long, value_name = "RATE", default_value_t = TrainConfig::default().adam.rate)]
    learning_rate: f32,
    /// Decay of the weights
    #[arg(long, value_name = "D", default_value_t = TrainConfig::default().adam.weight_decay)]
    weight_decay: f32,
    /// With several lungs: make the worst score small rather than the mean; the temperature of the softmax over the
    /// lungs' scores, cmH2O
    #[arg(long, value_name = "T", value_parser = temperature)]
    softmax: Option<f64>,
    /// Simulators of each lung to train on; one more is held out
    #[arg(long, value_name = "N", default_value_t = PipelineConfig::default().ensemble)]
    ensemble: usize,
    /// Factor on errors above the target
    #[arg(long, value_name = "F", default_value_t = TrainConfig::default().overshoot_weight)]
    overshoot_weight: f32,
    /// Waveforms in every batch beside random PIPs, cmH2O
    #[arg(long, value_name = "CMH2O,..", value_delimiter = ',', default_values_t = PAPER_PIPS)]
    pips: Vec<f32>,
    /// Control period, microseconds
    #[arg(long, value_name = "US", default_value_t = DEFAULT_PERIOD_US)]
    period_us: u32,
    #[command(flatten)]
    settings: SettingsArgs,
    /// Seed of everything
    #[arg(long, default_value_t = 1)]
    seed: u64,
    #[command(flatten)]
    output: OutputArgs,
}

/// What `--json` gives.
#[derive(Debug, Serialize)]
struct Summary {
    seed: u64,
    controller: PathBuf,
    validation: f64,
    base: f64,
    improved: bool,
    complete: bool,
    rounds: Vec<Round>,
    train_curve: Vec<Progress>,
}

/// Name of the controller's file in the folder.
const CONTROLLER: &str = "controller.safetensors";

/// Runs the command.
pub fn run(args: &Args) -> anyhow::Result<()> {
    let config = args.config()?;
    let summary = if args.simulator.is_empty() {
        args.rounds_on_bench(&config)?
    } else {
        args.once_on_simulators(&config)?
    };
    args.output.line(&format!(
        "held-out simulator: learned {:.3} cmH2O, PID alone {:.3}\ncontroller: {}",
        summary.validation,
        summary.base,
        summary.controller.display()
    ));
    if !summary.improved {
        args.output.line("The residual did not beat its PID there: the PID alone was kept.");
    }
    if !summary.complete {
        args.output.line("Stopped early: this is the controller so far; the same command goes on from here.");
    }
    args.output.finish(&summary)
}

fn temperature(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(temperature) if temperature > 0.0 && temperature.is_finite() => Ok(temperature),
        _ => Err("a temperature is a number above zero, for instance 0.5".into()),
    }
}

/// A stage of a round (from 0) as people read it.
pub fn stage_name(round: usize, stage: Stage) -> String {
    let stage = match stage {
        Stage::Collect => "collect",
        Stage::Fit => "fit simulators",
        Stage::Train => "train controller",
    };
    format!("round {}: {stage}", round + 1)
}

impl Args {
    fn config(&self) -> anyhow::Result<PipelineConfig> {
        let settings = self.settings.checked(&self.pips)?;
        if settings.rise_time > 0.0 {
            bail!("controllers are trained on the square rise of the paper; leave --rise-time at 0");
        }
        let mut config = PipelineConfig {
            seed: self.seed,
            rounds: self.rounds,
            gains: self.gains,
            lambda: self.lambda,
            authority: self.authority,
            ensemble: self.ensemble,
            ..PipelineConfig::for_period(self.period_us)
        };
        config.collect.breaths = self.breaths;
        config.collect.pips.clone_from(&self.pips);
        config.collect.settings = settings;
        config.fit.epochs = self.epochs;
        config.train = TrainConfig {
            iterations: self.iterations,
            batch: self.batch,
            pips: self.pips.clone(),
            peep: settings.peep,
            rest: settings.expiratory_bias,
            inspiratory_time: settings.inspiratory_time,
            overshoot_weight: self.overshoot_weight,
            weighting: self.softmax.map_or(Weighting::Sum, Weighting::Softmax),
            ..config.train
        };
        config.train.adam.rate = self.learning_rate;
        config.train.adam.weight_decay = self.weight_decay;
        Ok(config)
    }

    fn rounds_on_bench(&self, config: &PipelineConfig) -> anyhow::Result<Summary> {
        let benches = self.bench.benches()?;
        let base = pid(config.gains, config.period_us)?;
        let (settings, period_us) = (config.collect.settings, config.period_us);
        let plants: Vec<_> = benches
            .iter()
            .map(|bench| {
                |seed| -> Result<Box<dyn Source>, SourceError> {
                    Ok(Box::new(BenchSource::new(bench, base.clone(), &settings, period_us, seed)?))
                }
            })
            .collect();
        let sources: Vec<MakeSource<'_>> = plants.iter().map(|plant| plant as MakeSource<'_>).collect();
        let bars = StageBars::default();
        let observer = |round, stage, done, total| bars.show(&stage_name(round, stage), done, total);
        let folder = Folder::new(&self.out);
        let outcome = pipeline::run(config, &sources, Some(&folder), &observer, stop())?;
        bars.finish();
        self.output.table(&rounds_table(&outcome.rounds));
        let controller = self.out.join(CONTROLLER);
        outcome.learned.save(&controller)?;
        Ok(Summary {
            seed: self.seed,
            controller,
            validation: outcome.learned.origin.validation,
            base: outcome.learned.origin.base,
            improved: outcome.rounds.last().is_some_and(|round| round.improved),
            complete: outcome.complete,
            rounds: outcome.rounds,
            train_curve: Vec::new(),
        })
    }

    fn once_on_simulators(&self, config: &PipelineConfig) -> anyhow::Result<Summary> {
        let simulators = self.simulators(config.period_us)?;
        let (held_out, rest) = simulators.split_last().context("name at least one simulator")?;
        // A single simulator judges too, under noise that training does not see.
        let trained_on = if rest.is_empty() { &simulators[..] } else { rest };
        let train = TrainConfig { seed: seeds::training(self.seed, 0), ..config.train.clone() };
        let plant = Plant { trained_on, held_out };
        let mut training = Training::new(config.residual(), &[plant], train, None)?;
        let checkpoint = self.out.join("training.json");
        if let Ok(text) = std::fs::read_to_string(&checkpoint) {
            let earlier = serde_json::from_str(&text)
                .with_context(|| format!("{} is damaged; remove it", checkpoint.display()))?;
            training.resume(earlier);
        }
        let bar = bar("train controller", config.train.iterations);
        let mut train_curve = Vec::new();
        while !stopped() {
            let Some(progress) = training.advance() else { break };
            bar.set_position(progress.iteration as u64);
            train_curve.push(progress);
            super::common::write_json(&checkpoint, &training.checkpoint())?;
        }
        bar.finish();
        let trained = training.finish()?;
        let origin = Origin {
            plant: held_out.plant.clone(),
            seed: self.seed,
            git_revision: git_revision(),
            validation: trained.validation,
            base: trained.base,
        };
        let controller = self.out.join(CONTROLLER);
        Learned { controller: trained.controller, origin }.save(&controller)?;
        Ok(Summary {
            seed: self.seed,
            controller,
            validation: trained.validation,
            base: trained.base,
            improved: trained.improved,
            complete: !stopped(),
            rounds: Vec::new(),
            train_curve,
        })
    }

    fn simulators(&self, period_us: u32) -> anyhow::Result<Vec<Simulator>> {
        let simulators: Vec<Simulator> =
            self.simulator.iter().map(|path| Simulator::load(path)).collect::<Result<_, _>>()?;
        for (path, simulator) in self.simulator.iter().zip(&simulators) {
            check(path, simulator, period_us)?;
        }
        Ok(simulators)
    }
}

/// A simulator that a controller of this period can be trained on.
fn check(path: &Path, simulator: &Simulator, period_us: u32) -> anyhow::Result<()> {
    let timing = simulator.architecture.timing();
    if timing.period_us != period_us {
        let (path, own) = (path.display(), timing.period_us);
        bail!("{path} was fitted at a control period of {own} us; add --period-us {own}");
    }
    let many_lungs = match simulator.architecture {
        Architecture::Hybrid(_) => true,
        Architecture::StateSpace(shape) => shape.lungs,
        Architecture::Stitched(_) => false,
    };
    if many_lungs {
        bail!(
            "{} is a simulator of many lungs, a controller is trained on one: fit a recording of one lung with \
             --architecture state-space",
            path.display()
        );
    }
    if timing.channels != 1 {
        bail!("{} has {} valves to command; a controller commands one", path.display(), timing.channels);
    }
    Ok(())
}

fn rounds_table(rounds: &[Round]) -> Table {
    let mut table = Table::new(
        "Rounds",
        &["round", "breaths", "aborted", "open loop", "PID on simulator", "learned on simulator"],
    );
    for (n, round) in rounds.iter().enumerate() {
        let open_loop = round.open_loop.first().copied().unwrap_or_default();
        table.row(vec![
            Cell::count(n + 1),
            Cell::count(round.breaths),
            Cell::count(round.aborts),
            Cell::number(open_loop.truth.unwrap_or(open_loop.measured), 3),
            Cell::number(round.base, 3),
            Cell::number(round.validation, 3),
        ]);
    }
    table
}

#[cfg(test)]
mod tests {
    use super::*;
    use shared::device::KNOWN_GOOD;

    #[test]
    fn the_default_gains_are_the_known_good_ones() {
        assert_eq!(gains("3,30,0"), Ok(KNOWN_GOOD));
    }
}
