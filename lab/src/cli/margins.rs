//! `lab margins`: stability margins by sine injection, the residual's gain, the certificate of iterative learning, and the
//! accuracy of the pressure.

use std::path::Path;

use anyhow::bail;
use serde::Serialize;
use shared::control::pid::PidGains;
use shared::settings::Settings;

use crate::args::law::LawArgs;
use data::kind::Kind;
use host::args::bench::BenchesArgs;
use host::args::controller::Chosen;
use host::command::bounds::within;
use host::command::{Command, Context, Makes, OutFile, Output, OutputArgs, write};
use margins::iteration::{Certificate, Certified, LearningFilter, Spread};
use margins::operating_point::OperatingPoint;
use margins::response::Sweep;
use margins::{MeasuredPoint, Overall, PlantMargins, Question, measure};
use plant::bench::BenchConfig;
use plant::bench::family::Family;
use plant::prescriptions::{NAMES, Prescriptions};
use show::report::{Cell, Plot, Role, Series, Style, Table};
use trials::accuracy::{Declared, Setup, declared};
use tuning::figures;
use tuning::stability::{Margins, RequiredMargins};

/// Curves that a figure shows at most: those of the plants with the worst margins.
const CURVES: usize = 6;

/// Measure the stability margins of a controller by sine injection
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  lab margins --gains 6,290,0.21
  lab margins --controller out/once/controller.safetensors --bench paper --json margins.json
  lab margins --gains 6,290,0.21 --bench slow.toml --bench fast.toml --plot nyquist.svg
  lab margins --family adult --plants 100 --seed 2 --controller out/once/controller.safetensors
  lab margins --family adult --plants 100 --prescriptions bedside --controller adult
  lab margins --gains 2.5,60,0.08 --learning 2,50,15 --learning-plot learning.svg

A plateau is held at each of the paper's six PIPs, or on each plant at the PEEP and PIP of one of
the --prescriptions, and a sine is added to the command of the inspiratory valve. The ratio of the
commands before and after the sine is the loop gain L. From it: Ms, the largest abs(1 / (1 + L));
the gain, phase and delay margins; and the disk margin. A robust loop keeps Ms at most 2, a gain
margin of at least 2 and a delay margin of at least 10 ms.

A plateau needs almost no flow, so the valve would be nearly closed and the sine cut. Therefore the
mean flow of an inspiration is drawn out of the circuit, whatever its pressure. Backlash makes the
margins depend on the amplitude of the sine: they are measured at twice the amplitude too.

For a learned controller, the PID underneath is measured as well, and the residual's gain: the
largest response of the residual to the measured pressure in recorded breaths, by the Jacobian of
its network, and its product with the PID's loop. Below one, the residual cannot destabilise that
loop; above one, it might.

The accuracy is the smallest +-(A + B % of the target) that holds for the true pressure at the end
of each phase, on all plants on which the ventilator does not stop, at PEEP 5 and 10, without a
leak and with one of 0.1 L/s at 30 cmH2O.

With --learning, the controller is the one under iterative learning control; --controller iterative
and gated have rules of their own, and their margins are those of the PID or the learned controller
underneath. The largest factor on an error from breath to breath is printed, and the number of
plants on which it is below one at every frequency: there, what is wrong dies out. It says nothing
about what a learned controller does with remembered breaths; `lab robust` counts plants on
which a later breath is worse.")]
pub struct Args {
    #[command(flatten)]
    law: LawArgs,
    #[command(flatten)]
    benches: BenchesArgs,
    /// Random plants of a family, in place of --bench: adult, neonate, blower, or a TOML file
    #[arg(long, value_name = "NAME|FILE", conflicts_with = "bench")]
    family: Option<String>,
    /// Prescriptions: paper, its six PIPs on each plant; bedside, or a TOML file, one plateau drawn for each plant
    #[arg(long, value_name = "NAME|FILE", default_value = NAMES[0])]
    prescriptions: String,
    /// Number of plants of the family
    #[arg(long, value_name = "N", requires = "family", default_value_t = 20, value_parser = within::<u32>(1, 1_000_000))]
    plants: u32,
    /// Amplitude of the sine, percent
    #[arg(long, value_name = "PERCENT", default_value_t = Sweep::default().amplitude, value_parser = within::<f64>(0.01, 50.0))]
    amplitude: f64,
    /// Iterative learning to certify: gain in percent per cmH2O, lead and half base of the triangle in ms [default: that of
    /// --controller iterative or gated]
    #[arg(long, value_name = "GAIN,MS,MS", value_parser = learning)]
    learning: Option<LearningFilter>,
    /// Seed of the plants of a family and of the sensor noise
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Write the Nyquist plot of the worst loops as SVG
    #[arg(long, value_name = "FILE.svg", value_parser = OutFile::of(Kind::Picture))]
    plot: Option<OutFile>,
    /// Write the factors of iterative learning over frequency as SVG, of several plants with their median and 95 %
    #[arg(long, value_name = "FILE.svg", value_parser = OutFile::of(Kind::Picture))]
    learning_plot: Option<OutFile>,
    #[command(flatten)]
    output: OutputArgs,
}

