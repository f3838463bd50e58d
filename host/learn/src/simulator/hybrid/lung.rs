//! The lung of the hybrid: a parabolic resistor and a compliance behind the circuit's compliance; the ventilator is two
//! openings.
//!
//! ```text
//! Cc dp/dt = A sqrt(S - p) - B sqrt(p) - q    airway pressure p under a supply S, an implicit step
//! C  da/dt = q                                alveolar pressure a
//! p - a    = R1 q + R2 q |q|                  R1, R2 in proportion to the nominal R
//! ```

use super::ventilator::{OPENINGS, Openings};
use crate::simulator::branch::conductance;
use crate::simulator::{BreathStart, Timing};
use engine::{LANES, Lane};

/// Number of parameters of lungs and circuit: see [`Physics`].
pub(super) const PHYSICS: usize = 6;
/// Number of deviations of a test run, as logarithms: the factors on R and C.
pub(super) const DEVIATIONS: usize = 2;
/// Nominal R to which R1 and R2 refer, cmH2O/(L/s).
pub(super) const NOMINAL: f32 = 20.0;
/// Pressure drop below which the resistor's root is smoothed, cmH2O.
pub(super) const ROUNDING: f32 = 0.05;
pub(super) const ML_PER_L: f32 = 1000.0;

/// Learned parameters of lungs and circuit.
#[derive(Clone, Copy, Debug)]
pub(super) struct Physics {
    /// Duration of one step, s.
    pub step_s: f32,
    /// Logarithms of R1 (cmH2O/(L/s)) and R2 (cmH2O/(L/s)^2) at the nominal R of 20. Both are proportional to the
    /// nominal R; separate exponents, learned from a handful of lungs, did not generalise.
    pub linear: f32,
    pub square: f32,
    /// Logarithm of the factor on the nominal C.
    pub compliance: f32,
    /// Logarithm of the circuit's compliance, mL/cmH2O.
    pub circuit: f32,
    /// Share of the last plateau's pressure that is still in the lung.
    pub left: f32,
    /// Logarithm of the supply pressure, cmH2O.
    pub supply: f32,
}

/// The lungs of a shard.
#[derive(Clone, Copy, Debug, Default)]
struct Lungs {
    linear: Lane,
    square: Lane,
    /// Pressure rise per flow and step: the effect of 1 L/s for one step, cmH2O.
    rise: Lane,
    /// Conductance that represents the circuit's compliance, (L/s)/cmH2O.
    keep: f32,
    /// Supply pressure, cmH2O.
    supply: f32,
}

/// Gradients with respect to the logarithms of the values in [`Lungs`].
#[derive(Clone, Copy, Debug, Default)]
struct Gradients {
    linear: Lane,
    square: Lane,
    rise: Lane,
    keep: Lane,
    supply: Lane,
}

/// Values of one step that the backward pass needs.
#[derive(Clone, Copy, Debug, Default)]
struct Flow {
    pressure: Lane,
    alveolar: Lane,
    conductance: Lane,
    next: Lane,
}

/// Forward values and backward gradients of a rollout, step by step.
#[derive(Clone, Debug)]
pub(super) struct LungTape {
    flow: Vec<Flow>,
    lungs: Lungs,
    /// Plateau minus pressure at the start, cmH2O.
    fall: Lane,
    pressure: Lane,
    pub alveolar: Lane,
    d_pressure: Lane,
    d_alveolar: Lane,
    d_lungs: Gradients,
}

impl Physics {
    /// Half of the nominal drop is linear, half turbulent, at one litre per second; the circuit has 1.5 mL/cmH2O, the
    /// supply 60 cmH2O.
    pub const PLAIN: [f32; PHYSICS] = [2.1, 2.3, 0.0, 0.4, 0.0, 4.1];

    /// From parameters, for steps of a block's points.
    pub fn new(timing: &Timing, p: &[f32]) -> Self {
        Self {
            step_s: timing.block_s() / timing.points as f32,
            linear: p[0],
            square: p[1],
            compliance: p[2],
            circuit: p[3],
            left: p[4],
            supply: p[5],
        }
    }

    /// Memory for a rollout of `steps` steps.
    pub(super) fn tape(steps: usize) -> LungTape {
        LungTape {
            flow: vec![Flow::default(); steps],
            lungs: Lungs::default(),
            fall: Lane::ZERO,
            pressure: Lane::ZERO,
            alveolar: Lane::ZERO,
            d_pressure: Lane::ZERO,
            d_alveolar: Lane::ZERO,
            d_lungs: Gradients::default(),
        }
    }

