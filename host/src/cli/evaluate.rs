//! `trainer evaluate`: scores of a controller on a bench, a learned one beside its PID.

use std::path::PathBuf;
use std::sync::{Mutex, PoisonError};

use anyhow::{Context, bail};
use serde::Serialize;
use shared::breath::PAPER_PIPS;
use shared::control::Controller;
use shared::control::pid::PidGains;

use super::common::{self, BenchArgs, bar, stop, stopped};
use super::comparison::{Comparison, Pair, WaveformPair};
use super::controller_args::{Chosen, ControllerArgs, format_gains};
use super::output::OutputArgs;
use super::plant_args::PlantArgs;
use super::port_args::{self, PortArgs};
use super::settings_args::SettingsArgs;
use data::provenance::Provenance;
use judge::evaluate::{BreathTrace, Plan, Score, evaluate, evaluate_source, trace};
use plant::bench::BenchConfig;
use progress::Watch;
use show::report::{Block, Plot, Report, Section, Series, Style};
use ventilator::{PlantSource, Reseed};

/// Score a controller on the bench, a learned one beside its PID under the same noise
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  trainer evaluate --gains 2,30,0.01 --lung R5C50
  trainer evaluate --controller controller.safetensors --lung R20C20 --report evaluation.html
  trainer evaluate --weights weights.bin --port tcp:localhost:5555
  trainer evaluate --controller controller.safetensors --plant tcp:localhost:7000
  trainer evaluate --weights weights.bin --against 2.5,25,0.02 --lung iso-05 --seed 7 --json -

The score is the mean absolute error over the inspiration, in cmH2O, of the true airway pressure,
which only a bench knows; with --plant the true one if the plant tells it, with --port the
measured one. A learned controller is compared with the PID underneath it, or with --against. On a
device (--port) the weights are uploaded unless they run there already.")]
pub struct Args {
    #[command(flatten)]
    controller: ControllerArgs,
    /// PID to compare a learned controller with, in place of its own
    #[arg(long, value_name = "P,I,D", value_parser = common::gains, conflicts_with = "gains")]
    against: Option<PidGains>,
    #[command(flatten)]
    bench: BenchArgs,
    #[command(flatten)]
    port: PortArgs,
    #[command(flatten)]
    plant: PlantArgs,
    /// PIPs of the waveforms, cmH2O
    #[arg(long, value_name = "CMH2O,..", value_delimiter = ',', default_values_t = PAPER_PIPS)]
    pips: Vec<f32>,
    /// Scored breaths per waveform and noise sequence
    #[arg(long, value_name = "N", default_value_t = Plan::default().breaths)]
    breaths: usize,
    #[command(flatten)]
    settings: SettingsArgs,
    /// Seed of the sensor noise
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Write figures and curves as an HTML report
    #[arg(long, value_name = "FILE.html")]
    report: Option<PathBuf>,
    #[command(flatten)]
    output: OutputArgs,
}

/// What `--json` gives.
#[derive(Debug, Serialize)]
struct Summary {
    seed: u64,
    #[serde(skip_serializing_if = "Option::is_none")]
    lung: Option<String>,
    #[serde(skip_serializing_if = "Option::is_none")]
    bench: Option<PathBuf>,
    #[serde(skip_serializing_if = "Option::is_none")]
    port: Option<String>,
    #[serde(skip_serializing_if = "Option::is_none")]
    plant: Option<String>,
    controller: String,
    weights_id: Option<String>,
    gains: PidGains,
    period_us: u32,
    breaths: usize,
    #[serde(flatten)]
    comparison: Comparison,
}

/// Where breaths are run.
enum Ventilator {
    Bench(Box<BenchConfig>),
    /// A device at a port, or somebody else's plant.
    Source(Box<Mutex<dyn Reseed + Send>>),
}

