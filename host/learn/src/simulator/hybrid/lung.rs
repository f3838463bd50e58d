//! The lung of the hybrid: a parabolic resistor and a compliance behind the circuit's compliance; the ventilator is two
//! openings.
//!
//! ```text
//! Cc dp/dt = A sqrt(S - p) - B sqrt(p) - q    airway pressure p under a supply S, an implicit step
//! C  da/dt = q                                alveolar pressure a
//! p - a    = R1 q + R2 q |q|                  R1, R2 in proportion to the nominal R
//! ```
#![expect(
    clippy::inline_always,
    reason = "vector operations are compiled for the unit detected at run time only where they are inlined"
)]

use super::ventilator::OPENINGS;
use crate::simulator::branch::conductance;
use crate::simulator::trajectory::{Equations, Trajectory};
use crate::simulator::{BreathStart, Timing};
use engine::Lane;
use engine::number::Number;

/// Number of learned parameters of lungs and circuit: logarithms of R1 (cmH2O/(L/s)) and R2 (cmH2O/(L/s)^2)
/// at the nominal R of 20, of the factor on the nominal C, and of the circuit's compliance, mL/cmH2O; the
/// share of the last plateau's pressure that is still in the lung; logarithm of the supply pressure, cmH2O.
/// R1 and R2 are proportional to the nominal R: separate exponents, learned from a handful of lungs, did not
/// generalise.
pub(super) const PHYSICS: usize = 6;
/// Half of the nominal drop is linear, half turbulent, at one litre per second; the circuit has 1.5 mL/cmH2O,
/// the supply 60 cmH2O.
pub(super) const PLAIN: [f32; PHYSICS] = [2.1, 2.3, 0.0, 0.4, 0.0, 4.1];
/// Number of deviations of a test run, as logarithms: the factors on R and C.
pub(super) const DEVIATIONS: usize = 2;
/// What is given for a breath: the parameters; pressure and last plateau, cmH2O, nominal R and C; the
/// deviations.
pub(super) const GIVEN: usize = PHYSICS + 4 + DEVIATIONS;
/// Numbers of a breath: R1, R2, pressure rise by 1 L/s in a step, cmH2O, conductance that represents the
/// circuit's compliance, (L/s)/cmH2O, and supply pressure, cmH2O.
pub(super) const NUMBERS: usize = 5;
/// Airway and alveolar pressure, cmH2O.
pub(super) const STATE: usize = 2;
/// Nominal R to which R1 and R2 refer, cmH2O/(L/s).
const NOMINAL: f32 = 20.0;
/// Pressure drop below which the resistor's root is smoothed, cmH2O.
const ROUNDING: f32 = 0.05;
const ML_PER_L: f32 = 1000.0;

/// Forward values and backward gradients of a rollout.
pub(super) type LungTrajectory = Trajectory<LungEquations, GIVEN, NUMBERS, STATE, OPENINGS>;

/// The equations of a step.
#[derive(Clone, Copy, Debug)]
pub(super) struct LungEquations {
    /// Effect of 1 L/s for a step, mL.
    volume: f32,
}

impl LungEquations {
    /// For steps of a block's points.
    pub fn new(timing: &Timing) -> Self {
        Self { volume: ML_PER_L * (timing.block_s() / timing.points as f32) }
    }
}

impl Equations<GIVEN, NUMBERS, STATE, OPENINGS> for LungEquations {
    fn begin<Q: Number>(&self, given: [Q; GIVEN]) -> ([Q; NUMBERS], [Q; STATE]) {
        let [linear, square, compliance, circuit, left, supply, pressure, plateau, r, c, own_r, own_c] =
            given;
        let resistance = r / r.constant(NOMINAL) * own_r.exp();
        let compliance = c * own_c.exp() * compliance.exp();
        let volume = c.constant(self.volume);
        let numbers = [
            resistance * linear.exp(),
            resistance * square.exp(),
            volume / compliance,
            circuit.exp() / volume,
            supply.exp(),
        ];
        (numbers, [pressure, pressure + left * (plateau - pressure)])
    }

