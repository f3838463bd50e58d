//! Reference scores on the balloon: the authors' best PI, and a lower bound (full flow, then an exact hold).

use shared::breath::PAPER_PIPS;
use shared::control::COMMAND_MAX;

use plant::balloon::{Balloon, SAMPLES};

use super::mean_error;

/// The authors' leaky integral: the share of its distance to the error that it closes in a control period of 0.03 s,
/// with a time constant of 0.5 s.
const INTEGRAL_SHARE: f64 = 0.03 / (0.03 + 0.5);

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

/// Score of full flow up to the target and an exact hold from then on, cmH2O. No controller scores lower.
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
    fn the_floor_is_the_known_one() {
        assert!((floor() - 1.758).abs() < 1e-3, "{}", floor());
    }
}
