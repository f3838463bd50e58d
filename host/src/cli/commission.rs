//! `trainer commission`: a controller for one unit, from a minute of its own breaths.

use std::path::PathBuf;

use anyhow::bail;
use serde::Serialize;
use shared::breath::PAPER_PIPS;
use shared::control::pid::PidGains;
use shared::control::residual::Residual;

use super::train::{CONTROLLER, ResultArgs};
use crate::args::controller::{Chosen, learned};
use crate::args::gains::{format_gains, gains};
use crate::args::port::{USUAL, load_and_watch};
use crate::args::settings::SettingsArgs;
use crate::args::source::SourceArgs;
use crate::args::waveforms::pips;
use crate::command::bounds::{some, within};
use crate::command::{Command, Context, Makes, Output};
use data::recording::Recording;
use data::workspace::Workspace;
use learn::controller::CurvePoint;
use learn::pipeline::commission::{
    BREATHS_NEEDED, CommissionRun, Commissioned, Figures, OPEN_LOOP_LIMIT, Winner,
};
use show::report::{Block, Cell, Plot, Report, Section, Series, Style, Table};
use study::farm::{Alone, OnBench, Scores};

/// Train the family's controller further on one unit's own breaths
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  trainer commission --port /dev/ttyACM0 --out out/unit-7
  trainer commission --bench my-unit.toml --out out/mine
  trainer commission --plant tcp:localhost:7000 --out out/plant
  trainer commission --bench R20C20 --controller out/adult/controller.safetensors --out out/r20c20

Connect a passive test lung of medium resistance, such as R20C20, never a patient: a recording on
a low resistance says little about small flows. The command works in five stages: it records the
unit under a soft PID with random exploration; it fits a physical simulator and checks it on
breaths left out of the fit; it trains the controller further, in small steps, on units drawn
narrowly around that simulator; it compares PID, starting and fine-tuned controller, on a bench
also under new sensor noise; and it packs the best of them for the chip.

The defaults take 60 s of breathing at 20 breaths/min, and about 60 s of processor time, shared by
all cores. The number of gradient steps is fixed, so that the same seed gives the same weights
everywhere. If a check fails, the command says what to do and ends with a non-zero status.

The folder then has recording.parquet, controller.safetensors, weights.bin and report.html. Ctrl-C
stops; the same command continues from the recording in the folder. A recording that was not
complete is repeated.")]
pub struct Args {
    #[command(flatten)]
    source: SourceArgs,
    /// The learned controller to start from: a shipped one, or a file as written by `trainer train-family`
    #[arg(long, value_name = "NAME|FILE", default_value = "adult")]
    controller: PathBuf,
    /// Number of breaths to record
    #[arg(long, value_name = "N", default_value_t = CommissionRun::default().collect.breaths as u32,
        value_parser = within::<u32>(BREATHS_NEEDED as u32, 1_000_000))]
    breaths: u32,
    /// Gains P,I,D of the PID that records, percent of the valve per cmH2O, cmH2O s and cmH2O/s
    #[arg(long, value_name = "P,I,D", value_parser = gains, default_value = format_gains(&CommissionRun::default().collector))]
    collector: PidGains,
    /// PIPs of every second breath, of half of the training and of the comparison; the others are random ones around them, cmH2O
    #[arg(long, value_name = "CMH2O,..", value_delimiter = ',', default_values_t = PAPER_PIPS, value_parser = pips())]
    pips: Vec<f32>,
    /// Gradient steps
    #[arg(long, value_name = "N", default_value_t = CommissionRun::default().train.iterations, value_parser = some())]
    iterations: usize,
    #[command(flatten)]
    settings: SettingsArgs,
    #[command(flatten)]
    result: ResultArgs,
}

/// The content of `--json`.
#[derive(Debug, Serialize)]
pub struct Summary {
    seed: u64,
    plant: String,
    start: String,
    gains: PidGains,
    #[serde(flatten)]
    figures: Figures,
    winner: Winner,
    /// Scores on the units drawn around the learned simulator, cmH2O.
    simulator: Scores,
    /// Scores on the bench, for every number of breaths of learning.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    bench: Vec<OnBench>,
    controller: PathBuf,
    weights: PathBuf,
    weights_id: String,
    train_curve: Vec<CurvePoint>,
}

/// File name of the report in the folder.
const REPORT: &str = "report.html";

impl Command for Args {
    type Outcome = Summary;

