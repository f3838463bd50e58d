//! `lab endure`: random patients at random machines, for hours.

mod diary;

use std::path::{Path, PathBuf};

use anyhow::{Context as _, bail};
use shared::breath::DEFAULT_PERIOD_US;
use shared::control::Controller;
use shared::safety::alarms::Priority;
use shared::weights::decode;

use self::diary::{Diary, describe};
use host::args::controller::{image_id, image_of};
use host::args::shards::ShardFolderArgs;
use host::command::bounds::within;
use host::command::{Command, Context, Output, OutputArgs};
use show::report::{Cell, Table};
use trials::endure::course;
use trials::endure::patient::Patient;
use trials::endure::tally::{AlarmRow, PatientResult, Summary};
use trials::endure::{Endurance, Question, sound_controller};

/// Ventilate random patients for hours, and check every alarm
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  lab endure --patients 20 --hours 1
  lab endure --patients 1000 --hours 24 --seed 7 --keep endure.json --json result.json
  lab endure --seed 7 --hours 24 --patient 123     # one patient, with each alarm
  lab endure --controller out/once/controller.safetensors
  lab endure --patients 1000 --hours 24 --shard 3/40 --out out/endure   # each task of 40, then:
  lab endure --patients 1000 --hours 24 --merge --out out/endure

Adults and newborns, their machines, what they do, what is set, and in one of ten a fault that grows
are drawn from the seed and the patient's number. Settings change as at a bedside: weaning,
recruitment, rate and inspiratory time, limit and shape. The bench knows the truth: an alarm is
deserved if its condition was true in the running breath or the two before it, within the tolerance
of the sensors; it is missed if its condition was exceeded for six breaths and no alarm came.

The result does not depend on the number of threads. With --keep, the patients that are done at
Ctrl-C are kept, and the same command continues with the others. The command fails after an
interruption of ventilation, an undeserved high-priority alarm, or a missed alarm.")]
pub struct Args {
    /// Number of patients
    #[arg(long, value_name = "N", default_value_t = 20, value_parser = within::<u64>(1, 1_000_000))]
    patients: u64,
    /// Stay of each patient, h
    #[arg(long, default_value_t = 1.0, value_parser = within::<f64>(0.01, 1000.0))]
    hours: f64,
    /// Seed of the patients, machines and settings
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// A learned controller for the adults: a shipped one, such as adult, or a file as written by `trainer train`; newborns have the PID of their family [default: the PID of the fault matrix]
    #[arg(long, value_name = "NAME|FILE")]
    controller: Option<PathBuf>,
    /// Run this patient only, and print its alarms with times and reasons
    #[arg(long, value_name = "N", conflicts_with_all = ["patients", "keep", "out"], value_parser = within::<u64>(0, u64::MAX))]
    patient: Option<u64>,
    /// File that keeps the results; an existing file is continued
    #[arg(long, value_name = "FILE", conflicts_with = "out")]
    keep: Option<PathBuf>,
    #[command(flatten)]
    shards: ShardFolderArgs,
    #[command(flatten)]
    output: OutputArgs,
}

impl Command for Args {
    type Outcome = Summary;

    fn output(&self) -> Output<'_> {
        self.output.makes(self.shards.makes())
    }

    fn run(&self, context: &Context<'_>) -> anyhow::Result<Option<Summary>> {
        let (controller, name) = match &self.controller {
            Some(file) => learned(file)?,
            None => sound_controller()?,
        };
        match self.patient {
            Some(number) => alone(self, number, &controller, context).map(Some),
            None => together(self, &controller, &name, context),
        }
    }

    fn conclude(&self, outcome: Summary, _context: &Context<'_>) -> anyhow::Result<()> {
        if !outcome.passes() {
            let Summary { interruptions, high_alarms_undeserved, alarms_missed, .. } = outcome;
            bail!(
                "{interruptions} interruptions, {high_alarms_undeserved} undeserved high-priority alarms, \
                 {alarms_missed} missed alarms"
            );
        }
        Ok(())
    }
}

fn learned(file: &Path) -> anyhow::Result<(Controller, String)> {
    let image = image_of(file)?;
    let image = decode(&image).with_context(|| file.display().to_string())?;
    let period_us = image.residual.spec().period_us;
    if period_us != DEFAULT_PERIOD_US {
        bail!(
            "{} is trained for a control period of {period_us} us: train one for {DEFAULT_PERIOD_US} us",
            file.display()
        );
    }
    Ok((Controller::Residual(image.residual), image_id(image.id)))
}

