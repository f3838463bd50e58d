//! Unrecorded units, drawn around those that were learned.

use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;
use serde::{Deserialize, Serialize};

use super::{PER_UNIT, USUAL, VALVE, lung, valve};

/// Share of a parameter's spread between the learned units by which a drawn one deviates from its model.
const BLUR: f32 = 0.3;

const FULL_FLOW: usize = valve::FULL_FLOW;
const CIRCUIT: usize = VALVE + lung::CIRCUIT;
/// Parameters that contain the scale of the flow, each with its power.
const FLOW_SCALE: [(usize, f32); 8] = [
    (FULL_FLOW, 1.0),
    (VALVE + lung::RESISTANCE, -1.0),
    (VALVE + lung::TURBULENCE, -1.0),
    (VALVE + lung::COMPLIANCE, 1.0),
    (VALVE + lung::LEAK, 1.0),
    (CIRCUIT, 1.0),
    (VALVE + lung::ORIFICE, 1.0),
    (VALVE + lung::OUTWARD, -1.0),
];
/// Parameters of the lung; all others are the machine's.
const OF_LUNG: [usize; 4] =
    [VALVE + lung::RESISTANCE, VALVE + lung::TURBULENCE, VALVE + lung::COMPLIANCE, VALVE + lung::INFLECTION];
/// Deviation of a valve's numbers between machines of one type, as a share.
const UNIT_SPREAD: f32 = 0.03;

/// Rescales the flow of each unit so that its circuit has the usual compliance: pressures alone do not tell the scale of the flow.
pub fn normalise(learned: &mut [f32]) {
    for unit in learned.chunks_exact_mut(PER_UNIT) {
        let scale = USUAL[CIRCUIT].ln() - unit[CIRCUIT];
        for (n, power) in FLOW_SCALE {
            unit[n] += power * scale;
        }
    }
}

/// Draws the parameters of `count` units. Each parameter is that of a random learned unit, independently of the others, blurred by
/// a share of its spread: units combine as machines and lungs do.
pub fn draw(learned: &[f32], count: usize, rng: &mut ChaCha8Rng) -> Vec<f32> {
    let units: Vec<&[f32]> = learned.chunks_exact(PER_UNIT).collect();
    let spread: Vec<f32> = (0..PER_UNIT).map(|n| deviation(units.iter().map(|unit| unit[n]))).collect();
    (0..count * PER_UNIT)
        .map(|place| {
            let n = place % PER_UNIT;
            let normal: f32 = rng.sample(StandardNormal);
            units[rng.random_range(0..units.len())][n] + BLUR * spread[n] * normal
        })
        .collect()
}

/// Standard deviations of the units drawn around a recorded one, as shares of its numbers.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Around {
    /// Of the machine's numbers.
    pub machine: f32,
    /// Of the lung's numbers in the first half of the units.
    pub lung: f32,
    /// Of the lung's numbers in the other half: other lungs on the same machine.
    pub other_lungs: f32,
}

/// Draws the parameters of `count` units around one recorded unit.
pub fn around(recorded: &[f32], count: usize, deviations: &Around, rng: &mut ChaCha8Rng) -> Vec<f32> {
    (0..count * PER_UNIT)
        .map(|place| {
            let (unit, n) = (place / PER_UNIT, place % PER_UNIT);
            let deviation = match (OF_LUNG.contains(&n), unit < count / 2) {
                (false, _) => deviations.machine,
                (true, true) => deviations.lung,
                (true, false) => deviations.other_lungs,
            };
            let normal: f32 = rng.sample(StandardNormal);
            recorded[n] + deviation * normal
        })
        .collect()
}

/// Replaces the machine of the first units by that of a learned simulator, its valve's parameters each with a small deviation, as
/// machines of one type differ. The scale of the flow is that of its lungs' mean circuit.
pub fn put_machine(learned: &[f32], units: &mut [f32], count: usize, rng: &mut ChaCha8Rng) {
    let lungs = learned.chunks_exact(PER_UNIT);
    let circuit = lungs.clone().map(|lung| lung[CIRCUIT]).sum::<f32>() / lungs.len() as f32;
    let mut machine = learned[..VALVE].to_vec();
    machine[FULL_FLOW] += USUAL[CIRCUIT].ln() - circuit;
    for unit in units.chunks_exact_mut(PER_UNIT).take(count) {
        for (parameter, number) in unit.iter_mut().zip(&machine) {
            let normal: f32 = rng.sample(StandardNormal);
            *parameter = number + UNIT_SPREAD * normal;
        }
    }
}