    fn output(&self) -> Output<'_> {
        self.result.output.makes(Makes::Folder(&self.result.out))
    }

    fn run(&self, context: &Context<'_>) -> anyhow::Result<Option<Summary>> {
        self.result.check_key()?;
        let start = learned(&self.controller)?;
        let Some(residual) = start.residual() else { bail!("{} is no learned controller", start.name) };
        let unit = self.unit(residual)?;
        let recording = self.recording(&unit, &start, context)?;
        stage(
            2,
            "check: fits a physical simulator and compares it with breaths left out of the fit",
            context,
        );
        let checked = context.progress(|progress| unit.run.check(&recording, progress))?;
        context.table(&figures_table(&checked.figures));
        context.table(&unit_table(&checked.figures));
        context.line(SCALE);
        if let Some(problem) = checked.figures.problem() {
            bail!("{problem}");
        }
        let text = format!("fine-tune: trains {} further on units around this simulator", start.name);
        stage(3, &text, context);
        let commissioned = context.progress(|progress| unit.train(&checked, progress))?;
        if !commissioned.complete {
            context.line("Stopped. Run the same command again to continue.");
            return Ok(None);
        }
        context.line(verdict(commissioned.winner));
        stage(4, "compare: scores the PID, the starting and the commissioned controller", context);
        let learned = &commissioned.learned.controller;
        let bench = context.progress(|progress| unit.compare(learned, progress))?;
        Ok(Some(self.finish(&start, &recording, &checked.figures, commissioned, bench, context)?))
    }
}

/// Announces a stage.
fn stage(number: usize, text: &str, context: &Context<'_>) {
    context.line(&format!("[{number}/5] {text}"));
}

/// The configuration of a recording of this many breaths at these PIPs, cmH2O, and of a training of this many gradient steps on it.
pub fn configured(
    seed: u64,
    settings: &SettingsArgs,
    pips: &[f32],
    breaths: u32,
    iterations: usize,
) -> anyhow::Result<CommissionRun> {
    let mut run = CommissionRun { seed, ..CommissionRun::of(&settings.for_training(pips)?, pips) };
    (run.collect.breaths, run.train.iterations) = (breaths as usize, iterations);
    Ok(run)
}

impl Args {
    /// The unit as a farm.
    fn unit<'a>(&self, start: &'a Residual) -> anyhow::Result<Alone<'a>> {
        let Self { result, settings, pips, collector, .. } = self;
        let run = configured(result.seed, settings, pips, self.breaths, self.iterations)?;
        let run = CommissionRun { collector: *collector, ..run };
        let (bench, unit) = match (&self.source.port.port, &self.source.plant.plant) {
            (Some(port), _) => (None, port.to_string()),
            (None, Some(plant)) => (None, plant.to_string()),
            (None, None) => {
                let bench = self.source.bench.one()?;
                let unit = bench.to_toml();
                (Some(bench), unit)
            }
        };
        Ok(Alone { run, start, unit, bench, folder: Workspace::new(&result.out) })
    }

    /// Records the unit, or loads the recording of an earlier call.
    fn recording(
        &self,
        unit: &Alone<'_>,
        start: &Chosen,
        context: &Context<'_>,
    ) -> anyhow::Result<Recording> {
        let run = &unit.run;
        if let Some(recording) = unit.recorded()? {
            stage(1, &format!("collect: {} is complete", unit.recording().display()), context);
            return Ok(recording);
        }
        let plant = self.source.plant.connect()?;
        start.suits(plant.as_ref())?;
        let pid = Chosen::pid(run.collector, start.period_us)?;
        let collection = run.collection(0);
        let mut source = self.source.open(plant, &pid, &collection.settings, collection.seed)?;
        // Only now: a unit that cannot be reached leaves no trace in the folder.
        unit.claim()?;
        let text = format!(
            "collect: records {} breaths, {:.0} s, under the PID {} with random exploration; {} cmH2O ends a breath",
            run.collect.breaths,
            run.collect.breaths as f32 * 60.0 / run.collect.settings.rate,
            format_gains(&run.collector),
            run.collect.settings.pressure_limit,
        );
        stage(1, &text, context);
        Ok(context.progress(|progress| unit.record(source.as_mut(), progress))?)
    }

    /// Prints the comparison, packs the controller and writes the report.
    fn finish(
        &self,
        start: &Chosen,
        recording: &Recording,
        figures: &Figures,
        commissioned: Commissioned,
        bench: Vec<OnBench>,
        context: &Context<'_>,
    ) -> anyhow::Result<Summary> {
        let simulator = Scores::on_simulator(&commissioned);
        let Commissioned { learned, winner, curve, .. } = commissioned;
        let comparison = comparison_table(simulator, &bench);
        context.table(&comparison);
        let worse = bench.iter().any(|on| on.scores.worse());
        if worse {
            context.line(WORSE);
        }
        stage(5, "pack", context);
        let controller = self.result.out.join(CONTROLLER);
        learned.save(&controller)?;
        context.saved(&controller);
        let (weights, weights_id) = self.result.packed(&learned, context)?;
        let port = self.source.port.port.as_ref().map_or(USUAL.into(), ToString::to_string);
        let next = load_and_watch(&weights, &port);
        let mut sections = sections(figures, comparison, winner, &curve);
        if !worse {
            sections.push(Section::next(&next));
        }
        let report = Report {
            title: "Commissioning".into(),
            subtitle: format!("{} from {}", recording.provenance.plant, start.name),
            sections,
            provenance: Some(recording.provenance.clone()),
        };
        context.report(Some(&self.result.out.join(REPORT)), || Ok(report))?;
        if !worse {
            context.line(&format!("Flash it with: {}", next[0].1));
        }
        Ok(Summary {
            seed: self.result.seed,
            plant: recording.provenance.plant.clone(),
            start: start.name.clone(),
            gains: start.gains(),
            figures: *figures,
            winner,
            simulator,
            bench,
            controller,
            weights,
            weights_id,
            train_curve: curve,
        })
    }
}