/// The content of `--json`.
#[derive(Debug, Serialize)]
pub struct Summary {
    controller: String,
    weights_id: Option<String>,
    gains: PidGains,
    period_us: u32,
    seed: u64,
    prescriptions: String,
    sweep: Sweep,
    required: RequiredMargins,
    #[serde(flatten)]
    overall: Overall,
    accuracy: Vec<Declared>,
    #[serde(skip_serializing_if = "Option::is_none")]
    learning: Option<Certificate>,
    plants: Vec<PlantMargins>,
}

fn learning(text: &str) -> Result<LearningFilter, String> {
    let numbers: Vec<f64> = text.split(',').filter_map(|part| part.trim().parse().ok()).collect();
    match numbers[..] {
        [gain, lead_ms, half_base_ms] if numbers.iter().all(|number| (0.0..=1000.0).contains(number)) => {
            Ok(LearningFilter { gain, lead_s: 1e-3 * lead_ms, half_base_s: 1e-3 * half_base_ms })
        }
        _ => Err("write gain, lead and half base, such as 2,50,15".into()),
    }
}

impl Command for Args {
    type Outcome = Summary;

    fn output(&self) -> Output<'_> {
        self.output.makes(Makes::Experiment)
    }

    fn run(&self, context: &Context<'_>) -> anyhow::Result<Option<Summary>> {
        let family = self.family.as_deref().map(Family::find).transpose()?;
        let plants = plants(self, family.as_ref())?;
        let chosen = match &family {
            Some(family) => self.law.chosen_for(family)?,
            None => self.law.chosen(None)?,
        };
        if self.learning_plot.is_some() && learning_of(self, &chosen).is_none() {
            bail!(
                "--learning-plot needs a learning rule: give --learning, or choose --controller iterative or gated"
            );
        }
        let sweep = Sweep::default().with_amplitude(self.amplitude);
        let prescriptions = prescriptions(self, family.as_ref(), plants.len() as u32)?;
        let question = Question { prescriptions, period_us: chosen.period_us, sweep, seed: self.seed };
        let (measured, accuracy) = context.progress(|progress| -> anyhow::Result<_> {
            let measured = measure(&plants, &chosen.controller, chosen.residual(), &question, progress)?;
            let setup = Setup { period_us: chosen.period_us, seed: self.seed };
            Ok((measured, declared(&plants, &chosen.controller, setup, progress)?))
        })?;
        if measured.is_empty() {
            context.line("stopped before the first plant was measured");
            return Ok(None);
        }
        let summary = summary(self, &chosen, sweep, measured, accuracy);
        print(self, &summary, context);
        if let Some(file) = &self.plot {
            save(file, &nyquist(&summary.plants), context)?;
        }
        if let (Some(file), Some(learning)) = (&self.learning_plot, &summary.learning) {
            save(file, &contraction(learning), context)?;
        }
        Ok(Some(summary))
    }
}

/// The learning rule to certify: the given one, or the controller's own.
fn learning_of(args: &Args, chosen: &Chosen) -> Option<LearningFilter> {
    args.learning.or_else(|| laws::rivals::learning(&chosen.controller))
}

/// The chosen plants.
fn plants(args: &Args, family: Option<&Family>) -> anyhow::Result<Vec<BenchConfig>> {
    match family {
        Some(family) => Ok((0..args.plants).map(|number| family.draw(args.seed, number)).collect()),
        None => args.benches.benches(),
    }
}

/// A prescription for each plant; none for the paper's, which are all measured on each.
fn prescriptions(args: &Args, family: Option<&Family>, plants: u32) -> anyhow::Result<Option<Vec<Settings>>> {
    if args.prescriptions == NAMES[0] {
        return Ok(None);
    }
    let prescriptions = match family {
        Some(family) => family.prescriptions(&args.prescriptions)?,
        None => Prescriptions::find(&args.prescriptions)?,
    };
    Ok(Some((0..plants).map(|number| prescriptions.draw(args.seed, number)).collect()))
}

fn summary(
    args: &Args,
    chosen: &Chosen,
    sweep: Sweep,
    plants: Vec<PlantMargins>,
    accuracy: Vec<Declared>,
) -> Summary {
    let required = RequiredMargins::default();
    let learning = learning_of(args, chosen).map(|filter| Certificate::of(filter, &plants, chosen.period_us));
    Summary {
        controller: chosen.name.clone(),
        weights_id: chosen.weights_id.clone(),
        gains: chosen.gains(),
        period_us: chosen.period_us,
        seed: args.seed,
        prescriptions: args.prescriptions.clone(),
        sweep,
        overall: Overall::of(&plants, &required),
        required,
        accuracy,
        learning,
        plants,
    }
}

