//! `trainer evaluate`: scores a controller; compares a learned one with its PID. Another program may offer further controllers.

use std::fmt::Debug;
use std::path::{Path, PathBuf};

use anyhow::bail;
use serde::Serialize;
use shared::control::pid::PidGains;
use shared::settings::Settings;

use super::breathing::{Summary as BreathingSummary, table as breathing_table};
use super::comparison::table;
use crate::args::controller::{Chosen, ControllerArgs};
use crate::args::gains::{format_gains, gains};
use crate::args::port::{USUAL, load_and_watch, source as device_source};
use crate::args::source::SourceArgs;
use crate::args::waveforms::WaveformsArgs;
use crate::command::bounds::{some, within};
use crate::command::{Command, Context, Makes, OutFile, Output, OutputArgs, quoted};
use data::kind::Kind;
use data::provenance::Provenance;
use plant::bench::BenchConfig;
use score::breathing::breathing;
use score::evaluate::{
    BreathTrace, Comparison, DeviceGround, Ground, Plan, SourceGround, compare, trace_source_after,
};
use show::report::{Block, Plot, Report, Section, Series, Style, Table};
use ventilator::law::AnyLaw;
use ventilator::{BenchSource, PlantSource, SharedLink};

/// How the controller to evaluate is chosen.
pub trait Choice: clap::Args + Debug {
    /// What is known of the controller after its breaths.
    type Account: Serialize;

    /// What the help says below the options.
    const HELP: &'static str;
    /// Options that exclude breathing patients.
    const NOT_WHILE_BREATHING: &'static [&'static str];

    /// The chosen controller, built for `plant` if there is one.
    ///
    /// # Errors
    /// Arguments that make no controller, or none for this plant.
    fn chosen(&self, plant: Option<&SharedLink>) -> anyhow::Result<Chosen>;

    /// Whether its ventilations run one after the other, and go on after the pressure limit has ended a breath.
    fn takes_turns(&self) -> bool {
        false
    }

    /// Prints and returns the account of the controller, if it has one.
    fn account(&self, _chosen: &Chosen, _context: &Context<'_>) -> Option<Self::Account> {
        None
    }

    /// Refuses a controller by its account.
    ///
    /// # Errors
    /// A controller whose scores are not its own.
    fn check(_account: Option<&Self::Account>) -> anyhow::Result<()> {
        Ok(())
    }
}

impl Choice for ControllerArgs {
    type Account = ();

    const HELP: &'static str = "\
Examples:
  trainer evaluate --gains 2,30,0.01 --bench R5C50
  trainer evaluate --controller controller.safetensors --bench R20C20 --report evaluation.html
  trainer evaluate --controller controller.safetensors --bench paper --breathing
  trainer evaluate --controller weights.bin --port tcp:localhost:5555
  trainer evaluate --controller controller.safetensors --plant tcp:localhost:7000
  trainer evaluate --controller controller.safetensors --bench R5C50 --breaths-of-learning 20
  trainer evaluate --bench neonate-iso-14 --pips 35 --settings rate=30,inspiratory_time=0.6
  trainer evaluate --controller controller.safetensors --prescriptions bedside --seed 3
  trainer evaluate --controller weights.bin --against 2.5,25,0.02 --bench iso-05 --seed 7 --json -

The score is the mean absolute error over the inspiration, in cmH2O. On the bench it is computed
from the true airway pressure; with --plant from the true pressure if the plant reports it; with
--port from the measured pressure. The last two columns are the valve effort over the plateau:
total variation and standard deviation of the command. A learned controller is compared with the
PID underneath it, or with --against. On a device (--port), weights that are not running yet are
uploaded first. `lab evaluate` does the same with rivals and with controllers of your own.

With --breathing, patients with efforts of 3, 6 and 10 cmH2O, at 0.7, 0.9 and 1.2 times the set
rate, take the place of the bench's own. Scores are those of breaths without efforts (passive), of
breaths of these patients that the clock starts (timed) and of those that an effort starts
(triggered).";

    const NOT_WHILE_BREATHING: &'static [&'static str] = &["port", "plant", "report"];

    fn chosen(&self, plant: Option<&SharedLink>) -> anyhow::Result<Chosen> {
        Self::chosen(self, plant)
    }
}

