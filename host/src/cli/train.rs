//! `trainer train`: rounds of collect, fit and train on one or more benches, or a single training on existing
//! simulators.

use std::path::PathBuf;

use anyhow::{anyhow, bail};
use serde::Serialize;
use shared::breath::{PAPER_PIPS, PERIOD_BOUNDS_US};
use shared::control::COMMAND_MAX;
use shared::control::pid::PidGains;
use shared::weights::decode;

use crate::args::bench::BenchArgs;
use crate::args::controller::image_id;
use crate::args::gains::gains;
use crate::args::key::KeyArgs;
use crate::args::plant::{PlantArgs, period_us};
use crate::args::preset::Preset;
use crate::args::settings::SettingsArgs;
use crate::args::waveforms::pips;
use crate::command::bounds::{MOST, some, within};
use crate::command::{Command, Context, Makes, Output, OutputArgs, write};
use data::workspace::Workspace;
use learn::controller::authors::{AuthorsController, ERROR_SPACING_MAX_US};
use learn::controller::learned::Learned;
use learn::controller::{
    ControllerArchitecture, CurvePoint, EFFORT_PRICE, TrainConfig, Trainable, Weighting,
};
use learn::pipeline::commission::BREATHS_NEEDED;
use learn::pipeline::{
    Outcome, PAPER_PERIOD_US, PipelineConfig, PipelineError, Round, TrainedOnce, run_on_benches,
    run_on_plant, train_on_simulators,
};
use learn::simulator::model::Simulator;
use plant::prescriptions::Prescriptions;
use show::report::{Cell, Table};
use ventilator::SharedLink;

/// Train a residual through learned simulators of one or many lungs
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  trainer train --out out/train
  trainer train --bench R50C10 --gains 0.5,5 --rounds 4 --out out/stiff
  trainer train --breathing --gains 7.2,253,0.13 --out out/breathing
  trainer train --plant tcp:localhost:7000 --gains 2,30 --out out/mine
  trainer train --preset paper-30ms --out out/paper
  trainer train --bench paper --gains 6.1,290,0.2 --out out/all     (one controller for nine lungs)
  trainer train --simulator a.safetensors b.safetensors --gains 6.5,265,0.13 --out out/from-files
  trainer train --controller-architecture authors --gains 6.5,265,0.13 --out out/authors

Without --simulator the command records on the bench, fits and trains, round after round. With it,
the command trains once; the last of several simulators is held out and judges the controller.
Ctrl-C stops training; the same command continues where it stopped. With --key, the command also
writes the signed weights image, PATH/weights.bin.

With --breathing, an effort of up to 12 cmH2O pulls on the simulated pressure in two of five
inspirations. Most have begun shortly before the breath; the others begin at any time.

--preset paper-30ms follows the paper's authors: a control period of 30 ms, PEEP 5, their
exploration around their PID, and their simulator with their optimiser. Residual and training remain
ours.