    #[inline(always)]
    fn tick<Q: Number>(
        [linear, square, rise, keep, supply]: [Q; NUMBERS],
        [p, a]: [Q; STATE],
        [inlet, outlet]: [Q; OPENINGS],
    ) -> [Q; STATE] {
        let drop = p - a;
        // Smoothed around zero.
        let size = (drop * drop + p.constant(ROUNDING * ROUNDING)).sqrt();
        let lung = conductance(linear, square, size);
        let (into, out) = (inlet * orifice(supply - p), outlet * orifice(p));
        let next = (keep * p + into * supply + lung * a) / (keep + into + out + lung);
        [next, a + rise * lung * (next - a)]
    }
}

/// Conductance of a unit opening under a pressure drop: flow is proportional to the root of the drop,
/// smoothed around zero.
#[inline(always)]
fn orifice<Q: Number>(drop: Q) -> Q {
    let one = drop.constant(1.0);
    one / (drop * drop + one).sqrt().sqrt()
}

/// What is given for a breath of a lung with deviations from its nominal R and C.
pub(super) fn given(
    physics: &[f32; PHYSICS],
    start: &BreathStart,
    deviations: &[Lane; DEVIATIONS],
) -> [Lane; GIVEN] {
    let known = [start.pressure, start.plateau, start.resistance, start.compliance];
    let all = [&physics.map(Lane::splat)[..], &known, deviations].concat();
    std::array::from_fn(|n| all[n])
}

/// Adds the parameters' gradient, after the backward pass of all steps; returns that of the deviations.
pub(super) fn finish(trajectory: &LungTrajectory, gradient: &mut [f32]) -> [Lane; DEVIATIONS] {
    let [physics @ .., _, _, _, _, own_resistance, own_compliance] = trajectory.gradient();
    for (gradient, d) in gradient.iter_mut().zip(physics) {
        *gradient += d.sum();
    }
    [own_resistance, own_compliance]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tests_support::check_slopes;
    use engine::LANES;

    const STEPS: usize = 12;

    fn weight(step: usize) -> Lane {
        Lane::from_fn(|l| ((5 * step + l) as f32).cos())
    }

    /// A breath with the same openings in every step and lane: `at` contains the physics, then the two openings.
    fn breathe(at: &[f32]) -> (LungTrajectory, f64) {
        let mut lung = Trajectory::new(LungEquations::new(&Timing::for_period(30_000, 1)), STEPS);
        let start = BreathStart {
            pressure: Lane::splat(6.0),
            plateau: Lane::splat(15.0),
            resistance: Lane::from_fn(|l| 5.0 + 3.0 * l as f32),
            compliance: Lane::from_fn(|l| 50.0 - 2.0 * l as f32),
            ..BreathStart::default()
        };
        let physics = std::array::from_fn(|n| at[n]);
        lung.begin(&given(&physics, &start, &[Lane::splat(0.1), Lane::splat(-0.1)]));
        let openings = [Lane::splat(at[PHYSICS]), Lane::splat(at[PHYSICS + 1])];
        let mut total = 0.0;
        for step in 0..STEPS {
            let [pressure, _] = *lung.step(step, &openings);
            total += (0..LANES).map(|l| f64::from(weight(step)[l] * pressure[l])).sum::<f64>();
        }
        (lung, total)
    }

    #[test]
    fn gradients_by_physics_and_openings_agree_with_finite_differences() {
        let at = [1.8, 2.8, 0.2, 0.9, 0.3, 3.7, 0.15, 0.08];
        let (mut lung, _) = breathe(&at);
        let mut d_openings = [Lane::ZERO; OPENINGS];
        for step in (0..STEPS).rev() {
            for (sum, d) in d_openings.iter_mut().zip(lung.step_back(step, 0, &weight(step))) {
                *sum = *sum + d;
            }
        }
        let mut gradient = vec![0.0; PHYSICS];
        finish(&lung, &mut gradient);
        gradient.extend(d_openings.map(|d| d.sum()));
        check_slopes("argument", &at, 1e-3, &gradient, |at| breathe(at).1);
    }
}
