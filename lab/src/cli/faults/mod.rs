//! `lab faults`: the fault matrix on the virtual bench, and drawn faults.

mod drawn;

use anyhow::{anyhow, bail};
use serde::Serialize;
use shared::breath::DEFAULT_PERIOD_US;
use shared::safety::monitors::Monitors;

use drawn::{DrawArgs, DrawnSummary};

use data::kind::Kind;
use data::provenance::Provenance;
use host::args::bench::benches;
use host::command::bounds::within;
use host::command::{Command, Context, OutFile, Output, OutputArgs};
use plant::bench::BenchConfig;
use show::report::{Block, Cell, Report, Section, Table};
use trials::faults::cases::{LIMIT, LIMITS};
use trials::faults::matrix::{FaultRow, false_alarms, matrix};
use trials::faults::parts::{Part, without_each_part};

/// Inject faults on the virtual bench, and check the alarms
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  lab faults
  lab faults --bench R5C10 --json faults.json --report faults.html
  lab faults --limit 60                                 # another pressure limit
  lab faults --without reading-frozen --bench R20C20    # the rows that need this monitor
  lab faults --mutate                                   # the same for each monitor and response
  lab faults --nominal 10000                            # false alarms with effort and coughs
  lab faults --draw 10000 --seed 7 --save-failures out/failures    # any fault, any machine, any patient
  lab faults --case out/failures/pressure-12.toml       # one of these again
  lab faults --draw 1000 --mutate                       # how many cases need each of them

A row passes if its monitors fire under every seed, ventilation goes on (80 % of the volume of a
sound machine, no gap longer than two breaths) unless no command can move the gas, the venting
command follows within 200 ms of a reading above the limit, and the true airway pressure stays
below its bound: 20 cmH2O above the limit, but never more than the 75 cmH2O that the relief valve
allows. Patients who breathe and changes of the settings must raise no high-priority alarm.

A drawn case is a machine, a patient, a prescription, a controller and one to three faults. It must
keep four promises: the pressure is never more than 15 cmH2O above its limit for longer than 300 ms
where the valves obey; the patient gets 80 % of what the machine can still give, or a high-priority
alarm names the cause within two breaths or 15 s, and a loss of a third of the volume is an alarm
within a minute; nothing is latched unless a valve does not obey; and no high-priority alarm comes
without a reason. The command fails if a row fails or a case breaks a promise. A case needs a
monitor or a response if it breaks a promise without it but not with it, or if no alarm of any
priority names the cause any more.")]
pub struct Args {
    /// Virtual bench: a lung as in R20C20, `paper` for its nine lungs, or a TOML file; repeat it for more
    #[arg(long, value_name = "LUNG|FILE", default_value = "paper")]
    bench: Vec<String>,
    /// Seeds of the sensor noise
    #[arg(long, value_name = "SEED,..", value_delimiter = ',', default_values_t = [1, 2])]
    seeds: Vec<u64>,
    /// Pressure limit, cmH2O; rows about breaths that end at the limit have a lower one of their own
    #[arg(long, value_name = "CMH2O", default_value_t = LIMIT, value_parser = within::<f32>(LIMITS.0, LIMITS.1))]
    limit: f32,
    /// Leave out this monitor or response, such as reading-frozen or "step to the PID"
    #[arg(long, value_name = "NAME")]
    without: Option<String>,
    /// Leave out each monitor and each response in turn, and require a row to fail, or a drawn case to need it
    #[arg(long, conflicts_with_all = ["without", "keep", "out", "save_failures"])]
    mutate: bool,
    /// Run this many breaths without a fault and require that no alarm occurs
    #[arg(long, value_name = "N", conflicts_with_all = ["without", "mutate"], value_parser = within::<u32>(1, 1_000_000_000))]
    nominal: Option<u32>,
    /// Write the matrix to an HTML report
    #[arg(long, value_name = "FILE.html", value_parser = OutFile::of(Kind::Page))]
    report: Option<OutFile>,
    #[command(flatten)]
    drawn: DrawArgs,
    #[command(flatten)]
    output: OutputArgs,
}

/// The content of `--json`.
#[derive(Debug, Serialize)]
#[serde(untagged)]
pub enum Summary {
    /// The rows of the matrix.
    Matrix {
        /// Them.
        rows: Vec<FaultRow>,
    },
    /// Drawn cases.
    Drawn(DrawnSummary),
}

impl Command for Args {
    type Outcome = Summary;