--controller-architecture authors trains their network in the place of ours: running averages of the
last ten errors, a convolution, a rectifier and one output, which lambda scales. It sees nothing
else. Such a controller runs on the host only: `trainer evaluate`, `lab robust` and `lab margins`
accept its file, and no weights image holds it.")]
pub struct Args {
    #[command(flatten)]
    bench: BenchArgs,
    #[command(flatten)]
    plant: PlantArgs,
    /// Train on these simulators, written by `trainer fit`, instead of recording
    #[arg(long, value_name = "FILE", num_args = 1.., conflicts_with_all = ["bench", "plant"])]
    simulator: Vec<PathBuf>,
    /// Use third-party settings for all options that are not given: paper-30ms is those of the paper's authors
    #[arg(long, value_enum, value_name = "NAME", hide_possible_values = true)]
    preset: Option<Preset>,
    /// Gains P,I,D of the PID that records first and lies under the residual, percent of the valve per cmH2O, cmH2O s and cmH2O/s [default: 3,30,0, or those of the preset]
    #[arg(long, value_name = "P,I,D", value_parser = gains)]
    gains: Option<PidGains>,
    /// Network that computes the residual: `ours`, or `authors`, that of the paper's authors, which no device runs
    #[arg(long, value_enum, value_name = "NAME", default_value = "ours", hide_possible_values = true)]
    controller_architecture: ArchitectureName,
    /// With --controller-architecture authors: time between two of the ten errors that the network sees, microseconds
    /// [default: 10000, or the control period if it is longer]
    #[arg(long, value_name = "US", value_parser = within::<u32>(1, ERROR_SPACING_MAX_US))]
    error_spacing_us: Option<u32>,
    /// Scale of the residual, 0 to 1
    #[arg(long, value_name = "SHARE", default_value_t = PipelineConfig::default().lambda, value_parser = within::<f32>(0.0, 1.0))]
    lambda: f32,
    /// Largest residual, percent of the valve
    #[arg(long, value_name = "PERCENT", default_value_t = PipelineConfig::default().authority, value_parser = within::<f32>(0.0, COMMAND_MAX))]
    authority: f32,
    /// Number of rounds of collect, fit and train
    #[arg(long, value_name = "N", default_value_t = PipelineConfig::default().rounds, value_parser = within::<usize>(1, 100))]
    rounds: usize,
    /// Breaths recorded in each round
    #[arg(long, value_name = "N", default_value_t = PipelineConfig::default().collect.breaths, value_parser = within::<usize>(BREATHS_NEEDED, MOST))]
    breaths: usize,
    /// Passes over the recording in the first fit [default: 2500, or 500 with paper-30ms]
    #[arg(long, value_name = "N", value_parser = some())]
    epochs: Option<usize>,
    /// Gradient steps of each training [default: 600, or 1200 with --breathing]
    #[arg(long, value_name = "N", value_parser = some())]
    iterations: Option<usize>,
    /// Inspirations per gradient step
    #[arg(long, value_name = "N", default_value_t = TrainConfig::default().batch, value_parser = within::<usize>(1, 65_536))]
    batch: usize,
    /// Learning rate at the start
    #[arg(long, value_name = "RATE", default_value_t = TrainConfig::default().adam.rate, value_parser = within::<f32>(1e-9, 1.0))]
    learning_rate: f32,
    /// Weight decay
    #[arg(long, value_name = "RATE", default_value_t = TrainConfig::default().adam.weight_decay, value_parser = within::<f32>(0.0, 1.0))]
    weight_decay: f32,
    /// With several lungs: weight the worst score more than the mean; temperature of the softmax over the lungs'
    /// scores, cmH2O
    #[arg(long, value_name = "CMH2O", value_parser = within::<f64>(1e-3, 1e3))]
    softmax: Option<f64>,
    /// Number of simulators per lung to train on; one more is held out
    #[arg(long, value_name = "N", default_value_t = PipelineConfig::default().ensemble, value_parser = within::<usize>(1, 64))]
    ensemble: usize,
    /// Factor on errors above the target
    #[arg(long, value_name = "FACTOR", default_value_t = TrainConfig::default().overshoot_weight, value_parser = within::<f32>(0.0, 1e3))]
    overshoot_weight: f32,
    /// PIPs of the waveforms in every batch, in addition to random PIPs, cmH2O
    #[arg(long, value_name = "CMH2O,..", value_delimiter = ',', default_values_t = PAPER_PIPS, value_parser = pips())]
    pips: Vec<f32>,
    /// Prescriptions that half of the recordings and of the training are drawn from: bedside, a TOML file, or paper for the PIPs and settings
    /// alone [default: bedside; with --pips, --settings or --preset: paper]
    #[arg(long, value_name = "NAME|FILE", conflicts_with_all = ["pips", "settings", "preset"])]
    prescriptions: Option<String>,
    /// Train on breathing patients too: efforts pull on the simulated pressure in two of five breaths
    #[arg(long)]
    breathing: bool,
    /// Control period, microseconds [default: 1000, or that of the plant or the simulators]
    #[arg(long, value_name = "US", value_parser = within::<u32>(PERIOD_BOUNDS_US.0, PERIOD_BOUNDS_US.1))]
    period_us: Option<u32>,
    #[command(flatten)]
    settings: SettingsArgs,
    #[command(flatten)]
    result: ResultArgs,
}

/// The architectures of a controller by name.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
enum ArchitectureName {
    Ours,
    Authors,
}