/// Compare controllers on any bench, device or plant
#[derive(Debug, clap::Args)]
#[command(after_help = C::HELP)]
pub struct Args<C: Choice> {
    #[command(flatten)]
    choice: C,
    /// Gains P,I,D of the PID to compare the controller with, percent of the valve per cmH2O, cmH2O s and cmH2O/s
    /// [default: the PID underneath it]
    #[arg(long, value_name = "P,I,D", value_parser = gains, conflicts_with = "gains")]
    against: Option<PidGains>,
    #[command(flatten)]
    source: SourceArgs,
    #[command(flatten)]
    waveforms: WaveformsArgs,
    /// Scored breaths per waveform and noise sequence
    #[arg(long, value_name = "N", default_value_t = Plan::default().breaths, value_parser = some())]
    breaths: usize,
    /// Breaths from rest before the scored ones, in which a controller may learn from breath to breath
    #[arg(long, value_name = "N", default_value_t = Plan::default().warm_up as u32, conflicts_with = "breathing", value_parser = within::<u32>(0, 1_000_000))]
    breaths_of_learning: u32,
    /// Seed of the sensor noise, and of drawn prescriptions
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Score breaths that efforts trigger beside those that the clock starts, on breathing patients of the chosen lungs
    #[arg(long, conflicts_with_all = C::NOT_WHILE_BREATHING.iter().copied())]
    breathing: bool,
    /// Write figures and curves to an HTML report
    #[arg(long, value_name = "FILE.html", value_parser = OutFile::of(Kind::Page))]
    report: Option<OutFile>,
    #[command(flatten)]
    output: OutputArgs,
}

/// The content of `--json`.
#[derive(Debug, Serialize)]
#[serde(untagged)]
pub enum Outcome<A> {
    /// Waveform by waveform.
    Comparison(Box<Summary<A>>),
    /// On breathing patients.
    Breathing(BreathingSummary),
}

/// A comparison.
#[derive(Debug, Serialize)]
pub struct Summary<A> {
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
    breaths_of_learning: u32,
    #[serde(skip_serializing_if = "Option::is_none")]
    prescriptions: Option<String>,
    #[serde(skip_serializing_if = "Option::is_none")]
    policy: Option<A>,
    #[serde(flatten)]
    comparison: Comparison,
}

/// The ventilator, the PID and the controller beside it.
struct Setup {
    ground: Box<dyn Ground<AnyLaw>>,
    /// The bench, if the breaths run on one.
    bench: Option<BenchConfig>,
    /// The pressure that is scored.
    pressure: &'static str,
    pid: AnyLaw,
    chosen: Chosen,
    /// See [`Choice::takes_turns`].
    takes_turns: bool,
    plan: Plan,
}

impl<C: Choice> Args<C> {
    /// The controller and the breaths of its evaluation.
    fn chosen_and_plan(&self, plant: Option<&SharedLink>) -> anyhow::Result<(Chosen, Plan)> {
        let chosen = self.choice.chosen(plant)?;
        let plan = Plan {
            period_us: chosen.period_us,
            breaths: self.breaths,
            warm_up: self.breaths_of_learning as usize,
            ..Plan::evaluation(self.seed)
        };
        Ok((chosen, self.waveforms.on(plan, self.seed)?))
    }
}

impl Setup {
    fn new(args: &Args<impl Choice>) -> anyhow::Result<Self> {
        let plant = args.source.plant.connect()?;
        let (chosen, plan) = args.chosen_and_plan(plant.as_ref())?;
        let gains = args.against.unwrap_or(chosen.gains());
        let pressure = match (&args.source.port.port, &plant) {
            (Some(_), _) => "measured airway pressure",
            (None, Some(_)) => "airway pressure, the true one if the plant reports it",
            (None, None) => "true airway pressure, known only to the bench",
        };
        let takes_turns = args.choice.takes_turns();
        let goes_on = takes_turns || plan.goes_on;
        let mut bench = None;
        let ground: Box<dyn Ground<AnyLaw>> = match (&args.source.port.port, plant) {
            (Some(address), _) => {
                chosen.chip()?;
                let described = args.source.bench.described()?;
                let source = device_source(address, &chosen, plan.seeds[0], described.as_ref())?;
                Box::new(DeviceGround(SourceGround::new(source)))
            }
            (None, Some(link)) => {
                let controller = chosen.controller.clone();
                let source = PlantSource::new(link, controller, chosen.period_us, plan.seeds[0]);
                Box::new(SourceGround::new(if goes_on { source.going_on() } else { source }))
            }
            (None, None) => {
                let bench = bench.insert(args.source.bench.one()?);
                if takes_turns {
                    one_after_the_other(bench, &chosen, &plan)?
                } else {
                    Box::new(bench.clone())
                }
            }
        };
        let pid = Chosen::pid(gains, chosen.period_us)?.controller;
        Ok(Self { ground, bench, pressure, pid, chosen, takes_turns, plan })
    }

    /// The controller to compare with the PID, with its name for output; none if the PID alone is scored.
    fn beside(&self) -> Option<(&str, &AnyLaw)> {
        Some((self.chosen.beside_pid.as_deref()?, &self.chosen.controller))
    }