    /// Starts a breath of a lung with deviations from its nominal R and C.
    pub(super) fn begin(&self, tape: &mut LungTape, start: &BreathStart, deviations: &[Lane; DEVIATIONS]) {
        let step = ML_PER_L * self.step_s;
        let resistance = start.resistance.zip(&deviations[0], |r, own| r / NOMINAL * own.exp());
        let compliance = start.compliance.zip(&deviations[1], |c, own| c * own.exp());
        tape.lungs = Lungs {
            linear: resistance.map(|r| r * self.linear.exp()),
            square: resistance.map(|r| r * self.square.exp()),
            rise: compliance.map(|c| step / (c * self.compliance.exp())),
            keep: self.circuit.exp() / step,
            supply: self.supply.exp(),
        };
        tape.fall = start.plateau.zip(&start.pressure, |plateau, p| plateau - p);
        (tape.pressure, tape.alveolar) = (start.pressure, start.pressure);
        tape.alveolar.add_scaled(self.left, &tape.fall);
        (tape.d_pressure, tape.d_alveolar) = (Lane::ZERO, Lane::ZERO);
        tape.d_lungs = Gradients::default();
    }

    /// Adds the parameters' gradient, after the backward pass of all steps; returns that of the deviations.
    pub(super) fn finish(tape: &LungTape, gradient: &mut [f32]) -> [Lane; DEVIATIONS] {
        let d = &tape.d_lungs;
        let by_physics = [
            d.linear.sum(),
            d.square.sum(),
            // The rise per step falls as the compliance grows.
            -d.rise.sum(),
            d.keep.sum(),
            tape.d_alveolar.zip(&tape.fall, |a, b| a * b).sum(),
            d.supply.sum(),
        ];
        for (gradient, d) in gradient.iter_mut().zip(by_physics) {
            *gradient += d;
        }
        [d.linear.zip(&d.square, |a, b| a + b), d.rise.map(|d| -d)]
    }
}

impl LungTape {
    /// Runs one implicit step with a ventilator; returns the airway pressure after it, cmH2O.
    pub fn step(&mut self, step: usize, [inlet, outlet]: &Openings) -> Lane {
        let lungs = &self.lungs;
        let mut flow = Flow { pressure: self.pressure, alveolar: self.alveolar, ..Flow::default() };
        for l in 0..LANES {
            let (p, a, k) = (self.pressure[l], self.alveolar[l], lungs.keep);
            let (g, _, _) = resistor(lungs, l, p - a);
            let (g_in, g_out) = (inlet[l] * orifice(lungs.supply - p).0, outlet[l] * orifice(p).0);
            let next = (k * p + g_in * lungs.supply + g * a) / (k + g_in + g_out + g);
            flow.conductance[l] = g;
            flow.next[l] = next;
            self.alveolar[l] = a + lungs.rise[l] * g * (next - a);
        }
        self.pressure = flow.next;
        self.flow[step] = flow;
        flow.next
    }

    /// Backward pass of [`Self::step`], from the gradient with respect to its pressure; adds that of the openings.
    pub fn step_back(&mut self, step: usize, openings: &Openings, d_next: &Lane, d_openings: &mut Openings) {
        self.d_pressure.add_scaled(1.0, d_next);
        for l in 0..LANES {
            let d = self.lane_back(step, l, [openings[0][l], openings[1][l]]);
            for n in 0..OPENINGS {
                d_openings[n][l] += d[n];
            }
        }
    }

