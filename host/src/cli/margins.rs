//! `trainer margins`: stability margins of a connected unit, a plant or a bench, from sines in its breaths.

use std::io::{IsTerminal, Write, stderr, stdin};

use anyhow::{Context as _, bail, ensure};
use serde::Serialize;
use shared::explore::sines::AMPLITUDE_MAX;
use shared::settings::Settings;

use crate::args::controller::ControllerArgs;
use crate::args::settings::SettingsArgs;
use crate::args::source::SourceArgs;
use crate::args::waveforms::pips;
use crate::command::bounds::within;
use crate::command::{Command, Context, OutFile, Output, OutputArgs, write};
use data::kind::Kind;
use show::report::{Block, Cell, Report, Section, Table};
use tuning::figures;
use tuning::measure::measure;
use tuning::measurement::{Ended, FREQUENCIES, Measured, PHASES, Plan};
use tuning::stability::RequiredMargins;
use tuning::words::{self, Row};

/// What a person must type to confirm a test lung.
const CONFIRMED: &str = "yes";

/// Measure the stability margins of a unit by sines in its breaths
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  trainer margins --port /dev/ttyACM0
  trainer margins --port /dev/ttyACM0 --test-lung --report margins.html
  trainer margins --bench R20C20 --controller adult --plot nyquist.svg
  trainer margins --plant tcp:localhost:7000 --gains 3,30,0 --json margins.json

Only on a test lung, never with a patient: a sine is added to the command of the inspiratory valve
while the pressure rises along a ramp. Any alarm but that of a leak ends it, and so does Ctrl-C; what
was measured until then is shown. A device runs the controller that it has, unless one is given.

The ratio of the commands before and after the sine is the gain of the loop. From it: Ms, the
largest sensitivity; the gain margin; and the delay margin, each with its interval of 95 %. A robust
loop keeps Ms at most 2, a gain margin of at least 2 and a delay margin of at least 10 ms. A margin
whose interval is wider than 10 % to a side is not stated: not enough coherence. Backlash makes the
margins depend on the amplitude. Those of a learned controller are those on a ramp, where they can be
a third larger than on the plateau of `lab margins`.

The advice names what limits the loop, with its figure. Nothing is changed. The defaults take 126
breaths, 6 minutes at 20 breaths/min. Exit status 1 if a margin could not be stated.")]
pub struct Args {
    #[command(flatten)]
    source: SourceArgs,
    /// Confirm that the device at --port ventilates a test lung, and no patient; otherwise the command asks
    #[arg(long, requires = "port")]
    test_lung: bool,
    #[command(flatten)]
    controller: ControllerArgs,
    /// PIP of the breaths, cmH2O: a higher one moves more gas and leaves more room for the sine
    #[arg(long, value_name = "CMH2O", default_value_t = Plan::default().settings.pip, value_parser = pips())]
    pip: f32,
    /// Amplitude of the sine, percent
    #[arg(long, value_name = "PERCENT", default_value_t = Plan::default().amplitude, value_parser = within::<f32>(0.1, AMPLITUDE_MAX))]
    amplitude: f32,
    /// Number of frequencies from 1.6 to 25 Hz
    #[arg(long, value_name = "N", default_value_t = Plan::default().frequencies, value_parser = within::<u8>(*FREQUENCIES.start(), *FREQUENCIES.end()))]
    frequencies: u8,
    /// Number of breaths at each frequency
    #[arg(long, value_name = "N", default_value_t = Plan::default().phases.into(), value_parser = within::<u32>((*PHASES.start()).into(), (*PHASES.end()).into()))]
    breaths: u32,
    /// Seed of a bench's sensor noise and of the intervals
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Write the Nyquist plot as SVG
    #[arg(long, value_name = "FILE.svg", value_parser = OutFile::of(Kind::Picture))]
    plot: Option<OutFile>,
    /// Write a page with Bode and Nyquist plots, a breath beside its target, the valve's effort and the advice
    #[arg(long, value_name = "FILE.html", value_parser = OutFile::of(Kind::Page))]
    report: Option<OutFile>,
    #[command(flatten)]
    output: OutputArgs,
    #[command(flatten)]
    settings: SettingsArgs,
}

/// The content of `--json`.
#[derive(Debug, Serialize)]
pub struct Summary {
    plant: String,
    controller: String,
    weights_id: Option<String>,
    required: RequiredMargins,
    #[serde(flatten)]
    measured: Measured,
}

impl Command for Args {
    type Outcome = Summary;