/// What runs: the ventilator, the PID and the learned controller.
struct Setup {
    ventilator: Ventilator,
    /// Which pressure is scored.
    pressure: &'static str,
    pid: Controller,
    chosen: Chosen,
    plan: Plan,
}

impl Setup {
    fn new(args: &Args) -> anyhow::Result<Self> {
        let plant = args.plant.connect()?;
        let chosen = args.controller.chosen(plant.as_ref())?;
        let gains = args.against.unwrap_or(chosen.gains());
        let plan = Plan {
            period_us: chosen.period_us,
            pips: args.pips.clone(),
            breaths: args.breaths,
            settings: args.settings.checked(&args.pips)?,
            ..Plan::evaluation(args.seed)
        };
        let pressure = match (&args.port.port, &plant) {
            (Some(_), _) => "measured airway pressure",
            (None, Some(_)) => "airway pressure, the true one if the plant tells it",
            (None, None) => "true airway pressure, which only the bench knows",
        };
        let ventilator = match (&args.port.port, plant) {
            (Some(address), _) => {
                let source = port_args::source(address, &chosen, plan.seeds[0])?;
                Ventilator::Source(Box::new(Mutex::new(source)))
            }
            (None, Some(link)) => {
                let controller = chosen.controller.clone();
                let source = PlantSource::new(link, controller, chosen.period_us, plan.seeds[0]);
                Ventilator::Source(Box::new(Mutex::new(source)))
            }
            (None, None) => Ventilator::Bench(Box::new(args.bench.one()?)),
        };
        Ok(Self { ventilator, pressure, pid: common::pid(gains, chosen.period_us)?, plan, chosen })
    }

    /// Name of what breathes.
    fn plant(&self) -> String {
        match &self.ventilator {
            Ventilator::Bench(bench) => bench.name.clone(),
            Ventilator::Source(source) => source.lock().unwrap_or_else(PoisonError::into_inner).plant(),
        }
    }

    /// The learned controller, if there is one.
    fn learned(&self) -> Option<&Controller> {
        self.chosen.weights_id.as_ref().map(|_| &self.chosen.controller)
    }

    /// Scores waveform by waveform, so that Ctrl-C leaves those that are done.
    fn compare(&self) -> anyhow::Result<Comparison> {
        let bar = bar("evaluating, waveforms", self.plan.pips.len());
        let mut waveforms = Vec::with_capacity(self.plan.pips.len());
        for pip in self.plan.pips.iter().copied().take_while(|_| !stopped()) {
            let pid = self.score("PID", &self.pid, pip)?;
            let learned = self.learned().map(|controller| self.score("learned controller", controller, pip));
            waveforms.push(WaveformPair { pip, pair: Pair { pid, learned: learned.transpose()? } });
            bar.inc(1);
        }
        bar.finish_and_clear();
        Ok(Comparison::new(waveforms))
    }

    fn score(&self, name: &str, controller: &Controller, pip: f32) -> anyhow::Result<Score> {
        let plan = Plan { pips: vec![pip], ..self.plan.clone() };
        let evaluation = match &self.ventilator {
            Ventilator::Bench(bench) => evaluate(bench, controller, &plan),
            Ventilator::Source(source) => {
                let mut source = source.lock().unwrap_or_else(PoisonError::into_inner);
                evaluate_source(&mut *source, controller, &plan, &Watch::new(&|_, _| (), stop()))
            }
        };
        Ok(evaluation.with_context(|| format!("{name}, PIP {pip} cmH2O"))?.mean)
    }
}