/// Moves resistance and compliance of the first units to the ends of those of the learned ones: each is the lowest, the highest, or
/// stays, with the same probability. Independent draws hardly ever have both at an end, where a lung is hardest to control.
pub fn put_extremes(learned: &[f32], units: &mut [f32], count: usize, rng: &mut ChaCha8Rng) {
    for n in [VALVE + lung::RESISTANCE, VALVE + lung::COMPLIANCE] {
        let numbers = learned.chunks_exact(PER_UNIT).map(|unit| unit[n]);
        let (low, high) =
            numbers.fold((f32::INFINITY, f32::NEG_INFINITY), |(low, high), x| (low.min(x), high.max(x)));
        for unit in units.chunks_exact_mut(PER_UNIT).take(count) {
            match rng.random_range(0..3) {
                0 => unit[n] = low,
                1 => unit[n] = high,
                _ => {}
            }
        }
    }
}

/// Standard deviation.
fn deviation(values: impl Iterator<Item = f32> + Clone) -> f32 {
    let count = values.clone().count() as f32;
    let mean = values.clone().sum::<f32>() / count;
    (values.map(|value| (value - mean) * (value - mean)).sum::<f32>() / count).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::simulator::unit::UnitConfig;
    use rand_chacha::rand_core::SeedableRng;

    #[test]
    fn drawn_units_have_the_spread_of_the_learned_ones_and_combine_their_numbers() {
        let mut learned = UnitConfig::for_period(1000, 40).initialise();
        for (n, parameter) in learned.iter_mut().enumerate() {
            if n % PER_UNIT == 3 {
                *parameter = if n / PER_UNIT < 20 { 1.0 } else { 3.0 };
            }
        }
        let drawn = draw(&learned, 2000, &mut ChaCha8Rng::seed_from_u64(1));
        let of = |number: usize| drawn.chunks_exact(PER_UNIT).map(move |unit| unit[number]);
        // The variance of the blur adds to that of the units.
        assert!((deviation(of(3)) - (1.0 + BLUR * BLUR).sqrt()).abs() < 0.05);
        assert!(deviation(of(4)) < 1e-3, "what does not differ is not spread");
    }

    #[test]
    fn units_around_a_recorded_one_deviate_from_it_as_machines_and_as_lungs() {
        let mut recorded = UnitConfig::for_period(1000, 1).initialise();
        for parameter in &mut recorded {
            *parameter += 0.3;
        }
        let deviations = Around { machine: 0.05, lung: 0.1, other_lungs: 0.4 };
        let drawn = around(&recorded, 8000, &deviations, &mut ChaCha8Rng::seed_from_u64(1));
        let (first, rest) = drawn.split_at(drawn.len() / 2);
        for (n, expected) in recorded.iter().enumerate() {
            let of_lung = OF_LUNG.contains(&n);
            for (units, of_lungs) in [(first, 0.1), (rest, 0.4)] {
                let of = units.chunks_exact(PER_UNIT).map(|unit| unit[n]);
                let share = if of_lung { of_lungs } else { 0.05 };
                assert!((deviation(of.clone()) / share - 1.0).abs() < 0.05, "parameter {n}");
                assert!((of.sum::<f32>() / 4000.0 - expected).abs() < 0.1 * share, "parameter {n}");
            }
        }
    }

    #[test]
    fn the_scale_of_the_flow_is_that_of_the_usual_circuit_and_what_pressures_tell_stays() {
        let mut learned = UnitConfig::for_period(1000, 1).initialise();
        learned[CIRCUIT] += 0.4;
        let before = learned.clone();
        normalise(&mut learned);
        assert!((learned[CIRCUIT] - USUAL[CIRCUIT].ln()).abs() < 1e-6);
        let (flow, resistance, compliance) = (FULL_FLOW, VALVE + lung::RESISTANCE, VALVE + lung::COMPLIANCE);
        let change = |n: usize| learned[n] - before[n];
        assert!((change(flow) + 0.4).abs() < 1e-6 && (change(resistance) - 0.4).abs() < 1e-6);
        assert!((change(resistance) + change(compliance)).abs() < 1e-6, "time constants stay");
        assert!((0..5).all(|n| change(n).abs() < 1e-9), "and so does the valve");
    }

    #[test]
    fn both_ends_of_resistance_and_compliance_meet_in_a_ninth_of_the_extreme_lungs() {
        let mut learned = UnitConfig::for_period(1000, 40).initialise();
        let (resistance, compliance) = (VALVE + lung::RESISTANCE, VALVE + lung::COMPLIANCE);
        for (n, unit) in learned.chunks_exact_mut(PER_UNIT).enumerate() {
            (unit[resistance], unit[compliance]) = (n as f32, (n * n % 40) as f32);
        }
        let before = draw(&learned, 2000, &mut ChaCha8Rng::seed_from_u64(1));
        let mut drawn = before.clone();
        put_extremes(&learned, &mut drawn, 1800, &mut ChaCha8Rng::seed_from_u64(2));
        let corners = drawn.chunks_exact(PER_UNIT).filter(|u| u[resistance] == 0.0 && u[compliance] == 0.0);
        assert!((150..250).contains(&corners.count()));
        assert_eq!(drawn[1800 * PER_UNIT..], before[1800 * PER_UNIT..], "the others stay");
    }
}