    fn output(&self) -> Output<'_> {
        self.output.makes(self.drawn.shards.makes())
    }

    fn run(&self, context: &Context<'_>) -> anyhow::Result<Option<Summary>> {
        let without = self.without.as_deref().map(named).transpose()?;
        if let Some(file) = &self.drawn.case {
            return drawn::one(file, without, context).map(|()| None);
        }
        if let Some(cases) = self.drawn.draw {
            if self.mutate {
                return self.drawn.mutate(cases, context).map(|()| None);
            }
            return Ok(self.drawn.run(cases, without, context)?.map(Summary::Drawn));
        }
        let lungs = benches(&self.bench)?;
        match (self.nominal, self.mutate) {
            (Some(breaths), _) => nominal(&lungs, breaths, context).map(|()| None),
            (None, true) => mutate(self, &lungs, context).map(|()| None),
            (None, false) => faults(self, without, &lungs, context).map(Some),
        }
    }

    fn conclude(&self, outcome: Summary, context: &Context<'_>) -> anyhow::Result<()> {
        let rows = match outcome {
            Summary::Matrix { rows } => rows,
            Summary::Drawn(drawn) => return drawn.conclude(context),
        };
        let (failed, all) = (rows.iter().filter(|row| !row.pass).count(), rows.len());
        if failed > 0 {
            bail!("{failed} of {all} rows failed");
        }
        context.line(&format!("all {all} rows passed"));
        Ok(())
    }
}

fn faults(
    args: &Args,
    without: Option<Part>,
    lungs: &[BenchConfig],
    context: &Context<'_>,
) -> anyhow::Result<Summary> {
    let monitors = without.map_or(Monitors::ALL, Part::others);
    let rows = context.progress(|progress| matrix(lungs, &args.seeds, args.limit, monitors, progress))?;
    let table = table(&rows);
    context.table(&table);
    context.report(args.report.as_deref(), || Ok(report(table, args.limit)))?;
    Ok(Summary::Matrix { rows })
}

fn mutate(args: &Args, lungs: &[BenchConfig], context: &Context<'_>) -> anyhow::Result<()> {
    let found = context.progress(|progress| without_each_part(lungs, &args.seeds, progress))?;
    let mut table =
        Table::new("A row that fails without a monitor or a response", &["without", "fault", "lung"]);
    for (part, row) in &found {
        let [fault, lung] = row.as_ref().map_or(["none", "-"], |row| [row.fault, row.lung.as_str()]);
        table.row(vec![Cell::text(part.name()), Cell::text(fault), Cell::text(lung)]);
    }
    let unnoticed: Vec<_> =
        found.iter().filter(|(_, row)| row.is_none()).map(|(part, _)| part.name()).collect();
    context.table(&table);
    if !unnoticed.is_empty() {
        bail!("no row fails without {}: add a fault that needs it", unnoticed.join(", "));
    }
    Ok(())
}

fn nominal(lungs: &[BenchConfig], breaths: u32, context: &Context<'_>) -> anyhow::Result<()> {
    let alarms = context.progress(|progress| false_alarms(lungs, breaths, progress))?;
    for (lung, fault) in &alarms {
        context.line(&format!("{lung}: {}", fault.alarm().text));
    }
    if !alarms.is_empty() {
        bail!("{} false alarms in {breaths} breaths", alarms.len());
    }
    context.line(&format!("no alarm in {breaths} breaths"));
    Ok(())
}

fn named(name: &str) -> anyhow::Result<Part> {
    Part::all().find(|part| part.name() == name).ok_or_else(|| {
        let all: Vec<&str> = Part::all().map(Part::name).collect();
        anyhow!("there is no monitor or response `{name}`; they are {}", all.join(", "))
    })
}

fn table(rows: &[FaultRow]) -> Table {
    let mut table = Table::new(
        "Faults; times in ms, pressures in cmH2O",
        &[
            "fault",
            "lung",
            "monitor",
            "detected",
            "response",
            "peak",
            "allowed",
            "breaths",
            "longest gap, s",
            "share of volume",
            "pass",
        ],
    );
    let time = |ms: Option<u32>| ms.map_or_else(|| Cell::right("-"), |ms| Cell::right(ms.to_string()));
    for row in rows {
        table.row(vec![
            Cell::text(row.fault),
            Cell::text(&row.lung),
            Cell::text(row.monitor.join(", ")),
            time(row.detect_ms),
            Cell::text(row.response),
            Cell::number(row.peak_true, 1),
            Cell::number(row.peak_allowed, 0),
            Cell::right(row.breaths_delivered.to_string()),
            Cell::number(row.longest_gap_s, 1),
            Cell::number(row.minute_volume_share, 2),
            Cell::text(if row.pass { "yes" } else { "NO" }),
        ]);
    }
    table
}

fn report(table: Table, limit: f32) -> Report {
    Report {
        title: "Faults and the monitors that detect them".into(),
        subtitle: format!("Every fault on every lung of the virtual bench, pressure limit at {limit} cmH2O."),
        sections: vec![Section {
            heading: "Matrix".into(),
            text: "The longest time over the seeds from the fault to the alarm, and the highest true airway pressure after it."
                .into(),
            blocks: vec![Block::Table(table)],
        }],
        provenance: Some(Provenance::new(DEFAULT_PERIOD_US, "faults")),
    }
}