    /// The table of a comparison.
    fn table(&self, comparison: &Comparison, title: &str) -> Table {
        table(comparison, self.chosen.beside_pid.as_deref().unwrap_or_default(), title)
    }
}

/// The bench on which breaths run one after the other, and go on after the pressure limit has ended one.
fn one_after_the_other(
    bench: &BenchConfig,
    chosen: &Chosen,
    plan: &Plan,
) -> anyhow::Result<Box<dyn Ground<AnyLaw>>> {
    let settings = plan.waveforms.first().copied().unwrap_or_default();
    let source =
        BenchSource::new(bench, chosen.controller.clone(), &settings, plan.period_us, plan.seeds[0])?;
    Ok(Box::new(SourceGround::new(source.going_on())))
}

/// Prints how many scored inspirations the pressure limit has ended, if it has ended any.
fn print_cuts(setup: &Setup, comparison: &Comparison, context: &Context<'_>) {
    let pair = &comparison.mean;
    let controllers =
        [("PID", Some(pair.pid)), (setup.chosen.beside_pid.as_deref().unwrap_or_default(), pair.learned)];
    for (name, score) in controllers {
        if let Some(score) = score.filter(|score| score.cut > 0.0) {
            let share = 100.0 * score.cut;
            context.line(&format!("{name}: the pressure limit ended {share:.0} % of the inspirations"));
        }
    }
}

impl<C: Choice> Command for Args<C> {
    type Outcome = Outcome<C::Account>;

    fn output(&self) -> Output<'_> {
        self.output.makes(Makes::Experiment)
    }

    fn run(&self, context: &Context<'_>) -> anyhow::Result<Option<Self::Outcome>> {
        if self.breathing {
            return Ok(Some(Outcome::Breathing(run_breathing(self, context)?)));
        }
        let setup = Setup::new(self)?;
        let Setup { ground, pid, plan, .. } = &setup;
        let beside = setup.beside().map(|(_, law)| law);
        let comparison =
            context.progress(|progress| compare(ground.as_ref(), pid, beside, plan, progress))?;
        if comparison.waveforms.is_empty() {
            bail!("stopped before the first waveform was complete");
        }
        let title = format!(
            "{} on {}: errors of the {}, cmH2O",
            setup.chosen.name,
            setup.ground.name(),
            setup.pressure
        );
        context.table(&setup.table(&comparison, &title));
        if context.stopped() {
            context.line("stopped: only the completed waveforms are shown");
        }
        let policy = self.choice.account(&setup.chosen, context);
        print_cuts(&setup, &comparison, context);
        context.report(self.report.as_deref(), || report(self, &setup, &comparison, context))?;
        Ok(Some(Outcome::Comparison(Box::new(Summary {
            seed: self.seed,
            lung: setup
                .bench
                .as_ref()
                .filter(|_| self.source.bench.file().is_none())
                .map(|bench| bench.name.clone()),
            plant: self.source.plant.plant.as_ref().map(ToString::to_string),
            port: self.source.port.port.as_ref().map(ToString::to_string),
            bench: self.source.bench.file().filter(|_| setup.bench.is_some()).map(Path::to_owned),
            controller: setup.chosen.name.clone(),
            weights_id: setup.chosen.weights_id.clone(),
            gains: setup.pid.pid().gains(),
            period_us: setup.plan.period_us,
            breaths: setup.plan.breaths,
            breaths_of_learning: self.breaths_of_learning,
            prescriptions: self.waveforms.prescriptions.clone(),
            policy,
            comparison,
        }))))
    }

    fn conclude(&self, outcome: Self::Outcome, _context: &Context<'_>) -> anyhow::Result<()> {
        match outcome {
            Outcome::Comparison(summary) => C::check(summary.policy.as_ref()),
            Outcome::Breathing(_) => Ok(()),
        }
    }
}

/// Triggered and timed breaths of breathing patients.
fn run_breathing(args: &Args<impl Choice>, context: &Context<'_>) -> anyhow::Result<BreathingSummary> {
    let (chosen, plan) = args.chosen_and_plan(None)?;
    let pid = Chosen::pid(args.against.unwrap_or(chosen.gains()), chosen.period_us)?.controller;
    let mut controllers = vec![("PID".to_owned(), &pid)];
    controllers.extend(chosen.beside_pid.clone().map(|name| (name, &chosen.controller)));
    let (names, controllers): (Vec<_>, Vec<_>) = controllers.into_iter().unzip();
    let benches = args.source.bench.benches()?;
    let breathing = context.progress(|progress| breathing(&benches, &controllers, &plan, progress))?;
    if breathing.patients.is_empty() {
        bail!("stopped before the first lung was complete");
    }
    let title = format!("{} on breathing patients: errors of the true airway pressure, cmH2O", chosen.name);
    context.table(&breathing_table(&breathing, &names, &title));
    if context.stopped() {
        context.line("stopped: only the completed lungs are shown");
    }
    Ok(BreathingSummary {
        seed: args.seed,
        controller: chosen.name,
        weights_id: chosen.weights_id,
        gains: pid.pid().gains(),
        period_us: plan.period_us,
        breaths: plan.breaths,
        controllers: names,
        breathing,
    })
}