/// Said of the estimates.
const SCALE: &str = "Pressures alone do not tell the scale of the flow: full flow, R, C and leak are those of a circuit of 1.5 mL/cmH2O.\nAt a low R they can be wrong by a factor of two; the times and the controller do not depend on that scale.";
/// Said if the bench disagrees with the simulator.
const WORSE: &str = "On the bench the commissioned controller is worse than the starting one: keep the starting one, or commission again with more breaths (--breaths) or another --seed, and another --out.";

fn verdict(winner: Winner) -> &'static str {
    match winner {
        Winner::FineTuned => "The fine-tuned controller beats the starting one on the validation units.",
        Winner::Start => {
            "The fine-tuned controller does not beat the starting one on the validation units: the starting one is kept."
        }
        Winner::Pid => {
            "Neither controller beats the PID on the validation units: the PID alone is kept. Start from a controller trained for this family (--controller)."
        }
    }
}

fn figures_table(figures: &Figures) -> Table {
    let mut table = Table::new("The recording and the simulator", &["figure", "value", "limit", "unit"]);
    for (name, value, limit, unit) in [
        (
            "complete breaths",
            Cell::count(figures.breaths),
            Cell::right(format!("at least {BREATHS_NEEDED}")),
            "",
        ),
        (
            "open-loop distance on breaths left out of the fit",
            Cell::number(figures.open_loop, 3),
            Cell::right(format!("at most {OPEN_LOOP_LIMIT}")),
            "cmH2O",
        ),
        ("sensor noise", Cell::number(figures.noise.into(), 3), Cell::right(""), "cmH2O"),
    ] {
        table.row(vec![Cell::text(name), value, limit, Cell::text(unit)]);
    }
    table
}

fn unit_table(figures: &Figures) -> Table {
    let unit = &figures.unit;
    let mut table = Table::new("The unit", &["number", "estimate", "unit"]);
    for (name, value, decimals, of) in [
        ("dead time of the valve", unit.dead_time_ms, 1, "ms"),
        ("lag of the valve", unit.lag_ms, 1, "ms"),
        ("full flow of the valve", unit.full_flow_l_per_s, 2, "L/s"),
        ("R", unit.resistance_cmh2o_per_l_s, 1, "cmH2O/(L/s)"),
        ("C", unit.compliance_ml_per_cmh2o, 1, "mL/cmH2O"),
        ("leak at 30 cmH2O", unit.leak_l_per_s_at_30_cmh2o, 3, "L/s"),
    ] {
        table.row(vec![Cell::text(name), Cell::number(value.into(), decimals), Cell::text(of)]);
    }
    table
}

fn comparison_table(simulator: Scores, bench: &[OnBench]) -> Table {
    let mut table = Table::new(
        "Mean absolute error, cmH2O; on the simulator the geometric mean over units and first breaths",
        &["on", "PID", "starting", "commissioned"],
    );
    let mut row = |name: String, scores: &Scores| {
        table.row(vec![
            Cell::text(name),
            Cell::number(scores.pid, 3),
            Cell::number(scores.start, 3),
            Cell::number(scores.commissioned, 3).best_if(scores.commissioned <= scores.start),
        ]);
    };
    row("simulator".into(), &simulator);
    for on in bench {
        row(format!("bench, breaths of learning before: {}", on.breaths_of_learning), &on.scores);
    }
    table
}

/// The sections of the report.
fn sections(figures: &Figures, comparison: Table, winner: Winner, curve: &[CurvePoint]) -> Vec<Section> {
    let points = curve.iter().map(|point| (point.iteration as f64, point.validation)).collect();
    let series = vec![Series::new("validation units", Style::Line, points)];
    let plot = Plot::new("Fine-tuning", "gradient steps", "mean absolute error, cmH2O", series);
    vec![
        Section::new("Check", SCALE, [figures_table(figures), unit_table(figures)].map(Block::Table).into()),
        Section::new("Comparison", verdict(winner), vec![Block::Table(comparison), Block::Plot(plot)]),
    ]
}