/// Prints the tables.
fn print(args: &Args, summary: &Summary, context: &Context<'_>) {
    let several = summary.plants.len() > 1;
    let title = format!("Margins of {}, sine of {} %", summary.controller, args.amplitude);
    context.table(&if several {
        let points = if args.prescriptions == NAMES[0] { "worst of six PIPs" } else { "a plateau each" };
        by_plant(&format!("{title}, {points}"), &summary.plants)
    } else {
        by_pip(&title, &summary.plants[0])
    });
    let robust = (summary.overall.share_robust * summary.plants.len() as f64).round();
    let RequiredMargins { ms, gain_margin, delay_margin_ms } = summary.required;
    context.line(&format!(
        "{robust} of {} plants keep Ms {ms}, gain margin {gain_margin} and delay margin {delay_margin_ms} ms",
        summary.plants.len()
    ));
    if let Some(gain) = &summary.overall.residual {
        for (name, largest) in [
            ("to the pressure, %/cmH2O", gain.direct),
            ("with its own commands fed back, %/cmH2O", gain.residual),
            ("times the loop of its PID", gain.times_loop),
        ] {
            context.line(&format!(
                "largest gain of the residual {name}: {:.2} (at {:.1} Hz, PIP {})",
                largest.value,
                largest.hz,
                tenths(largest.pip)
            ));
        }
    }
    if let Some(learning) = &summary.learning
        && let Some(worst) = learning.worst
    {
        context.line(&format!(
            "iterative learning: largest factor on an error from breath to breath {:.3} (at {:.1} Hz)",
            worst.factor, worst.hz
        ));
        let certified = learning.plants.iter().filter(|plant| plant.certified).count();
        context.line(&format!(
            "{certified} of {} plants are certified: factor below one at every frequency, no loop that oscillates by itself",
            learning.plants.len()
        ));
    }
    context.table(&accuracy_table(&summary.accuracy));
    if context.stopped() {
        context.line("stopped: only the plants measured so far are shown");
    }
}