fn report(
    args: &Args<impl Choice>,
    setup: &Setup,
    comparison: &Comparison,
    context: &Context<'_>,
) -> anyhow::Result<Report> {
    let mut sections = vec![Section {
        heading: "Figures".into(),
        text: format!(
            "Means over {} breaths under each of {} noise sequences; PID {}. Errors are those of the {}.",
            setup.plan.breaths,
            setup.plan.seeds.len(),
            format_gains(&setup.pid.pid().gains()),
            setup.pressure
        ),
        blocks: vec![Block::Table(setup.table(comparison, ""))],
    }];
    if let Some(bench) = &setup.bench {
        for (waveform, settings) in comparison.waveforms.iter().zip(&setup.plan.waveforms) {
            sections.push(curves(setup, bench, &waveform.title(), settings)?);
        }
    }
    sections.extend(next(&setup.chosen, context));
    Ok(Report {
        title: "Evaluation".into(),
        subtitle: format!("{} on {}", setup.chosen.name, setup.ground.name()),
        sections,
        provenance: Some(Provenance {
            seed: args.seed,
            plant: setup.ground.name(),
            plant_parameters: setup.bench.as_ref().map_or_else(String::new, BenchConfig::to_toml),
            settings: serde_json::to_value(&setup.plan)?,
            weights_id: setup.chosen.weights_id.clone().unwrap_or_default(),
            ..Provenance::new(setup.plan.period_us, "trainer evaluate")
        }),
    })
}

/// What to do with the controller; none for one that no device runs.
fn next(chosen: &Chosen, context: &Context<'_>) -> Option<Section> {
    if chosen.residual().is_none() {
        chosen.controller.chip()?;
        let (bench, gains) = (context.bench_option(), format_gains(&chosen.gains()));
        let train = format!("trainer train{bench} --gains {gains} --out out/controller");
        return Some(Section::next(&[("Learn a controller that adds to this PID:", train)]));
    }
    let image = format!("trainer export {} --out {WEIGHTS}", quoted(&chosen.name));
    let [load, watch] = load_and_watch(WEIGHTS, USUAL);
    Some(Section::next(&[
        ("Write the controller as the weights image that a device loads:", image),
        load,
        watch,
    ]))
}

/// File of the weights image in the next steps.
const WEIGHTS: &str = "weights.bin";

/// One breath of a waveform: pressures, valves and what the network adds to its PID.
fn curves(setup: &Setup, bench: &BenchConfig, title: &str, settings: &Settings) -> anyhow::Result<Section> {
    let Plan { seeds, warm_up, .. } = &setup.plan;
    let run = |law: &AnyLaw| {
        let source = setup.plan.source(bench, law.clone(), settings, seeds[0])?;
        let mut source = if setup.takes_turns { source.going_on() } else { source };
        trace_source_after(*warm_up, &mut source, settings, 1)
    };
    let mut traces = vec![("PID", run(&setup.pid)?)];
    if let Some((name, law)) = setup.beside() {
        traces.push((name, run(law)?));
    }
    let target = points(&traces[0].1, &traces[0].1.target);
    let mut pressure = vec![Series::new("target", Style::Dashed, target)];
    let mut valve = Vec::new();
    for (name, trace) in &traces {
        pressure.push(Series::new(*name, Style::Line, points(trace, &trace.pressure)));
        valve.push(Series::new(*name, Style::Line, points(trace, &trace.u_in)));
    }
    let mut plots = vec![
        Plot::over_time("True airway pressure", "pressure, cmH2O", pressure),
        Plot::over_time("Inspiratory valve", "command, percent", valve),
    ];
    if let (Some(residual), Some((name, trace))) = (setup.chosen.residual(), traces.get(1)) {
        let residual = points(trace, &trace.residual(residual.pid()));
        plots.push(Plot::over_time("Residual", "percent", vec![Series::new(*name, Style::Line, residual)]));
    }
    Ok(Section { heading: title.to_owned(), text: String::new(), blocks: vec![Block::PlotRow(plots)] })
}

fn points(trace: &BreathTrace, values: &[f64]) -> Vec<(f64, f64)> {
    trace.time_s.iter().copied().zip(values.iter().copied()).collect()
}
