//! `lab margins-in-breaths`: the margins that `trainer margins` measures, beside the exact ones of the bench.

use serde::Serialize;
use shared::explore::sines::AMPLITUDE_MAX;

use host::args::bench::BenchesArgs;
use host::args::controller::ControllerArgs;
use host::command::bounds::within;
use host::command::{Command, Context, Makes, Output, OutputArgs};
use margins::connected::{AGREES, Agreement, Compared, Pair, compare};
use plant::bench::family::Family;
use show::report::{Cell, Table};
use tuning::interval::Finding;
use tuning::measurement::Plan;

/// Compare margins measured in breaths with those of the held bench
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  lab margins-in-breaths --bench paper
  lab margins-in-breaths --family adult --plants 40 --json breaths.json
  lab margins-in-breaths --bench R20C20 --controller adult

Each plant breathes and is measured as by `trainer margins`, at the lowest PIP of 20, 25, 30 and 35
cmH2O that makes all margins sure. Beside each margin stands the exact one: that of the bench held
at the mean pressure and flow of those breaths, as `lab margins` measures it. A margin agrees if it
is within 10 %, or if both lie outside the frequencies from 1.6 to 25 Hz; or it is not stated for
want of coherence, printed as ?. Exit status 1 if a margin is stated and does not agree. A learned
controller acts otherwise on a ramp than on a held plateau, so its margins need not agree.")]
pub struct Args {
    #[command(flatten)]
    controller: ControllerArgs,
    #[command(flatten)]
    benches: BenchesArgs,
    /// Random plants of a family, in place of --bench: adult, neonate, blower, or a TOML file
    #[arg(long, value_name = "NAME|FILE", conflicts_with = "bench")]
    family: Option<String>,
    /// Number of plants of the family
    #[arg(long, value_name = "N", requires = "family", default_value_t = 40, value_parser = within::<u32>(1, 1_000_000))]
    plants: u32,
    /// Amplitude of the sine, percent
    #[arg(long, value_name = "PERCENT", default_value_t = Plan::default().amplitude, value_parser = within::<f32>(0.1, AMPLITUDE_MAX))]
    amplitude: f32,
    /// Seed of the plants of a family, of the sensor noise and of the intervals
    #[arg(long, default_value_t = 1)]
    seed: u64,
    #[command(flatten)]
    output: OutputArgs,
}

/// The content of `--json`.
#[derive(Debug, Serialize)]
pub struct Summary {
    controller: String,
    seed: u64,
    amplitude: f32,
    plants: Vec<Compared>,
}

impl Command for Args {
    type Outcome = Summary;

    fn output(&self) -> Output<'_> {
        self.output.makes(Makes::Experiment)
    }

    fn run(&self, context: &Context<'_>) -> anyhow::Result<Option<Summary>> {
        let plants = match self.family.as_deref().map(Family::find).transpose()? {
            Some(family) => (0..self.plants).map(|number| family.draw(self.seed, number)).collect(),
            None => self.benches.benches()?,
        };
        let chosen = self.controller.chosen(None)?;
        let plan = Plan { amplitude: self.amplitude, seed: self.seed, ..Plan::default() };
        let compared = context.progress(|progress| {
            compare(&plants, chosen.chip()?, chosen.period_us, &plan, progress).map_err(anyhow::Error::from)
        })?;
        context.table(&table(&chosen.name, &compared));
        for line in counts(&compared) {
            context.line(&line);
        }
        if context.stopped() {
            context.line("stopped: only the plants measured so far are shown");
        }
        let Self { seed, amplitude, .. } = *self;
        Ok(Some(Summary { controller: chosen.name, seed, amplitude, plants: compared }))
    }

    fn conclude(&self, outcome: Summary, _context: &Context<'_>) -> anyhow::Result<()> {
        let differ = outcome
            .plants
            .iter()
            .flat_map(Compared::pairs)
            .filter(|(_, pair)| pair.agreement() == Agreement::Differs);
        let differ = differ.count();
        anyhow::ensure!(differ == 0, "{differ} stated margins differ by more than {:.0} %", 100.0 * AGREES);
        Ok(())
    }
}

fn table(controller: &str, compared: &[Compared]) -> Table {
    let mut table = Table::new(
        format!("Margins of {controller} in breaths, and exact"),
        &["plant", "PIP", "Ms", "exact", "gain", "exact", "delay, ms", "exact"],
    );
    for one in compared {
        let pip = one.measured.as_ref().map(|measured| measured.plan.settings.pip.into());
        let mut row = vec![Cell::text(&one.plant), Cell::known(pip, 0)];
        for ((_, Pair { found, exact, .. }), decimals) in one.pairs().into_iter().zip([2, 2, 1]) {
            row.push(match found {
                Finding::Found(sure) => Cell::number(sure.value, decimals),
                Finding::NotEnoughCoherence(_) => Cell::right("?"),
                Finding::OutsideFrequencies => Cell::right("outside"),
            });
            row.push(Cell::known(exact, decimals));
        }
        table.row(row);
    }
    table
}

/// How many margins agree, by margin.
fn counts(compared: &[Compared]) -> Vec<String> {
    let count = |place: usize, wanted: Agreement| {
        compared.iter().filter(|one| one.pairs()[place].1.agreement() == wanted).count()
    };
    let names = ["Ms", "gain margin", "delay margin"];
    let line = |(place, name): (usize, &str)| {
        format!(
            "{name}: {} of {} agree, {} have not enough coherence, {} differ",
            count(place, Agreement::Agrees),
            compared.len(),
            count(place, Agreement::NotEnoughCoherence),
            count(place, Agreement::Differs)
        )
    };
    names.into_iter().enumerate().map(line).collect()
}
