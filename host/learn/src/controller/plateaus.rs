//! Plateaus on which the margins of the loops are measured in training.
//!
//! Each pair of rollouts is a machine with a lung at a drawn prescription. A constant flow is drawn out of the circuit, so that the
//! valve works where it works in a breath, as `lab margins` does it; the controller's clock stops within the plateau, and nothing is
//! remembered. Some loops have half or twice their gain, or more dead time: they must only stay far from oscillating.

use std::f32::consts::TAU;

use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;
use shared::breath::period_s;
use shared::math;
use shared::settings::Settings;

use super::config::FamilyConfig;
use super::courses::{prescription, strain};
use super::probe::{PAIRS, Probe, Sine};
use super::scenario::{Prescribed, Scenario, Strain};
use crate::simulator::BreathStart;
use engine::{LANES, Lane};

/// Time at which the window of the probe begins, s.
const SETTLED_S: f32 = 0.6;
/// Range of the window's length, s: with it, the frequencies of the sines vary.
const WINDOW_S: (f32, f32) = (1.0, 2.0);
/// Range of the time at which the clock stops, s.
const HELD_S: (f32, f32) = (0.4, 1.0);
/// Range of the flows, as shares of the valve's full flow.
const FLOW_SHARES: (f32, f32) = (0.08, 0.6);
/// Periods of the sines in the window, and their highest frequency, Hz.
const PERIODS: [usize; 16] = [1, 2, 3, 4, 5, 6, 8, 10, 13, 16, 20, 26, 32, 40, 52, 64];
const HIGHEST_HZ: f32 = 42.0;
/// Range of the amplitude of a sine alone, percent, and of all sines together, each.
const ALONE: (f32, f32) = (8.0, 20.0);
const TOGETHER: (f32, f32) = (2.0, 4.0);
/// Sensitivity from which a loop pays, as it is and strained.
const BOUNDS: (f32, f32) = (1.7, 3.0);
/// Share of the loops that are strained.
const STRAINED: f32 = 0.5;

/// Draws a shard's plateaus on some of `units` units, with a control period in microseconds.
pub(super) fn draw(units: u32, period_us: u32, config: &FamilyConfig, rng: &mut ChaCha8Rng) -> Scenario {
    let ticks_in = |time: f32| math::ticks(time, period_us) as usize;
    let window = (ticks_in(SETTLED_S), ticks_in(within(WINDOW_S, rng)));
    let ticks = window.0 + window.1;
    let settings: [Settings; LANES] = paired(
        |rng| {
            let usual = rng.random_range(0.0..1.0) < 0.5_f32;
            prescription(usual, config, rng)
        },
        rng,
    );
    let of = |value: fn(&Settings) -> f32| Lane::from_fn(|l| value(&settings[l]));
    let peep = of(|s| s.peep);
    let kinds = paired(|rng| strain(STRAINED, ticks_in(config.strain_delay), rng), rng);
    let strain = Strain { gain: Lane(kinds.map(|(gain, _)| gain)), delay: kinds.map(|(_, delay)| delay) };
    let bound = std::array::from_fn(|pair| if strain.is_on(pair) { BOUNDS.1 } else { BOUNDS.0 });
    let (start, noise) = (start(units, peep, rng), noise(ticks, config, rng));
    Scenario {
        ticks,
        // The sines and the flow move the pressure, as in no breath: to follow the target in spite of them must not be learned.
        scored_from: ticks,
        held_tick: ticks_in(within(HELD_S, rng)),
        prescribed: Prescribed::new(
            ticks,
            of(|s| s.pip),
            peep,
            settings.map(|s| ticks_in(s.rise_time).min(window.0) as u32),
        ),
        start,
        rest: Lane::ZERO,
        memory: None,
        settled: [window.0 / 2; LANES],
        strain,
        effort_price: config.effort_price,
        restraint_price: 0.0,
        noise,
        pull: Vec::new(),
        weight: Lane::splat(1.0),
        overshoot_weight: config.overshoot_weight,
        overshoot_from: Lane::ZERO,
        probe: Some(Probe {
            window,
            sines: sines(window.1 as f32 * period_s(period_us), rng),
            bound,
            price: config.margin_price,
        }),
    }
}

/// The start of a breath on drawn units at this PEEP, cmH2O, with a drawn flow.
fn start(units: u32, peep: Lane, rng: &mut ChaCha8Rng) -> BreathStart {
    BreathStart {
        pressure: peep,
        peep,
        plateau: peep,
        ventilator: paired(|rng| Some(rng.random_range(0..units)), rng),
        group: paired(|rng| Some(rng.random_range(0..units)), rng),
        drawn: Lane(paired(|rng| within(FLOW_SHARES, rng), rng)),
        ..BreathStart::default()
    }
}

