//! `trainer farm`: several ventilators at once.

use std::path::PathBuf;
use std::time::Duration;

use anyhow::bail;
use serde::Serialize;
use shared::breath::PAPER_PIPS;

use super::commission::configured;
use crate::args::controller::learned;
use crate::args::key::KeyArgs;
use crate::args::settings::SettingsArgs;
use crate::args::waveforms::pips;
use crate::command::bounds::{MOST, some, within};
use crate::command::{Command, Context, Makes, Output, OutputArgs};
use device::simulated::MOST_PACE;
use learn::pipeline::commission::{BREATHS_NEEDED, CommissionRun};
use study::farm::description::Farm;
use study::farm::{FarmConfig, FarmResult, FarmRun, FarmStage, Simulators, UnitName, report};

/// Record, train and flash several ventilators, and compare them
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  trainer farm --virtual 10 --out out/farm
  trainer farm farm.toml --out out/farm
  trainer farm farm.toml --out out/farm --until collect
  trainer farm farm.toml --out out/farm --recalibrate

farm.toml, here of two units:
  [[unit]]
  port = \"/dev/ttyACM0\"
  lung = \"R20C20\"
  note = \"new valve in October\"
  sensor_gain = 1.02
  [[unit]]
  name = \"spare\"
  bench = \"R50C10\"
  [band]
  dead_time_ms = 4

A unit has a port or, as a device in this process, a bench: a name or a TOML file beside farm.toml.
The lung is the test lung at the unit. sensor_gain is the change of the sensor's reading per change
of the pressure, measured with a manometer before the unit was calibrated. Units are 1, 2 and so on
unless they have names.

All units are recorded at once. Before that, the zero of each pressure sensor is measured with the
lung open to the room. A unit that fails never stops the rest; one that drops out continues where it
was, and so does a farm that was stopped or killed, by the same command. Calibrations are stored on
the devices, and so are the weights, which are read back. A unit that deviates from the range of the
other units by more than [band] says is named.

The folder then has the recordings, simulators and controllers of all units, and report.html.")]
pub struct Args {
    /// Description of the farm
    #[arg(
        value_name = "FILE.toml",
        required_unless_present = "virtual_units",
        conflicts_with = "virtual_units"
    )]
    file: Option<PathBuf>,
    /// A farm of this many devices in this process, which differ, with the paper's nine lungs in turn
    #[arg(long = "virtual", value_name = "N", value_parser = within::<u32>(1, 1000))]
    virtual_units: Option<u32>,
    /// Folder of the farm
    #[arg(long, value_name = "PATH", default_value = "out/farm")]
    out: PathBuf,
    /// The learned controller to start from: a shipped one, or a file as written by `trainer train-family`
    #[arg(long, value_name = "NAME|FILE", default_value = "adult")]
    controller: PathBuf,
    /// Number of breaths to record from each unit
    #[arg(long, value_name = "N", default_value_t = CommissionRun::default().collect.breaths as u32,
        value_parser = within::<u32>(BREATHS_NEEDED as u32, 1_000_000))]
    breaths: u32,
    /// PIPs of every second breath, and of the evaluation, cmH2O
    #[arg(long, value_name = "CMH2O,..", value_delimiter = ',', default_values_t = PAPER_PIPS, value_parser = pips())]
    pips: Vec<f32>,
    /// Fit a simulator for each unit (each), or one for all units with parameters of each (one)
    #[arg(long, value_name = "WHICH", value_enum, hide_possible_values = true, default_value_t = Simulators::Each)]
    simulators: Simulators,
    /// Gradient steps of the controller for the farm
    #[arg(long, value_name = "N", default_value_t = CommissionRun::default().train.iterations, value_parser = some())]
    farm_iterations: usize,
    /// Gradient steps of each unit's own controller
    #[arg(long, value_name = "N", default_value_t = CommissionRun::default().train.iterations, value_parser = some())]
    iterations: usize,
    /// Unscored breaths before the scored ones of the evaluation
    #[arg(long, value_name = "N", default_value_t = 10, value_parser = within::<usize>(0, MOST))]
    breaths_of_learning: usize,
    /// The last stage to run: contact, collect, fit, train, crosswise or flash
    #[arg(long, value_name = "STAGE", value_enum, hide_possible_values = true, default_value_t = FarmStage::Flash)]
    until: FarmStage,
    /// Measure every unit again, store the calibrations, and show how they have changed
    #[arg(long)]
    recalibrate: bool,
    /// Accept that the device of this unit was replaced or erased
    #[arg(long, value_name = "UNIT")]
    adopt: Vec<UnitName>,
    /// Time to wait for a unit that does not answer, s
    #[arg(long, value_name = "SECONDS", default_value_t = 30, value_parser = within::<u64>(0, 86_400))]
    patience: u64,
    /// Factor by which devices in this process are faster than a chip
    #[arg(long, value_name = "FACTOR", default_value_t = MOST_PACE, value_parser = within::<u32>(1, MOST_PACE))]
    pace: u32,
    /// Seed of all random numbers, and of the virtual units
    #[arg(long, default_value_t = 1)]
    seed: u64,
    #[command(flatten)]
    key: KeyArgs,
    #[command(flatten)]
    output: OutputArgs,
    #[command(flatten)]
    settings: SettingsArgs,
}