/// Columns of margins, with the number of decimals.
type Column = (&'static str, usize, fn(&Margins) -> Option<f64>);

const COLUMNS: [Column; 6] = [
    ("Ms", 2, |margins| Some(margins.ms)),
    ("gain margin", 2, |margins| margins.gain_margin),
    ("phase margin, deg", 1, |margins| margins.phase_margin_deg),
    ("delay margin, ms", 1, |margins| margins.delay_margin_ms),
    ("disk margin", 2, |margins| Some(margins.disk_margin)),
    ("crossover, Hz", 1, |margins| margins.crossover_hz),
];

/// A table with these first columns, then the margins and Ms at twice the amplitude.
fn margins_table(title: &str, first: &[&str]) -> Table {
    let mut table = Table::new(title, first);
    table.header.extend(COLUMNS.map(|(name, ..)| name.to_owned()));
    table.header.push("Ms, doubled sine".to_owned());
    table
}

fn margins_row(table: &mut Table, mut row: Vec<Cell>, margins: Option<&Margins>, doubled: Option<f64>) {
    let cell = |(_, decimals, value): Column| Cell::known(margins.and_then(value), decimals);
    row.extend(COLUMNS.map(cell));
    row.push(Cell::known(doubled, 2));
    table.row(row);
}

/// A pressure to a tenth, cmH2O: drawn ones have many decimals.
fn tenths(pressure: f32) -> f32 {
    (10.0 * pressure).round() / 10.0
}

/// PIP of a plateau, and its PEEP unless it is the paper's.
fn plateau(OperatingPoint { pip, peep, .. }: &OperatingPoint) -> String {
    let papers = peep.to_bits() == Settings::default().peep.to_bits();
    let peep = if papers { String::new() } else { format!(", PEEP {}", tenths(*peep)) };
    format!("{}{peep}", tenths(*pip))
}

/// The loops of a plant, by PIP. A loop that oscillates by itself has no margins.
fn by_pip(title: &str, plant: &PlantMargins) -> Table {
    let mut table = margins_table(&format!("{title}, on {}", plant.plant), &["PIP", "flow, L/s"]);
    let mut rows = |name: &str, points: &[MeasuredPoint]| {
        for measured in points {
            let first = vec![
                Cell::right(format!("{name}{}", plateau(&measured.point))),
                Cell::number(measured.point.flow_l_s, 2),
            ];
            let doubled = measured.doubled.map(|margins| margins.ms);
            margins_row(&mut table, first, measured.margins.as_ref(), doubled);
        }
    };
    rows("", &plant.points);
    if let Some(pid) = &plant.pid {
        rows("PID alone, ", &pid.points);
    }
    table
}

/// The worst margins of every plant. A plant with a loop that oscillates by itself has none.
fn by_plant(title: &str, plants: &[PlantMargins]) -> Table {
    let mut table = margins_table(title, &["plant"]);
    for plant in plants {
        let first = vec![Cell::text(&plant.plant)];
        margins_row(&mut table, first, plant.worst.as_ref(), highest_doubled(&plant.points));
        if let Some(pid) = &plant.pid {
            let first = vec![Cell::text(format!("{}, PID alone", plant.plant))];
            margins_row(&mut table, first, pid.worst.as_ref(), highest_doubled(&pid.points));
        }
    }
    table
}

fn highest_doubled(points: &[MeasuredPoint]) -> Option<f64> {
    points
        .iter()
        .map(|point| point.doubled.map(|margins| margins.ms))
        .collect::<Option<Vec<_>>>()?
        .into_iter()
        .reduce(f64::max)
}

fn accuracy_table(declared: &[Declared]) -> Table {
    let mut table = Table::new(
        "Accuracy of the true pressure: +-(A + B % of the target)",
        &["end of", "leak", "plants", "A, cmH2O", "B, %"],
    );
    for end in declared {
        // Rounded up: the declared accuracy must hold.
        let up = |value: f64| (1e2 * value).ceil() / 1e2;
        table.row(vec![
            Cell::text(end.phase),
            Cell::text(if end.leak { "yes" } else { "no" }),
            Cell::count(end.plants),
            Cell::known(end.accuracy.map(|accuracy| up(accuracy.absolute)), 2),
            Cell::known(end.accuracy.map(|accuracy| up(accuracy.percent)), 2),
        ]);
    }
    table
}

/// The point of a plant with the highest Ms; an oscillating one before all others.
fn worst_point(plant: &PlantMargins) -> Option<&MeasuredPoint> {
    let ms = |point: &MeasuredPoint| point.margins.map_or(f64::INFINITY, |margins| margins.ms);
    plant.points.iter().max_by(|one, other| ms(one).total_cmp(&ms(other)))
}

/// The plants with the worst margins, each with its worst point, the worst first.
fn worst_plants(plants: &[PlantMargins]) -> Vec<(&str, &MeasuredPoint)> {
    let mut worst: Vec<_> =
        plants.iter().filter_map(|plant| Some((plant.plant.as_str(), worst_point(plant)?))).collect();
    let ms = |point: &MeasuredPoint| point.margins.map_or(f64::INFINITY, |margins| margins.ms);
    worst.sort_by(|one, other| ms(other.1).total_cmp(&ms(one.1)));
    worst.truncate(CURVES);
    worst
}

/// Nyquist plot of the worst loops.
fn nyquist(plants: &[PlantMargins]) -> Plot {
    let named = |(plant, measured): (&str, &MeasuredPoint)| {
        (format!("{plant}, PIP {}", plateau(&measured.point)), measured.response.clone())
    };
    figures::nyquist(&worst_plants(plants).into_iter().map(named).collect::<Vec<_>>())
}

/// Factor of iterative learning over frequency: that of every plant and, of several, how it spreads.
fn contraction(certificate: &Certificate) -> Plot {
    let several = certificate.plants.len() > 1;
    let curve = |plant: &Certified| {
        let points = plant.curve.iter().map(|at| (at.hz, at.factor)).collect();
        let name = if several { "" } else { plant.plant.as_str() };
        Series { role: several.then_some(Role::Background), ..Series::new(name, Style::Line, points) }
    };
    let mut series: Vec<Series> = certificate.plants.iter().map(curve).collect();
    if several {
        let spread = certificate.spread();
        let over = |name: &str, of: fn(&Spread) -> f64| {
            Series::new(name, Style::Line, spread.iter().map(|at| (at.hz, of(at))).collect())
        };
        series.push(over("median of the plants", |at| at.median));
        series.push(over("95 %", |at| at.most));
        series.push(over("largest", |at| at.largest));
    }
    let (low, high) = Sweep::default().range_hz;
    series.push(Series::new("limit", Style::Dashed, vec![(low, 1.0), (high, 1.0)]));
    Plot::new("Factor on an error from breath to breath", "frequency, Hz", "abs(Q (1 - L P S))", series)
}

fn save(file: &Path, plot: &Plot, context: &Context<'_>) -> anyhow::Result<()> {
    write(file, plot.to_svg()?.as_bytes())?;
    context.saved(file);
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_learning_rule_is_three_numbers_in_percent_and_milliseconds() {
        assert_eq!(learning("2,50,15"), Ok(LearningFilter::default()));
        for refused in ["2,50", "2,50,x", "-1,50,15", "2,5000,15"] {
            assert!(learning(refused).is_err(), "{refused}");
        }
    }
}
