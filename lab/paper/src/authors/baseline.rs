//! Reference scores on the balloon: the authors' best PI, the best that any commands reach, and what an ideal valve would reach.

use std::cmp::Ordering;

use rayon::prelude::*;
use shared::breath::PAPER_PIPS;
use shared::control::COMMAND_MAX;

use plant::balloon::{Balloon, SAMPLES};

use super::mean_error;

/// The authors' leaky integral: the share of its distance to the error that it closes in a control period of 0.03 s,
/// with a time constant of 0.5 s.
const INTEGRAL_SHARE: f64 = 0.03 / (0.03 + 0.5);

/// Command from which on the valve is fully open, percent.
const COMMAND_FULL: f64 = 30.0;

/// Gains of the authors' PI, with its score.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GridBest {
    /// Percent per cmH2O.
    pub p: f64,
    /// Percent per cmH2O of the leaky integral.
    pub i: f64,
    /// Score, cmH2O.
    pub score: f64,
}

/// The best PI on the authors' grid, P and I each of 0, 0.1 .. 0.9, 1 .. 10, by exhaustive search.
pub fn best_pi() -> GridBest {
    let gains: Vec<f64> = (0..10).map(|n| f64::from(n) / 10.0).chain((1..=10).map(f64::from)).collect();
    let points = gains.iter().flat_map(|p| gains.iter().map(move |i| (*p, *i)));
    let scored = points.map(|(p, i)| GridBest { p, i, score: pi(p, i) });
    let nothing = GridBest { p: 0.0, i: 0.0, score: f64::INFINITY };
    scored.fold(nothing, |best, point| if point.score < best.score { point } else { best })
}

/// Score of the authors' PI with these gains, cmH2O.
pub fn pi(p: f64, i: f64) -> f64 {
    mean_over_pips(|pip| {
        let mut integral = 0.0;
        move |balloon: &mut Balloon| {
            let error = pip - balloon.pressure();
            integral += INTEGRAL_SHARE * (error - integral);
            balloon.inspire((p * error + i * integral).clamp(0.0, f64::from(COMMAND_MAX)));
        }
    })
}

/// Steps of the command that [`bound`] tries between a closed and an open valve, percent.
const BOUND_STEP: f64 = 0.01;

/// The lowest score that any commands reach, cmH2O: full flow, one part of it, then the closed valve.
///
/// The valve cannot close fully, so the volume grows in every sample by at least the flow of the closed valve. Whatever the commands,
/// some sequence of this form is in no sample farther from the target: it is ahead of them, but not beyond the target, up to the
/// sample in which they pass it, and behind them, but not below the target, from then on.
pub fn bound() -> f64 {
    let parts = (COMMAND_FULL / BOUND_STEP) as u32;
    let best = |pip: f64| {
        let sequences = (0..SAMPLES).flat_map(|full| (0..=parts).map(move |part| (full, part)));
        let scores = sequences.map(|(full, part)| {
            let (mut balloon, mut error) = (Balloon::default(), 0.0);
            for sample in 0..SAMPLES {
                error += (balloon.pressure() - pip).abs();
                balloon.inspire(match sample.cmp(&full) {
                    Ordering::Less => COMMAND_FULL,
                    Ordering::Equal => BOUND_STEP * f64::from(part),
                    Ordering::Greater => 0.0,
                });
            }
            error / SAMPLES as f64
        });
        scores.fold(f64::INFINITY, f64::min)
    };
    let pips = PAPER_PIPS.map(f64::from);
    pips.into_par_iter().map(best).collect::<Vec<_>>().iter().sum::<f64>() / pips.len() as f64
}

/// Score of full flow up to the target and an exact hold from then on, cmH2O: that of an ideal valve, which closes fully.
pub fn floor() -> f64 {
    mean_over_pips(|pip| move |balloon: &mut Balloon| balloon.inspire_towards(pip))
}

/// Mean score over the PIPs of the runs under `controller`.
fn mean_over_pips<C: FnMut(&mut Balloon)>(controller: impl Fn(f64) -> C) -> f64 {
    let score = |pip: f64| {
        let (mut balloon, mut step) = (Balloon::default(), controller(pip));
        let pressure: Vec<f64> = (0..SAMPLES)
            .map(|_| {
                let pressure = balloon.pressure();
                step(&mut balloon);
                pressure
            })
            .collect();
        mean_error(&pressure, pip)
    };
    PAPER_PIPS.iter().map(|pip| score(f64::from(*pip))).sum::<f64>() / PAPER_PIPS.len() as f64
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::RngExt;
    use rand_chacha::ChaCha8Rng;
    use rand_chacha::rand_core::SeedableRng;

    #[test]
    fn the_best_pi_of_the_grid_is_the_known_one() {
        let best = best_pi();
        assert!((best.p - 5.0).abs() < 1e-9 && (best.i - 2.0).abs() < 1e-9, "{best:?}");
        assert!((best.score - 2.239).abs() < 1e-3, "{best:?}");
    }

    #[test]
    fn the_authors_own_gains_score_as_measured_with_their_code() {
        assert!((pi(3.0, 4.0) - 2.597).abs() < 1e-3);
    }

    #[test]
    fn no_random_commands_score_below_the_bound_and_the_ideal_valve_does() {
        let bound = bound();
        assert!((bound - 1.959).abs() < 1e-3, "{bound}");
        assert!(floor() < bound && bound < best_pi().score);
        let mut rng = ChaCha8Rng::seed_from_u64(3);
        for _ in 0..2000 {
            // Full flow for a while, then a small command that wanders.
            let (rise, small) = (rng.random_range(1..7), rng.random_range(0.0..20.0));
            let scored = mean_over_pips(|pip| {
                let (mut sample, mut rng) = (0, ChaCha8Rng::seed_from_u64(pip as u64));
                move |balloon: &mut Balloon| {
                    sample += 1;
                    let high = sample <= rise && balloon.pressure() < pip - 3.0;
                    balloon.inspire(if high { COMMAND_FULL } else { small * rng.random::<f64>() });
                }
            });
            assert!(scored > bound, "{scored}");
        }
    }

    #[test]
    fn the_valve_is_fully_open_from_the_command_on_that_the_bound_uses() {
        let raised = |command| {
            let mut balloon = Balloon::default();
            balloon.inspire(command);
            balloon.volume()
        };
        assert_eq!(raised(COMMAND_FULL).to_bits(), raised(f64::from(COMMAND_MAX)).to_bits());
        assert!(raised(COMMAND_FULL - 2.0) < raised(COMMAND_FULL));
    }

    #[test]
    fn the_floor_is_the_known_one() {
        assert!((floor() - 1.758).abs() < 1e-3, "{}", floor());
    }
}
