//! Records of `MakAir` ventilators, replayed on the bench from their commands alone. Shows how well it predicts breaths to which it was
//! not fitted, and what the family `blower` was drawn around: `cargo test -p plant records -- --nocapture`.

mod breaths;
mod fit;
mod replay;

use data::import::recorded_files;
use engine::least_squares::solve;
use toml::Table;

use self::breaths::{Breath, breaths};
use self::fit::fit;
use self::replay::{COUNT, PARAMETERS, Parameter, STATED_AT_CMH2O, Values, replay};
use crate::STEP_S;

/// One of so many breaths is held out.
const HELD_OUT: usize = 3;
/// Steps between two residuals: the records have a row in about as many.
const STRIDE: usize = 10;
/// Weights of a pressure in expiration and of a flow, L/s, beside one in inspiration.
const EXPIRED: f64 = 0.5;
const FLOW: f64 = 10.0;
const SHUT_OFF: &str = "valve.supply_pressure_cmh2o";
/// Parameters that the family varies, as it names them, by their place among [`PARAMETERS`].
const VARIED: [(usize, &str); 8] = [
    (0, SHUT_OFF),
    (1, "blower.drop_cmh2o_per_l2_s2"),
    (3, "blower.speed_lag_ms"),
    (4, "valve.dead_time_ms"),
    (5, "valve.lag_ms"),
    (6, "valve.dead_zone_percent"),
    (7, "valve.curve_exponent"),
    (8, "valve.max_flow_l_per_s"),
];

/// A record and what it shows.
struct Record {
    name: &'static str,
    /// Most mean error of the inspirations held out, cmH2O.
    most: f64,
    /// What the family does not hold of it.
    outside: &'static [&'static str],
}

/// The first has no flow: it shows the dynamics of a valve, but hardly what a blower gives.
const RECORDS: [Record; 4] = [
    Record {
        name: "v1-short-with-errors",
        most: 2.2,
        outside: &[SHUT_OFF, "blower.speed_lag_ms", "valve.lag_ms", "valve.curve_exponent"],
    },
    Record { name: "v2-a", most: 2.75, outside: &[SHUT_OFF, "blower.speed_lag_ms"] },
    Record { name: "v2-b", most: 2.2, outside: &[SHUT_OFF, "blower.drop_cmh2o_per_l2_s2"] },
    Record { name: "v2-c", most: 0.55, outside: &[] },
];

/// The values at a point of the unit box.
fn values(point: &[f64; COUNT]) -> Values {
    let mut values = *point;
    for (value, Parameter(_, low, high, _)) in values.iter_mut().zip(PARAMETERS) {
        *value = low + (high - low) * *value;
    }
    values
}

/// Weighted differences between replayed and measured pressures and flows.
fn residuals(values: &Values, breaths: &[&Breath]) -> Vec<f64> {
    let mut all = Vec::new();
    for breath in breaths {
        let shown = replay(values, breath, breath.pressures.len());
        for (step, (pressure, flow)) in shown.iter().enumerate().step_by(STRIDE) {
            let weight = if step < breath.inspired { 1.0 } else { EXPIRED };
            all.push(weight * (pressure - breath.pressures[step]));
            if let Some(flows) = &breath.flows {
                all.push(FLOW * (flow - flows[step][0]));
            }
        }
    }
    all
}

/// The machine and lung that follow these breaths best.
fn fitted(training: &[&Breath]) -> Values {
    let start = PARAMETERS.map(|Parameter(_, low, high, start)| (start - low) / (high - low));
    values(&fit(start, |point| residuals(&values(point), training)))
}

fn mean(numbers: impl Iterator<Item = f64>) -> f64 {
    let (count, sum) = numbers.fold((0, 0.0), |(count, sum), number| (count + 1, sum + number));
    sum / f64::from(count)
}

/// Mean error of the pressure in an inspiration, replayed from its commands, cmH2O.
fn error(values: &Values, breath: &Breath) -> f64 {
    let shown = replay(values, breath, breath.inspired);
    mean(shown.iter().zip(&breath.pressures).map(|((pressure, _), measured)| (pressure - measured).abs()))
}

/// Rows of the equation of motion over an inspiration: measured volume and flow, and the rise of the pressure; none without flow.
fn motion(breath: &Breath) -> Option<Vec<([f64; 2], f64)>> {
    let mut volume = 0.0;
    let row = |([inward, outward], pressure): (&[f64; 2], &f64)| {
        volume += (inward - outward) * STEP_S;
        ([volume, inward - outward], pressure - breath.start)
    };
    Some(breath.flows.as_ref()?.iter().zip(&breath.pressures).take(breath.inspired).map(row).collect())
}

/// Mean error of the equation of motion, which uses the measured flow, cmH2O.
fn classical(training: &[&Breath], held_out: &[&Breath]) -> Option<f64> {
    let training: Option<Vec<_>> = training.iter().map(|breath| motion(breath)).collect();
    let (columns, rises): (Vec<_>, Vec<_>) = training?.concat().into_iter().unzip();
    let [elastance, resistance] = solve(&columns, &rises)?.coefficients;
    let error =
        |([volume, flow], rise): &([f64; 2], f64)| (elastance * volume + resistance * flow - rise).abs();
    let errors: Option<Vec<f64>> =
        held_out.iter().map(|breath| Some(mean(motion(breath)?.iter().map(error)))).collect();
    Some(mean(errors?.into_iter()))
}

/// Names of the parameters that are not within the ranges of the family `blower`.
fn outside(values: &Values) -> Vec<&'static str> {
    let family: Table =
        toml::from_str(include_str!("../../../../../host/plant/src/bench/family/blower.toml")).unwrap();
    let is_within = |place: usize, path: &str| {
        let (table, name) = path.split_once('.').unwrap();
        let range = family["family"][table][name].as_table().unwrap().values().next().unwrap();
        let end = |n: usize| range[n].as_float().or(range[n].as_integer().map(|end| end as f64)).unwrap();
        (end(0)..=end(1)).contains(&values[place])
    };
    VARIED.iter().filter(|(place, path)| !is_within(*place, path)).map(|(_, path)| *path).collect()
}

/// Every record alone: a third of its breaths shows what the machine fitted to the others is worth.
#[test]
fn breaths_of_blower_machines_follow_from_their_commands() {
    for Record { name, most, outside: expected } in RECORDS {
        let Some(paths) = recorded_files("makair", &[&format!("{name}.record")]) else { return };
        let breaths: Vec<Breath> = breaths(&paths[0]);
        let part = |held_out: bool| {
            let of_part = |n: usize| (n % HELD_OUT == HELD_OUT - 1) == held_out;
            breaths.iter().enumerate().filter(|(n, _)| of_part(*n)).map(|(_, breath)| breath).collect()
        };
        let [training, held_out]: [Vec<&Breath>; 2] = [part(false), part(true)];
        let mut machine = fitted(&training);
        let error = mean(held_out.iter().map(|breath| error(&machine, breath)));
        let classical = classical(&training, &held_out);
        // The family states the full flow at the blower's own pressure.
        machine[8] *= (machine[0] / STATED_AT_CMH2O).sqrt();
        eprintln!("{name}: error {error:.2}, equation of motion {classical:.2?}");
        for (Parameter(parameter, ..), value) in PARAMETERS.iter().zip(machine) {
            eprintln!("    {parameter} = {value:.3}");
        }
        assert!(error < most, "{name}: {error}");
        assert!(classical.is_none_or(|classical| error < classical), "{name}: {error} {classical:?}");
        assert_eq!(outside(&machine), expected, "{name}");
    }
}