/// The content of `--json`.
#[derive(Debug, Serialize)]
pub struct Summary {
    seed: u64,
    controller: PathBuf,
    validation: f64,
    base: f64,
    improved: bool,
    complete: bool,
    rounds: Vec<Round>,
    train_curve: Vec<CurvePoint>,
}

impl Summary {
    /// Prints the scores, `on` what they are scored.
    pub fn show(&self, on: &str, context: &Context<'_>) {
        context.line(&format!(
            "{on}: learned {:.3} cmH2O, PID alone {:.3}\ncontroller: {}",
            self.validation,
            self.base,
            self.controller.display()
        ));
        if !self.improved {
            context.line("The residual did not beat its PID there, so the PID alone was kept.");
        }
        if !self.complete {
            context.line("Stopped early: this is the controller so far. Run the command again to continue.");
        }
    }
}

/// Where a training writes its controller, and how it reports it.
#[derive(Debug, clap::Args)]
pub struct ResultArgs {
    /// Folder for the controller (controller.safetensors) and the state needed to continue
    #[arg(long, value_name = "PATH")]
    pub out: PathBuf,
    /// Seed of all random numbers
    #[arg(long, default_value_t = 1)]
    pub seed: u64,
    #[command(flatten)]
    key: KeyArgs,
    #[command(flatten)]
    pub output: OutputArgs,
}

impl ResultArgs {
    /// Checks, before the training, that the key can be read.
    pub fn check_key(&self) -> anyhow::Result<()> {
        self.key.check()
    }

    /// Saves a controller, with its signed weights image if there is a key, and returns its scores.
    pub fn saved(
        &self,
        trained: &TrainedOnce,
        rounds: Vec<Round>,
        context: &Context<'_>,
    ) -> anyhow::Result<Summary> {
        let summary = self.kept(trained, rounds)?;
        if self.key.key.is_some() {
            self.packed(&trained.learned, context)?;
        }
        Ok(summary)
    }

    /// Saves a controller of any architecture and returns its scores.
    fn kept<C: Trainable>(&self, trained: &TrainedOnce<C>, rounds: Vec<Round>) -> anyhow::Result<Summary> {
        let TrainedOnce { learned, improved, curve, complete } = trained;
        let controller = self.out.join(CONTROLLER);
        learned.save(&controller)?;
        Ok(Summary {
            seed: self.seed,
            controller,
            validation: learned.origin.validation,
            base: learned.origin.base,
            improved: *improved,
            complete: *complete,
            rounds,
            train_curve: curve.clone(),
        })
    }

    /// Writes the weights image of a controller, signed if there is a key; returns its path and id.
    pub fn packed(&self, learned: &Learned, context: &Context<'_>) -> anyhow::Result<(PathBuf, String)> {
        let weights = self.out.join(WEIGHTS);
        let image = self.key.signed(learned.image()?)?;
        write(&weights, &image)?;
        context.saved(&weights);
        Ok((weights, image_id(decode(&image)?.id)))
    }
}

/// File name of the controller in the folder.
pub const CONTROLLER: &str = "controller.safetensors";
/// File name of the signed weights image in the folder.
const WEIGHTS: &str = "weights.bin";

impl Command for Args {
    type Outcome = Summary;

    fn output(&self) -> Output<'_> {
        self.result.output.makes(Makes::Folder(&self.result.out))
    }

    fn run(&self, context: &Context<'_>) -> anyhow::Result<Option<Summary>> {
        let plant = self.plant.connect()?;
        let simulators: Vec<Simulator> =
            self.simulator.iter().map(|path| Simulator::load(path)).collect::<Result<_, _>>()?;
        if let Some((first, second)) = alike(&simulators) {
            let [first, second] = [first, second].map(|number| self.simulator[number].display());
            bail!(
                "{first} and {second} are the same simulator: name each one once, since the last one is held out"
            );
        }
        let result = &self.result;
        let config = self.config(self.period_us(plant.as_ref(), &simulators)?)?;
        result.check_key()?;
        let summary = match config.controller {
            ControllerArchitecture::Ours => {
                let (trained, rounds) = self.trained(&config, plant.as_ref(), &simulators, context)?;
                result.saved(&trained, rounds, context)?
            }
            ControllerArchitecture::Authors { .. } => {
                if result.key.key.is_some() {
                    bail!("--key signs weights images, and no image holds the authors' network: omit --key");
                }
                let (trained, rounds) =
                    self.trained::<AuthorsController>(&config, plant.as_ref(), &simulators, context)?;
                result.kept(&trained, rounds)?
            }
        };
        let judge = if simulators.len() == 1 {
            "its own simulator, as none is held out"
        } else {
            "held-out simulator"
        };
        summary.show(judge, context);
        Ok(Some(summary))
    }
}