/// Runs all patients or a shard of them, or merges shards; none after a shard.
fn together(
    args: &Args,
    controller: &Controller,
    name: &str,
    context: &Context<'_>,
) -> anyhow::Result<Option<Summary>> {
    let question = Question { seed: args.seed, hours: args.hours, controller: name.to_owned() };
    let test = Endurance { question, controller };
    let Some(found) = args.shards.run(&test, args.patients, args.keep.as_deref(), context)? else {
        return Ok(None);
    };
    let summary = found.sums().summary(args.patients);
    context.table(&alarms(&summary));
    if !summary.worst.is_empty() {
        context.table(&worst(&summary.worst));
    }
    for line in totals(&summary) {
        context.line(&line);
    }
    if context.stopped() {
        context.line("stopped; if started with --keep, the same command continues from here");
    }
    Ok(Some(summary))
}

/// Runs one patient and prints what happens.
fn alone(
    args: &Args,
    number: u64,
    controller: &Controller,
    context: &Context<'_>,
) -> anyhow::Result<Summary> {
    let patient = Patient::draw(args.seed, number, args.hours);
    describe(&patient, context);
    let Some(result) = course::run(&patient, controller, args.hours, &mut Diary(context))? else {
        bail!("stopped before the end of the stay");
    };
    let summary = Summary::of(&[result]);
    for line in totals(&summary) {
        context.line(&line);
    }
    Ok(summary)
}

fn alarms(summary: &Summary) -> Table {
    let undeserved = |row: &AlarmRow| match row.priority {
        Priority::Low => Cell::right("-"),
        _ => Cell::count(row.undeserved as usize),
    };
    Table::of(
        "Alarms; low-priority ones are not judged",
        &summary.alarms,
        &[
            ("alarm", &|row| Cell::text(row.id)),
            ("priority", &|row| Cell::text(row.priority.name())),
            ("deserved", &|row| Cell::count(row.deserved as usize)),
            ("undeserved", &undeserved),
            ("per patient-day", &|row| Cell::number(row.per_patient_day, 2)),
        ],
    )
}

fn worst(results: &[PatientResult]) -> Table {
    let count = |count: u64| Cell::count(count as usize);
    let causes = |result: &PatientResult| {
        let alarms = result.alarms.iter().filter(|(_, count)| count.undeserved > 0);
        let alarms = alarms.map(|(id, count)| format!("{id} {}", count.undeserved));
        let missed = result.missed.iter().map(|(name, count)| format!("missed {name} {count}"));
        alarms.chain(missed).collect::<Vec<_>>().join(", ")
    };
    Table::of(
        "The worst patients",
        results,
        &[
            ("patient", &|result| count(result.patient)),
            ("interruptions", &|result| count(result.interruptions)),
            ("high undeserved", &|result| count(result.undeserved(Priority::High))),
            ("missed", &|result| count(result.missed())),
            ("medium undeserved", &|result| count(result.undeserved(Priority::Medium))),
            ("self-triggered", &|result| count(result.efforts.self_triggered)),
            ("longest gap, s", &|result| Cell::number(result.longest_gap_s, 1)),
            ("share of volume", &|result| Cell::number(result.minute_volume_share, 2)),
            ("undeserved and missed", &|result| Cell::text(causes(result))),
        ],
    )
}

/// How breaths followed efforts.
fn efforts(summary: &Summary) -> String {
    let followed = match summary.trigger_delay_ms {
        None => "no breath triggered by an effort".to_owned(),
        Some(delay) => format!(
            "{:.0} % of the breaths triggered by efforts, median delay {delay} ms; {:.1} % of the efforts missed",
            100.0 * summary.triggered_share,
            100.0 * summary.efforts_missed_share,
        ),
    };
    let alone = summary.self_triggered_per_mille;
    format!("{followed}; {alone:.2} of 1,000 breaths triggered without an effort")
}

fn totals(summary: &Summary) -> Vec<String> {
    let Summary { patients, patient_days, breaths, interruptions, .. } = summary;
    vec![
        format!(
            "{breaths} breaths of {patients} patients in {patient_days:.2} patient-days: {interruptions} interruptions"
        ),
        format!(
            "undeserved: {} high-priority alarms, {:.2} medium ones per patient-day; missed: {}",
            summary.high_alarms_undeserved, summary.medium_alarms_undeserved_per_day, summary.alarms_missed
        ),
        format!(
            "longest gap {:.1} s; lowest minute volume {:.2} of the passive patient's; highest true pressure {:.1} cmH2O, at \
             most {:.1} above the limit",
            summary.longest_gap_s,
            summary.least_minute_volume_share,
            summary.peak_true,
            summary.peak_above_limit.max(0.0)
        ),
        efforts(summary),
    ]
}