    fn output(&self) -> Output<'_> {
        self.output.json()
    }

    fn run(&self, context: &Context<'_>) -> anyhow::Result<Option<Summary>> {
        let plan = self.plan();
        plan.validate()?;
        if let Some(port) = &self.source.port.port {
            ensure!(
                self.test_lung || is_confirmed(&port.to_string())?,
                "no test lung was confirmed, and nothing was measured: connect one, then add --test-lung"
            );
        }
        let plant = self.source.plant.connect()?;
        let chosen = self.controller.chosen(plant.as_ref())?;
        let keeps = self.source.port.port.is_some()
            && self.controller.gains.is_none()
            && self.controller.controller.is_none();
        let mut source = self.source.open(plant, &chosen, &plan.settings, self.seed)?;
        if !keeps {
            source.configure(chosen.chip()?.clone(), None)?;
        }
        let measured = context.progress(|progress| measure(source.as_mut(), &plan, progress))?;
        let summary = Summary {
            plant: source.plant(),
            controller: if keeps { "that of the device".into() } else { chosen.name.clone() },
            weights_id: chosen.weights_id.filter(|_| !keeps),
            required: RequiredMargins::default(),
            measured,
        };
        self.show(&summary, context)?;
        Ok(Some(summary))
    }

    fn conclude(&self, outcome: Summary, _context: &Context<'_>) -> anyhow::Result<()> {
        match &outcome.measured.ended {
            Some(Ended::Alarm(reason)) => bail!("an alarm ended the measurement: {reason}"),
            Some(Ended::Failed(reason)) => bail!("the measurement ended early: {reason}"),
            Some(Ended::Stopped) => Ok(()),
            None => words::unstated(&outcome.measured).map_or(Ok(()), |why| bail!(why)),
        }
    }
}

impl Args {
    fn plan(&self) -> Plan {
        let base = Plan::default();
        let settings = self.settings.over(&Settings { pip: self.pip, ..base.settings });
        let Self { amplitude, frequencies, breaths, seed, .. } = *self;
        // At most 24.
        Plan { settings, amplitude, frequencies, phases: breaths as u8, seed, ..base }
    }

    /// Prints the result and writes the files.
    fn show(&self, summary: &Summary, context: &Context<'_>) -> anyhow::Result<()> {
        let table = table(summary);
        context.table(&table);
        for line in lines(&summary.measured) {
            context.line(&line);
        }
        let measured = &summary.measured;
        if let Some(file) = &self.plot {
            write(file, figures::nyquist(&[named(summary)]).to_svg()?.as_bytes())?;
            context.saved(file);
        }
        context.report(self.report.as_deref(), || {
            let lines = lines(measured).join("\n");
            let [size, angle] = figures::bode(&measured.estimates);
            let [pressure, command] = figures::breath(&measured.breath);
            Ok(Report {
                title: "Margins".into(),
                subtitle: format!("{} under {}", summary.plant, summary.controller),
                sections: vec![
                    Section::new("Margins", lines, vec![Block::Table(table)]),
                    Section::new(
                        "Loop",
                        "The loop gain L; nearer to -1 is less robust.",
                        vec![
                            Block::Plot(figures::nyquist(&[named(summary)])),
                            Block::Plot(size),
                            Block::Plot(angle),
                        ],
                    ),
                    Section::new("Breath", "", vec![Block::Plot(pressure), Block::Plot(command)]),
                ],
                provenance: None,
            })
        })
    }
}

/// Asks a person at a terminal whether a test lung is connected.
fn is_confirmed(port: &str) -> anyhow::Result<bool> {
    if !stdin().is_terminal() {
        return Ok(false);
    }
    // Not on standard output, which may be for JSON alone.
    eprint!("Is a test lung connected to {port}, and no patient? Type {CONFIRMED}: ");
    stderr().flush()?;
    let mut typed = String::new();
    stdin().read_line(&mut typed).context("cannot read the answer")?;
    Ok(typed.trim() == CONFIRMED)
}

/// The loop with its name in a figure.
fn named(summary: &Summary) -> (String, Vec<tuning::response::ResponsePoint>) {
    let counting = summary.measured.estimates.iter().filter(|estimate| estimate.counts());
    (summary.plant.clone(), counting.map(|estimate| estimate.response).collect())
}

fn table(summary: &Summary) -> Table {
    let Summary { plant, controller, measured, .. } = summary;
    let title = format!("{plant} under {controller}, sine of {} %", measured.plan.amplitude);
    let mut table = Table::new(title, &["margin", "value", "95 % from", "to", "robust"]);
    for row in words::rows(&measured.margins) {
        let Row { value, unstated, interval, decimals, .. } = row;
        let name = if row.unit.is_empty() { row.name.into() } else { format!("{}, {}", row.name, row.unit) };
        let stated = unstated.map_or_else(|| Cell::known(value, decimals), Cell::text);
        let (low, high) = interval.unzip();
        let [low, high] = [low, high.flatten()].map(|end| Cell::known(end, decimals));
        table.row(vec![Cell::text(name), stated, low, high, Cell::text(row.robust)]);
    }
    table
}

/// The result beside the table, in words.
fn lines(measured: &Measured) -> Vec<String> {
    let advice = measured.advice.iter().map(|advice| format!("advice: {}", advice.text));
    words::remarks(measured).into_iter().chain(advice).collect()
}