/// The numbers of two simulators that are the same, if there are any.
fn alike(simulators: &[Simulator]) -> Option<(usize, usize)> {
    let earlier =
        |(number, simulator)| Some((simulators[..number].iter().position(|one| one == simulator)?, number));
    simulators.iter().enumerate().find_map(earlier)
}

impl Args {
    /// The requested control period, or that of the plant, the simulators or the preset.
    fn period_us(&self, plant: Option<&SharedLink>, simulators: &[Simulator]) -> anyhow::Result<u32> {
        let of_simulators = simulators.first().map(|simulator| simulator.architecture.timing().period_us);
        let of_preset = self.preset.map(|Preset::Paper30Ms| PAPER_PERIOD_US);
        match (self.period_us, of_preset) {
            (Some(asked), Some(preset)) if asked != preset => {
                bail!("the preset's control period is {preset} us, not {asked}: omit --period-us or --preset")
            }
            (asked, preset) => period_us(asked.or(preset).or(of_simulators), plant),
        }
    }

    fn config(&self, period_us: u32) -> anyhow::Result<PipelineConfig> {
        let settings = self.settings.for_training(&self.pips)?;
        let preset = match self.preset {
            Some(Preset::Paper30Ms) => PipelineConfig::paper_30ms(),
            None => PipelineConfig::for_period(period_us),
        };
        let mut config = PipelineConfig {
            seed: self.result.seed,
            rounds: self.rounds,
            gains: self.gains.unwrap_or(preset.gains),
            controller: self.controller(period_us)?,
            lambda: self.lambda,
            authority: self.authority,
            ensemble: self.ensemble,
            ..preset
        };
        config.collect.breaths = self.breaths;
        config.collect.pips.clone_from(&self.pips);
        config.collect.settings = settings;
        config.fit.epochs = self.epochs.unwrap_or(config.fit.epochs);
        if self.breathing {
            config.train = TrainConfig::breathing();
        }
        config.train = TrainConfig {
            iterations: self.iterations.unwrap_or(config.train.iterations),
            batch: self.batch,
            pips: self.pips.clone(),
            peep: settings.peep,
            rest: settings.expiratory_bias,
            inspiratory_time: settings.inspiratory_time,
            overshoot_weight: self.overshoot_weight,
            // The paper prices the distance alone.
            effort_price: if self.preset.is_some() { 0.0 } else { EFFORT_PRICE },
            weighting: self.softmax.map_or(Weighting::Sum, Weighting::Softmax),
            ..config.train
        };
        config.train.adam.rate = self.learning_rate;
        config.train.adam.weight_decay = self.weight_decay;
        config.prescribe(&Prescriptions::find(self.prescriptions())?);
        Ok(config)
    }

    /// Name of the prescriptions: those of the bedside, unless other waveforms are asked for.
    fn prescriptions(&self) -> &str {
        let listed = self.preset.is_some() || self.pips != PAPER_PIPS || self.settings.any();
        self.prescriptions.as_deref().unwrap_or(if listed { "paper" } else { "bedside" })
    }

    /// The architecture of the controller.
    fn controller(&self, period_us: u32) -> anyhow::Result<ControllerArchitecture> {
        match (self.controller_architecture, self.error_spacing_us) {
            (ArchitectureName::Ours, None) => Ok(ControllerArchitecture::Ours),
            (ArchitectureName::Ours, Some(_)) => {
                bail!("--error-spacing-us belongs to --controller-architecture authors")
            }
            (ArchitectureName::Authors, None) => Ok(ControllerArchitecture::authors(period_us)),
            (ArchitectureName::Authors, Some(error_spacing_us)) => {
                Ok(ControllerArchitecture::Authors { error_spacing_us })
            }
        }
    }

