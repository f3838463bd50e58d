//! `trainer selftest`: runs and shows the self-test of a device.

use anyhow::bail;
use monitoring::ticks::Evenness;
use serde::Serialize;
use shared::device::self_test::{Check, Outcome, Report, Step, StepResult};
use shared::timing::TickTimes;

use crate::command::{Command, Context, Output, OutputArgs};
use device::port::Address;
use device::{Device, DeviceError};
use show::report::{Cell, Table};

/// Show the results of a device's self-test, and run its checks
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  trainer selftest --port /dev/ttyACM0
  trainer selftest --port /dev/ttyACM0 --run zero
  trainer selftest --port tcp:localhost:5555 --run circuit --json -

A device tests its program, weights, memory and sensors at each start. These checks run in standby,
on request:
  zero     zeroes the pressure sensors: open the circuit to the air first
  circuit  checks valves, leak and compliance, with a test lung at the patient port
  relief   checks the relief valve (up to 85 cmH2O): close the patient port first

The last two move the valves, so never run them with a patient at the machine. A step that fails prevents ventilation from starting; the exit code is then 1. Repeat a check to clear its failure.

The last rows are the control ticks since the start: bias of the mean period, largest deviation of a
period (jitter), ticks that did not run.")]
pub struct Args {
    /// The device's address: /dev/ttyACM0, COM3, serial:NAME?baud=N or tcp:HOST:PORT
    #[arg(long, value_name = "PORT")]
    port: Address,
    /// Run this check first: `zero`, `circuit` or `relief`, which each need their own preparation of the circuit
    #[arg(long, value_enum, value_name = "NAME", hide_possible_values = true)]
    run: Option<CheckName>,
    #[command(flatten)]
    output: OutputArgs,
}

/// The checks by name.
#[derive(Clone, Copy, Debug, clap::ValueEnum)]
enum CheckName {
    Zero,
    Circuit,
    Relief,
}

impl From<CheckName> for Check {
    fn from(name: CheckName) -> Self {
        match name {
            CheckName::Zero => Self::Zero,
            CheckName::Circuit => Self::Circuit,
            CheckName::Relief => Self::Relief,
        }
    }
}

/// A row of `--json`.
#[derive(Debug, Serialize)]
pub struct Row {
    step: &'static str,
    result: &'static str,
    reason: Option<String>,
    /// None where nothing was measured.
    value: Option<f32>,
    unit: Option<&'static str>,
}

impl Row {
    fn new((step, result): (Step, &StepResult)) -> Self {
        let (name, reason) = match result.outcome {
            Outcome::NotRun => ("not run", None),
            Outcome::Runs => ("runs", None),
            Outcome::Passed => ("passed", None),
            Outcome::Failed(finding) => ("failed", Some(finding.to_string())),
        };
        let value = Some(result.value).filter(|value| value.is_finite());
        // A failure's value can have the unit of another quantity; its reason says what it means.
        let unit = step.unit().filter(|_| value.is_some() && result.outcome == Outcome::Passed);
        Self { step: step.name(), result: name, reason, value, unit }
    }

    fn measured(&self) -> String {
        match (self.value, self.unit) {
            (Some(value), Some(unit)) => format!("{value:.2} {unit}"),
            (Some(value), None) if self.result == "recorded" => format!("{value}"),
            _ => String::new(),
        }
    }
}

impl Command for Args {
    type Outcome = Vec<Row>;

    fn output(&self) -> Output<'_> {
        self.output.json()
    }

    fn run(&self, context: &Context<'_>) -> anyhow::Result<Option<Vec<Row>>> {
        let mut device = Device::connect(&self.port)?;
        let period_us = device.identify()?.period_us;
        if let Some(check) = self.run {
            device.run_check(check.into())?;
        }
        let mut rows = rows(&device.self_test()?);
        match device.timing(false) {
            Ok(times) => rows.extend(ticks(&times, period_us)),
            // A small device records no times.
            Err(DeviceError::Unknown(_)) => {}
            Err(error) => return Err(error.into()),
        }
        context.table(&table(&rows));
        Ok(Some(rows))
    }

    fn conclude(&self, outcome: Vec<Row>, _context: &Context<'_>) -> anyhow::Result<()> {
        match outcome.iter().find(|row| row.reason.is_some()) {
            Some(Row { step, reason, .. }) => bail!("{step}: {}", reason.as_deref().unwrap_or_default()),
            None => Ok(()),
        }
    }
}

fn rows(report: &Report) -> Vec<Row> {
    Step::ALL.into_iter().zip(report).map(Row::new).collect()
}

/// The control ticks since the device started: by how much the mean period is off, the largest deviation of a period, and the ticks that
/// did not run.
fn ticks(times: &TickTimes, period_us: u32) -> Vec<Row> {
    let row =
        |step, value: f32, unit| Row { step, result: "recorded", reason: None, value: Some(value), unit };
    let recorded = Evenness::of(times, period_us).map(|Evenness { bias_us, jitter_us }| {
        [row("tick bias", bias_us, Some("us")), row("tick jitter", jitter_us, Some("us"))]
    });
    recorded.into_iter().flatten().chain([row("missed ticks", times.missed as f32, None)]).collect()
}

fn table(rows: &[Row]) -> Table {
    let mut table = Table::new("", &["step", "result", "measured"]);
    for row in rows {
        table.row(vec![Cell::text(row.step), Cell::text(row.result), Cell::text(row.measured())]);
    }
    table
}

#[cfg(test)]
mod tests {
    use super::*;
    use shared::device::self_test::Finding;
    use shared::timing::CycleStats;

    #[test]
    fn the_ticks_show_their_bias_their_jitter_and_those_that_are_missing() {
        let period = CycleStats { shortest: 167_832, mean: 168_084.0, longest: 168_336 };
        let times = TickTimes { core_hz: 168_000_000, missed: 3, period, ..TickTimes::default() };
        let shown: Vec<String> = ticks(&times, 1000).iter().map(Row::measured).collect();
        assert_eq!(shown, ["0.50 us", "2.00 us", "3"]);
        assert_eq!(ticks(&TickTimes::default(), 1000).len(), 1, "no period before the second tick");
    }

    #[test]
    fn a_step_shows_its_result_its_value_and_the_reason_of_a_failure() {
        let row = |outcome, value| Row::new((Step::Circuit, &StepResult { outcome, value }));
        let passed = row(Outcome::Passed, 21.26);
        assert_eq!((passed.result, passed.measured()), ("passed", "21.26 mL/cmH2O".to_owned()));
        assert_eq!(row(Outcome::Passed, f32::NAN).measured(), "");
        let failed = row(Outcome::Failed(Finding::Leak), 4.0);
        assert!(failed.reason.unwrap().contains("leaks"));
        let text = table(&[row(Outcome::NotRun, f32::NAN)]).to_plain();
        assert!(text.contains("circuit") && text.contains("not run"), "{text}");
    }
}