/// Sensor noise of this many ticks, cmH2O.
fn noise(ticks: usize, config: &FamilyConfig, rng: &mut ChaCha8Rng) -> Vec<Lane> {
    let sd: [f32; LANES] = paired(|rng| within(config.noise, rng), rng);
    let mut of_tick = |_| {
        let normal: [f32; LANES] = paired(|rng| rng.sample(StandardNormal), rng);
        Lane::from_fn(|l| sd[l] * normal[l])
    };
    (0..ticks).map(&mut of_tick).collect()
}

/// Ticks of the longest plateau, with a control period in microseconds.
pub(super) fn longest(period_us: u32) -> usize {
    ((SETTLED_S + WINDOW_S.1) / period_s(period_us)).ceil() as usize + 1
}

/// The sines of a window of this length, s: in every second pair all together, in the others one of them.
fn sines(window_s: f32, rng: &mut ChaCha8Rng) -> Vec<Sine> {
    let periods: Vec<usize> =
        PERIODS.into_iter().filter(|periods| *periods as f32 <= HIGHEST_HZ * window_s).collect();
    let alone: [usize; PAIRS] = std::array::from_fn(|_| rng.random_range(0..periods.len()));
    let height: [f32; PAIRS] =
        std::array::from_fn(|pair| within(if pair % 2 == 0 { ALONE } else { TOGETHER }, rng));
    let sine = |(place, periods): (usize, usize)| Sine {
        periods,
        amplitude: std::array::from_fn(|pair| {
            if pair % 2 == 1 || alone[pair] == place { height[pair] } else { 0.0 }
        }),
        phase: TAU * rng.random_range(0.0..1.0_f32),
    };
    periods.into_iter().enumerate().map(sine).collect()
}

/// Draws a value for each pair of lanes.
fn paired<T: Copy>(mut draw: impl FnMut(&mut ChaCha8Rng) -> T, rng: &mut ChaCha8Rng) -> [T; LANES] {
    let pairs: [T; PAIRS] = std::array::from_fn(|_| draw(rng));
    std::array::from_fn(|l| pairs[l % PAIRS])
}

fn within((low, high): (f32, f32), rng: &mut ChaCha8Rng) -> f32 {
    rng.random_range(low..high)
}

#[cfg(test)]
mod tests {
    use super::*;
    use plant::prescriptions::Prescriptions;
    use rand_chacha::rand_core::SeedableRng;

    fn plateaus(seed: u64) -> Scenario {
        let prescriptions = Prescriptions::find("bedside").unwrap();
        let config = FamilyConfig { prescriptions, ..FamilyConfig::default() };
        draw(50, 1000, &config, &mut ChaCha8Rng::seed_from_u64(seed))
    }

    #[test]
    fn the_rollouts_of_a_pair_have_all_in_common_and_pairs_differ() {
        let drawn = plateaus(4);
        let lanes = [drawn.prescribed.pip, drawn.prescribed.peep, drawn.start.drawn, drawn.noise[700]];
        for lane in lanes {
            assert!((0..PAIRS).all(|pair| lane[pair].to_bits() == lane[pair + PAIRS].to_bits()));
            assert!((1..PAIRS).any(|pair| lane[pair].to_bits() != lane[0].to_bits()));
        }
        for members in [drawn.start.ventilator, drawn.start.group] {
            assert_eq!(members[..PAIRS], members[PAIRS..]);
        }
        assert_eq!(drawn.strain.delay[..PAIRS], drawn.strain.delay[PAIRS..]);
    }

    #[test]
    fn half_of_the_loops_are_strained_and_have_the_wider_bound() {
        let (mut strained, count) = (0, 100);
        for seed in 0..count {
            let drawn = plateaus(seed);
            let probe = drawn.probe.expect("a plateau has one");
            for (pair, bound) in probe.bound.iter().enumerate() {
                let wider = *bound > BOUNDS.0;
                assert_eq!(drawn.strain.is_on(pair), wider);
                strained += usize::from(wider);
            }
        }
        let share = strained as f32 / (count as usize * PAIRS) as f32;
        assert!((share - STRAINED).abs() < 0.05, "{share}");
    }

    #[test]
    fn the_sines_are_below_the_highest_frequency_and_every_second_pair_has_one_alone() {
        for seed in 0..20 {
            let drawn = plateaus(seed);
            let probe = drawn.probe.expect("a plateau has one");
            let window_s = 1e-3 * probe.window.1 as f32;
            assert!(probe.sines.iter().all(|sine| sine.periods as f32 / window_s <= HIGHEST_HZ));
            let count = |pair: usize| probe.sines.iter().filter(|sine| sine.amplitude[pair] > 0.0).count();
            assert!((0..PAIRS).all(|pair| (count(pair) == 1) == (pair % 2 == 0)));
            assert_eq!(drawn.ticks, probe.window.0 + probe.window.1);
            assert!(drawn.ticks < longest(1000));
        }
    }
}