    /// Trains a controller of the architecture `C`, in rounds or on the simulators.
    fn trained<C: Trainable>(
        &self,
        config: &PipelineConfig,
        plant: Option<&SharedLink>,
        simulators: &[Simulator],
        context: &Context<'_>,
    ) -> anyhow::Result<(TrainedOnce<C>, Vec<Round>)> {
        if simulators.is_empty() {
            self.rounds(config, plant, context)
        } else {
            self.once(config, simulators, context)
        }
    }

    fn rounds<C: Trainable>(
        &self,
        config: &PipelineConfig,
        plant: Option<&SharedLink>,
        context: &Context<'_>,
    ) -> anyhow::Result<(TrainedOnce<C>, Vec<Round>)> {
        let folder = Workspace::new(&self.result.out);
        let outcome = if let Some(link) = plant {
            context.progress(|progress| run_on_plant(config, link, Some(&folder), progress))
        } else {
            let benches = self.bench.benches()?;
            context.progress(|progress| run_on_benches(config, &benches, Some(&folder), progress))
        }?;
        context.table(&rounds_table(&outcome.rounds));
        let improved = outcome.rounds.last().is_some_and(|round| round.improved);
        let Outcome { learned, rounds, complete, .. } = outcome;
        Ok((TrainedOnce { learned, improved, curve: Vec::new(), complete }, rounds))
    }

    fn once<C: Trainable>(
        &self,
        config: &PipelineConfig,
        simulators: &[Simulator],
        context: &Context<'_>,
    ) -> anyhow::Result<(TrainedOnce<C>, Vec<Round>)> {
        let folder = Workspace::new(&self.result.out);
        let trained = context
            .progress(|progress| train_on_simulators(config, simulators, &folder, progress))
            .map_err(|error| match error {
                PipelineError::Simulator { number, reason } => {
                    anyhow!("{} {reason}", self.simulator[number - 1].display())
                }
                other => other.into(),
            })?;
        Ok((trained, Vec::new()))
    }
}

fn rounds_table(rounds: &[Round]) -> Table {
    let mut table = Table::new(
        "Rounds",
        &["round", "breaths", "aborted", "open loop", "PID on simulator", "learned on simulator"],
    );
    for (n, round) in rounds.iter().enumerate() {
        let open_loop = round.open_loop.first().map(|errors| errors.truth.unwrap_or(errors.measured));
        table.row(vec![
            Cell::count(n + 1),
            Cell::count(round.breaths),
            Cell::count(round.aborts),
            open_loop.map_or_else(|| Cell::right("unknown"), |distance| Cell::number(distance, 3)),
            Cell::number(round.base, 3),
            Cell::number(round.validation, 3),
        ]);
    }
    table
}

#[cfg(test)]
mod tests {
    use super::*;
    use learn::simulator::fit::FitConfig;
    use learn::simulator::model::Architecture;
    use shared::device::KNOWN_GOOD;

    fn config(arguments: &[&str]) -> anyhow::Result<PipelineConfig> {
        #[derive(clap::Parser)]
        struct Line {
            #[command(flatten)]
            args: Args,
        }
        let line = ["train", "--out", "run"].iter().chain(arguments);
        let args = <Line as clap::Parser>::try_parse_from(line)?.args;
        args.config(args.period_us(None, &[])?)
    }

    #[test]
    fn the_default_is_the_pipelines_with_the_known_good_gains() {
        let config = config(&[]).unwrap();
        let mut expected = PipelineConfig::default();
        expected.train.effort_price = EFFORT_PRICE;
        expected.prescribe(&Prescriptions::find("bedside").unwrap());
        assert_eq!(config, expected);
        assert_eq!(gains("3,30,0"), Ok(config.gains));
        assert_eq!((config.gains, config.fit.epochs, config.train.iterations), (KNOWN_GOOD, 2500, 600));
    }

    #[test]
    fn listed_waveforms_are_asked_for_by_name_or_by_their_pips_and_settings() {
        let drawn = |arguments: &[&str]| {
            let config = config(arguments).unwrap();
            (config.collect.prescriptions.is_some(), config.train.prescriptions.is_some())
        };
        for listed in [["--prescriptions", "paper"], ["--pips", "20"], ["--settings", "peep=7"]] {
            assert_eq!(drawn(&listed), (false, false), "{listed:?}");
        }
        assert_eq!((drawn(&[]), drawn(&["--breathing"])), ((true, true), (true, true)));
        assert!(config(&["--prescriptions", "bedside", "--pips", "20"]).is_err());
    }