/// Runs the command.
pub fn run(args: &Args) -> anyhow::Result<()> {
    let setup = Setup::new(args)?;
    let comparison = setup.compare()?;
    if comparison.waveforms.is_empty() {
        bail!("stopped before the first waveform was complete");
    }
    let title =
        format!("{} on {}: errors of the {}, cmH2O", setup.chosen.name, setup.plant(), setup.pressure);
    args.output.table(&comparison.table(&title));
    if stopped() {
        args.output.line("stopped: the waveforms run so far");
    }
    if let Some(path) = &args.report {
        report(args, &setup, &comparison)?.save(path)?;
        args.output.line(&format!("saved {}", path.display()));
    }
    args.output.finish(&Summary {
        seed: args.seed,
        lung: match (&setup.ventilator, &args.bench.bench) {
            (Ventilator::Bench(bench), None) => Some(bench.name.clone()),
            _ => None,
        },
        plant: args.plant.plant.as_ref().map(ToString::to_string),
        port: args.port.port.as_ref().map(ToString::to_string),
        bench: args.bench.bench.clone(),
        controller: setup.chosen.name.clone(),
        weights_id: setup.chosen.weights_id.clone(),
        gains: setup.pid.pid().gains(),
        period_us: setup.plan.period_us,
        breaths: setup.plan.breaths,
        comparison,
    })
}

fn report(args: &Args, setup: &Setup, comparison: &Comparison) -> anyhow::Result<Report> {
    let mut sections = vec![Section {
        heading: "Figures".into(),
        text: format!(
            "Means over {} breaths under each of {} noise sequences; PID {}. Errors are those of the {}.",
            setup.plan.breaths,
            setup.plan.seeds.len(),
            format_gains(&setup.pid.pid().gains()),
            setup.pressure
        ),
        blocks: vec![Block::Table(comparison.table(""))],
    }];
    if let Ventilator::Bench(bench) = &setup.ventilator {
        for waveform in &comparison.waveforms {
            sections.push(curves(setup, bench, waveform.pip)?);
        }
    }
    Ok(Report {
        title: "Evaluation".into(),
        subtitle: format!("{} on {}", setup.chosen.name, setup.plant()),
        sections,
        provenance: Some(Provenance {
            seed: args.seed,
            plant: setup.plant(),
            plant_parameters: match &setup.ventilator {
                Ventilator::Bench(bench) => bench.to_toml(),
                Ventilator::Source(_) => String::new(),
            },
            settings: serde_json::to_value(&setup.plan)?,
            weights_id: setup.chosen.weights_id.clone().unwrap_or_default(),
            ..Provenance::new(setup.plan.period_us, "trainer evaluate")
        }),
    })
}

/// One breath of a waveform: pressures and valves.
fn curves(setup: &Setup, bench: &BenchConfig, pip: f32) -> anyhow::Result<Section> {
    let seed = setup.plan.seeds.first().copied().unwrap_or_default();
    let run = |controller| trace(bench, controller, &setup.plan.waveform(pip), setup.plan.period_us, seed, 1);
    let mut traces = vec![("PID", run(&setup.pid)?)];
    if let Some(learned) = setup.learned() {
        traces.push(("learned", run(learned)?));
    }
    let target = points(&traces[0].1, &traces[0].1.target);
    let mut pressure = vec![Series::new("target", Style::Dashed, target)];
    let mut valve = Vec::new();
    for (name, trace) in &traces {
        pressure.push(Series::new(*name, Style::Line, points(trace, &trace.pressure)));
        valve.push(Series::new(*name, Style::Line, points(trace, &trace.u_in)));
    }
    let plot = |title: &str, y_label: &str, series| Plot {
        title: title.to_owned(),
        x_label: "time, s".into(),
        y_label: y_label.to_owned(),
        series,
        ..Plot::default()
    };
    Ok(Section {
        heading: format!("PIP {pip} cmH2O"),
        text: String::new(),
        blocks: vec![Block::PlotRow(vec![
            plot("True airway pressure", "pressure, cmH2O", pressure),
            plot("Inspiratory valve", "command, percent", valve),
        ])],
    })
}

fn points(trace: &BreathTrace, values: &[f64]) -> Vec<(f64, f64)> {
    trace.time_s.iter().copied().zip(values.iter().copied()).collect()
}
