//! A probe of a loop's margins: sines in the command of a rollout, and their response in what reaches the valve.
//!
//! The ratio of the two is the sensitivity S = 1 / (1 + L) of the loop, as `lab margins` measures it on a bench. Rollouts come in pairs
//! with opposite sines and all else the same: noise, drift and the start of the breath cancel in their difference. A sensitivity above
//! a bound is part of the loss, and its gradient flows through the commands.

use std::f32::consts::TAU;

use engine::{LANES, Lane};

/// Pairs in a shard: a rollout and the one this many lanes further.
pub(super) const PAIRS: usize = LANES / 2;

/// A sine: whole periods in the window.
#[derive(Clone, Copy, Debug)]
pub struct Sine {
    /// Periods in the window.
    pub periods: usize,
    /// Amplitude in each pair, percent; zero leaves it out.
    pub amplitude: [f32; PAIRS],
    /// Angle at the start of the window, radians.
    pub phase: f32,
}

/// The sines in the command of every rollout.
#[derive(Clone, Debug)]
pub struct Probe {
    /// First tick of the window, and its length, ticks. The sines begin a quarter of the window before it.
    pub window: (usize, usize),
    /// The sines.
    pub sines: Vec<Sine>,
    /// Sensitivity of each pair above which it is part of the loss.
    pub bound: [f32; PAIRS],
    /// Price of a sensitivity of one above the bound, cmH2O.
    pub price: f32,
}

/// Response to a sine: real and imaginary part of its sensitivity in every pair, turned by the phase.
type Response = [[f32; PAIRS]; 2];

impl Probe {
    /// Angle of a sine at a tick.
    fn angle(&self, sine: &Sine, tick: usize) -> f32 {
        let (first, length) = self.window;
        // The remainder keeps the angle small.
        let turns = (length + tick - first % length) * sine.periods % length;
        sine.phase + TAU * turns as f32 / length as f32
    }

    /// The command with the sines, before the valve's limits, percent.
    pub(super) fn added(&self, command: &Lane, tick: usize) -> Lane {
        let (first, length) = self.window;
        if tick + length / 4 < first {
            return *command;
        }
        let mut sum = [0.0; PAIRS];
        for sine in &self.sines {
            let height = self.angle(sine, tick).cos();
            for (sum, amplitude) in sum.iter_mut().zip(sine.amplitude) {
                *sum += amplitude * height;
            }
        }
        Lane::from_fn(|l| command[l] + if l < PAIRS { sum[l] } else { -sum[l - PAIRS] })
    }

    /// Responses to the sines in the commands to the valve.
    fn responses(&self, applied: &[Lane]) -> Vec<Response> {
        let (first, length) = self.window;
        let of = |sine: &Sine| {
            let mut sums = [[0.0; PAIRS]; 2];
            for (tick, applied) in applied.iter().enumerate().skip(first).take(length) {
                let (height, quarter) = self.angle(sine, tick).sin_cos();
                for pair in 0..PAIRS {
                    let half = 0.5 * (applied[pair] - applied[pair + PAIRS]);
                    sums[0][pair] += half * quarter;
                    sums[1][pair] += half * height;
                }
            }
            let scale = |pair: usize| self.scale(sine, pair);
            sums.map(|part| std::array::from_fn(|pair| scale(pair) * part[pair]))
        };
        self.sines.iter().map(of).collect()
    }

    /// Factor from a sum over the window to a sensitivity.
    fn scale(&self, sine: &Sine, pair: usize) -> f32 {
        let amplitude = sine.amplitude[pair];
        if amplitude > 0.0 { 2.0 / (self.window.1 as f32 * amplitude) } else { 0.0 }
    }

    /// The price of all sensitivities above their bounds, weighted by the rollouts' weights.
    pub(super) fn loss(&self, applied: &[Lane], weight: &Lane) -> f64 {
        let of = |[real, imaginary]: Response| {
            (0..PAIRS)
                .map(|pair| {
                    let above = (real[pair].hypot(imaginary[pair]) - self.bound[pair]).max(0.0);
                    f64::from(self.share(pair, weight) * above * above)
                })
                .sum::<f64>()
        };
        self.responses(applied).into_iter().map(of).sum()
    }

    /// What one sensitivity above its bound by one costs.
    fn share(&self, pair: usize, weight: &Lane) -> f32 {
        self.price * (weight[pair] + weight[pair + PAIRS])
    }

    /// Adds the gradient of [`Self::loss`] with respect to the commands to the valve.
    pub(super) fn slopes(&self, applied: &[Lane], weight: &Lane, d_applied: &mut [Lane]) {
        let (first, length) = self.window;
        for (sine, [real, imaginary]) in self.sines.iter().zip(self.responses(applied)) {
            let factor: [f32; PAIRS] = std::array::from_fn(|pair| {
                let size = real[pair].hypot(imaginary[pair]);
                let above = (size - self.bound[pair]).max(0.0);
                // 2 (size - bound) d size, of which each rollout of the pair has a half.
                self.share(pair, weight) * above * self.scale(sine, pair) / size.max(f32::MIN_POSITIVE)
            });
            if factor.iter().all(|factor| *factor == 0.0) {
                continue;
            }
            for (tick, d_applied) in d_applied.iter_mut().enumerate().skip(first).take(length) {
                let (height, quarter) = self.angle(sine, tick).sin_cos();
                for pair in 0..PAIRS {
                    let d = factor[pair] * (real[pair] * quarter + imaginary[pair] * height);
                    d_applied[pair] += d;
                    d_applied[pair + PAIRS] -= d;
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A window of 200 ticks from tick 100 on, with two sines.
    fn probe() -> Probe {
        let sine = |periods| Sine { periods, amplitude: [4.0; PAIRS], phase: 0.7 };
        Probe { window: (100, 200), sines: vec![sine(2), sine(7)], bound: [1.5; PAIRS], price: 2.0 }
    }

    /// Commands of a loop that amplifies the sines by this factor and adds a drift to all.
    fn commands(probe: &Probe, factor: f32) -> Vec<Lane> {
        let with_drift = |tick: usize| {
            let sines = probe.added(&Lane::ZERO, tick);
            Lane::from_fn(|l| 40.0 + 0.03 * (tick * (l % PAIRS)) as f32 + factor * sines[l])
        };
        (0..300).map(with_drift).collect()
    }

    #[test]
    fn a_sensitivity_costs_the_square_of_what_is_above_its_bound() {
        let probe = probe();
        let costs = |factor| probe.loss(&commands(&probe, factor), &Lane::splat(0.5));
        // Two sines in each pair, both of whose rollouts have half the weight.
        let wanted = |factor: f64| 2.0 * PAIRS as f64 * 2.0 * (factor - 1.5).powi(2);
        for factor in [2.0, 3.5] {
            assert!((costs(factor) / wanted(f64::from(factor)) - 1.0).abs() < 1e-3, "{}", costs(factor));
        }
        assert!(costs(1.4).abs() < 1e-9);
    }

    #[test]
    fn the_sines_of_a_pair_are_opposite_and_begin_before_the_window() {
        let probe = probe();
        let added = |tick| probe.added(&Lane::splat(30.0), tick);
        assert!(added(49).0.iter().all(|command| (command - 30.0).abs() < 1e-6));
        let of = added(60);
        assert!((of[0] - 30.0).abs() > 0.5);
        assert!((0..PAIRS).all(|pair| (of[pair] + of[pair + PAIRS] - 60.0).abs() < 1e-4));
    }
}