    #[test]
    fn moving_the_valve_has_a_price_except_in_the_settings_of_the_paper() {
        let price = |arguments: &[&str]| config(arguments).unwrap().train.effort_price;
        for priced in [&[][..], &["--breathing"], &["--pips", "20"]] {
            assert_eq!(price(priced).to_bits(), EFFORT_PRICE.to_bits(), "{priced:?}");
        }
        assert_eq!(price(&["--preset", "paper-30ms"]).to_bits(), 0.0_f32.to_bits());
    }

    #[test]
    fn breathing_patients_train_longer_unless_the_steps_are_typed() {
        let train = |arguments: &[&str]| config(arguments).unwrap().train;
        let breathing = TrainConfig { effort_price: EFFORT_PRICE, ..TrainConfig::breathing() };
        assert_eq!(train(&["--breathing", "--prescriptions", "paper"]), breathing);
        assert_eq!((train(&["--breathing"]).iterations, train(&[]).efforts), (1200, None));
        let typed = train(&["--breathing", "--iterations", "9", "--settings", "peep=7"]);
        assert_eq!((typed.iterations, typed.peep.to_bits()), (9, 7.0_f32.to_bits()));
        assert_eq!(typed.efforts, TrainConfig::breathing().efforts);
    }

    #[test]
    fn the_spacing_of_the_authors_errors_is_typed_or_follows_from_the_period() {
        let spacing = |arguments: &[&str]| match config(arguments).unwrap().controller {
            ControllerArchitecture::Authors { error_spacing_us } => error_spacing_us,
            ControllerArchitecture::Ours => 0,
        };
        let authors = ["--controller-architecture", "authors"];
        assert_eq!(spacing(&authors), 10_000);
        assert_eq!(spacing(&[&authors[..], &["--preset", "paper-30ms"]].concat()), 30_000);
        assert_eq!(spacing(&[&authors[..], &["--error-spacing-us", "7000"]].concat()), 7000);
        assert_eq!(spacing(&[]), 0);
        assert!(config(&["--error-spacing-us", "7000"]).is_err());
    }

    /// The numbers are those of section 4 of the paper and of the authors' code.
    #[test]
    fn the_papers_preset_has_the_papers_numbers() {
        let config = config(&["--preset", "paper-30ms"]).unwrap();
        let (settings, explore) = (config.collect.settings, config.collect.exploration.unwrap());
        assert_eq!((config.period_us, settings.peep, settings.rate), (30_000, 5.0, 20.0));
        assert_eq!((settings.inspiratory_time, config.train.inspiratory_time), (1.0, 1.0));
        assert_eq!((config.train.peep, &config.train.pips), (5.0, &config.collect.pips));
        assert_eq!(config.collect.pips, [10.0, 15.0, 20.0, 25.0, 30.0, 35.0]);
        assert_eq!((explore.boundary_probability, explore.boundary_height), (0.15, (0.0, 100.0)));
        assert_eq!(explore.boundary_duration, (0.05, 0.3));
        assert_eq!((explore.triangle_height, explore.triangle_duration), ((-30.0, 30.0), (0.1, 0.5)));
        assert!(matches!(config.architecture, Architecture::Stitched(_)));
        assert_eq!(config.fit, FitConfig::authors());
        assert!((config.gains.p - 3.0).abs() < 1e-6 && (config.gains.i - 4.0 / 0.53).abs() < 1e-5);
    }

    #[test]
    fn what_is_typed_beside_a_preset_has_precedence_and_another_period_is_refused() {
        let config =
            config(&["--preset", "paper-30ms", "--gains", "1,9", "--settings", "peep=7", "--epochs", "3"]);
        let config = config.unwrap();
        assert_eq!((config.gains, config.fit.epochs), (PidGains { p: 1.0, i: 9.0, d: 0.0 }, 3));
        assert_eq!((config.collect.settings.peep, config.train.peep), (7.0, 7.0));
        let refused =
            self::config(&["--preset", "paper-30ms", "--period-us", "1000"]).unwrap_err().to_string();
        assert!(refused.contains("30000 us, not 1000"), "{refused}");
    }
}