    /// One lane of [`Self::step_back`]: turns the gradient of the pressures after the step into that before it.
    fn lane_back(&mut self, step: usize, l: usize, [inlet, outlet]: [f32; OPENINGS]) -> [f32; OPENINGS] {
        let (flow, lungs) = (&self.flow[step], &self.lungs);
        let (p, a, next, g) = (flow.pressure[l], flow.alveolar[l], flow.next[l], flow.conductance[l]);
        let (k, supply) = (lungs.keep, lungs.supply);
        let ((share_in, slope_in), (share_out, slope_out)) = (orifice(supply - p), orifice(p));
        let (g_in, g_out) = (inlet * share_in, outlet * share_out);
        let (mut d_next, mut d_a) = (self.d_pressure[l], self.d_alveolar[l]);
        // a' = a + rise g (next - a)
        let d_flow = lungs.rise[l] * d_a;
        self.d_lungs.rise[l] += d_flow * g * (next - a);
        let mut d_g = d_flow * (next - a);
        d_next += d_flow * g;
        d_a -= d_flow * g;
        // next = (k p + g_in supply + g a) / (k + g_in + g_out + g)
        let d = d_next / (k + g_in + g_out + g);
        let (d_in, d_out) = (d * (supply - next), -d * next);
        self.d_lungs.keep[l] += d * (p - next) * k;
        self.d_lungs.supply[l] += (d * g_in + d_in * inlet * slope_in) * supply;
        d_g += d * (a - next);
        let mut d_p = d * k - d_in * inlet * slope_in + d_out * outlet * slope_out;
        d_a += d * g;
        // g = 2 / (R1 + root)
        let (_, root, size) = resistor(lungs, l, p - a);
        let d_sum = -0.5 * g * g * d_g;
        self.d_lungs.linear[l] += d_sum * (1.0 + lungs.linear[l] / root) * lungs.linear[l];
        self.d_lungs.square[l] += d_sum * 2.0 * size / root * lungs.square[l];
        let d_drop = d_sum * 2.0 * lungs.square[l] / root * (p - a) / size;
        d_p += d_drop;
        d_a -= d_drop;
        (self.d_pressure[l], self.d_alveolar[l]) = (d_p, d_a);
        [d_in * share_in, d_out * share_out]
    }
}

/// Conductance, its root and `|drop|`, which is smoothed around zero.
fn resistor(lungs: &Lungs, l: usize, drop: f32) -> (f32, f32, f32) {
    let size = (drop * drop + ROUNDING * ROUNDING).sqrt();
    let (g, root) = conductance(lungs.linear[l], lungs.square[l], size);
    (g, root, size)
}

/// Conductance of a unit opening under a pressure drop, and its slope: flow is proportional to the root of the drop,
/// smoothed around zero.
fn orifice(drop: f32) -> (f32, f32) {
    let square = drop * drop + 1.0;
    let share = 1.0 / square.sqrt().sqrt();
    (share, -0.5 * drop * share / square)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tests_support::check_slopes;

    const STEPS: usize = 12;

    fn weight(step: usize) -> Lane {
        Lane::from_fn(|l| ((5 * step + l) as f32).cos())
    }

    /// A breath with the same openings in every step and lane: `at` contains the physics, then the two openings.
    fn breathe(at: &[f32]) -> (LungTape, Openings, f64) {
        let mut tape = Physics::tape(STEPS);
        let start = BreathStart {
            pressure: Lane::splat(6.0),
            plateau: Lane::splat(15.0),
            resistance: Lane::from_fn(|l| 5.0 + 3.0 * l as f32),
            compliance: Lane::from_fn(|l| 50.0 - 2.0 * l as f32),
            ..BreathStart::default()
        };
        let physics = Physics::new(&Timing::for_period(30_000, 1), &at[..PHYSICS]);
        physics.begin(&mut tape, &start, &[Lane::splat(0.1), Lane::splat(-0.1)]);
        let openings = [Lane::splat(at[PHYSICS]), Lane::splat(at[PHYSICS + 1])];
        let mut total = 0.0;
        for step in 0..STEPS {
            let pressure = tape.step(step, &openings);
            total += (0..LANES).map(|l| f64::from(weight(step)[l] * pressure[l])).sum::<f64>();
        }
        (tape, openings, total)
    }

    #[test]
    fn gradients_by_physics_and_openings_agree_with_finite_differences() {
        let at = [1.8, 2.8, 0.2, 0.9, 0.3, 3.7, 0.15, 0.08];
        let (mut tape, openings, _) = breathe(&at);
        let mut d_openings = [Lane::ZERO; OPENINGS];
        for step in (0..STEPS).rev() {
            tape.step_back(step, &openings, &weight(step), &mut d_openings);
        }
        let mut gradient = vec![0.0; PHYSICS];
        Physics::finish(&tape, &mut gradient);
        gradient.extend(d_openings.map(|d| d.sum()));
        check_slopes("argument", &at, 1e-3, &gradient, |at| breathe(at).2);
    }
}