/// The content of `--json`.
#[derive(Serialize)]
pub struct Summary {
    seed: u64,
    #[serde(flatten)]
    result: FarmResult,
    /// Mean error of the farm's controller as a share of that of the best single PID.
    of_best_pid: Option<f64>,
}

/// File name of the report in the folder.
const REPORT: &str = "report.html";
/// Scored breaths of each PIP.
const SCORED_BREATHS: usize = 2;

impl Command for Args {
    type Outcome = Summary;

    fn output(&self) -> Output<'_> {
        self.output.makes(Makes::Folder(&self.out))
    }

    fn run(&self, context: &Context<'_>) -> anyhow::Result<Option<Summary>> {
        let farm = match (&self.file, self.virtual_units) {
            (Some(file), _) => Farm::load(file)?,
            (None, Some(count)) => Farm::virtual_units(count, self.seed),
            (None, None) => bail!("name a farm's FILE.toml, or give --virtual N"),
        };
        self.key.check()?;
        let start = learned(&self.controller)?;
        let Some(residual) = start.residual() else { bail!("{} is no learned controller", start.name) };
        let sign = |image| self.key.signed(image).map_err(|error| error.to_string());
        let run = FarmRun {
            farm: &farm,
            config: config(self)?,
            start: (&start.name, residual),
            out: self.out.clone(),
            adopt: self.adopt.clone(),
            recalibrate: self.recalibrate,
            until: self.until,
            patience: Duration::from_secs(self.patience),
            pace: self.pace,
            sign: &sign,
            tell: &|unit, what| eprintln!("unit {unit}: {what}"),
        };
        let result = context.progress(|progress| run.run(progress))?;
        let of_best_pid = print(self, &result, context)?;
        Ok(Some(Summary { seed: self.seed, result, of_best_pid }))
    }

    fn conclude(&self, outcome: Summary, context: &Context<'_>) -> anyhow::Result<()> {
        let units = outcome.result.units.iter().filter(|unit| unit.problem.is_some());
        let behind: Vec<&str> = units.map(|unit| unit.name.as_str()).collect();
        if !behind.is_empty() && !context.stopped() {
            bail!(
                "not all units are done ({} left out): repair them, then run the same command again",
                behind.join(", ")
            );
        }
        Ok(())
    }
}

fn config(args: &Args) -> anyhow::Result<FarmConfig> {
    let run = configured(args.seed, &args.settings, &args.pips, args.breaths, args.iterations)?;
    Ok(FarmConfig {
        run,
        farm_iterations: args.farm_iterations,
        simulators: args.simulators,
        breaths_of_learning: args.breaths_of_learning,
        scored_breaths: SCORED_BREATHS,
    })
}

/// Prints the tables and writes the report; returns the error of the farm's controller as a share of that of the best single PID.
fn print(args: &Args, result: &FarmResult, context: &Context<'_>) -> anyhow::Result<Option<f64>> {
    context.table(&report::units(result));
    let matrix = result.matrix.as_ref().map(report::matrix);
    for table in [report::drift(result), matrix, report::floors(result)].iter().flatten() {
        context.table(table);
    }
    for problem in report::problems(result) {
        context.line(&problem);
    }
    let of_best_pid = report::of_best_pid(result);
    if let Some(share) = of_best_pid {
        context.line(&format!(
            "The farm's controller has {:.1} % of the best single PID's error.",
            100.0 * share
        ));
    }
    context.report(Some(&args.out.join(REPORT)), || Ok(report::report(result)))?;
    Ok(of_best_pid)
}
