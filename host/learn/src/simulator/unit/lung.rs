//! The lung of a unit behind its circuit: an implicit step for the pressure at the junction of all flows.
//!
//! ```text
//! Cc dp/dt = F w sqrt(1 - p/S) - e g_e (p - PEEP) - g_l p - q - d  airway pressure p, opening e of the closing expiratory valve
//! C  da/dt = s q,  p - a = R q (1 + k |q|)                        alveolar pressure a
//! ```
//!
//! The lung stiffens above its upper inflection as the bench's does: the elastance's factor s is 1 below it.
#![expect(
    clippy::inline_always,
    reason = "vector operations are compiled for the unit detected at run time only where they are inlined"
)]

use engine::number::Number;

use super::left_after;
use crate::simulator::branch::conductance;

pub(super) const RESISTANCE: usize = 0;
pub(super) const TURBULENCE: usize = 1;
pub(super) const COMPLIANCE: usize = 2;
pub(super) const LEAK: usize = 3;
pub(super) const CIRCUIT: usize = 4;
pub(super) const ORIFICE: usize = 6;
pub(super) const SENSOR: usize = 7;
pub(super) const OUTWARD: usize = 8;
pub(super) const INFLECTION: usize = 9;
/// Number of [`numbers`], and of pieces of state.
pub(super) const NUMBERS: usize = 9;
pub(super) const STATE: usize = 4;
const ML_PER_L: f32 = 1e3;
/// Distance `V / C` beyond the inflection over which the elastance doubles, cmH2O.
const STIFFENING: f32 = 20.0;
/// Linear and square part of a leak of one L/s at 30 cmH2O.
const LEAK_PARTS: (f32, f32) = (0.6, 29.4);
/// Linear part of the expiratory valve, cmH2O/(L/s).
const EXPIRATORY_LINEAR: f32 = 0.5;
/// Smallest drive of the supply, as a share of its pressure.
const LEAST_DRIVE: f32 = 0.01;

/// Linear part of the resistor with the rise, its square part; rise of the alveolar pressure by 1 L/s in a
/// tick, cmH2O; leak; conductance that represents the circuit's compliance, (L/s)/cmH2O; share of the
/// expiratory opening that is left after a tick; square part of the expiratory valve; share of the way that
/// the sensor moves in a tick; upper inflection, cmH2O.
pub(super) fn numbers<Q: Number>(
    [r, turbulence, c, leak, circuit, closing, orifice, sensor, inflection]: [Q; 9],
    tick_s: f32,
) -> [Q; NUMBERS] {
    let one = r.constant(1.0);
    let volume = r.constant(ML_PER_L * tick_s);
    let rise = volume / c;
    let (left, square) = (left_after(closing, tick_s), one / (orifice * orifice));
    let sensed = one - left_after(sensor, tick_s);
    [r + rise, r * turbulence, rise, leak, circuit / volume, left, square, sensed, inflection]
}

/// Elastance of a lung with this recoil as a multiple of that below its inflection.
#[inline(always)]
fn stiffness<Q: Number>(recoil: Q, inflection: Q) -> Q {
    let beyond = (recoil - inflection).max(recoil.constant(0.0));
    (recoil.constant(1.0) + recoil.constant(2.0 / STIFFENING) * beyond).sqrt()
}

/// Share of the last plateau above PEEP that is still in the lung, for inspiratory and expiratory time, s, and a lung's R, C and
/// resistance of the expiratory path: filled through R, emptied through both.
pub(super) fn left_in_lung<Q: Number>([inspiration, expiration]: [Q; 2], [r, c, outward]: [Q; 3]) -> Q {
    let (one, ml) = (r.constant(1.0), r.constant(ML_PER_L));
    let (filling, emptying) = (r * c / ml, (r + outward) * c / ml);
    let zero = r.constant(0.0);
    let unfilled = ((zero - inspiration) / filling).exp();
    let left = ((zero - expiration) / emptying).exp();
    (one - unfilled) * left / (one - unfilled * left)
}

/// Expiratory opening, airway, alveolar and sensed pressure, cmH2O, after a tick with this flow of the valve
/// without back-pressure and with this one drawn out of the circuit, L/s.
#[inline(always)]
pub(super) fn tick<Q: Number>(
    [linear, square, rise, leak, keep, closing, expiratory, sensor, inflection]: [Q; NUMBERS],
    [opening, p, a, sensed]: [Q; STATE],
    [flow, drawn, supply, peep]: [Q; 4],
) -> [Q; STATE] {
    let opening = opening * closing;
    let stiffer = stiffness(a, inflection);
    let linear = linear + rise * (stiffer - p.constant(1.0));
    let lung = conductance(linear, square, (p - a).abs());
    let above = p - peep;
    let outlet = conductance(p.constant(EXPIRATORY_LINEAR), expiratory, above.abs());
    let out = opening * outlet.where_greater(p, peep);
    let (leak_linear, leak_square) = LEAK_PARTS;
    let leaking = leak * conductance(p.constant(leak_linear), p.constant(leak_square), p.abs());
    let drive = (p.constant(1.0) - p / supply).max(p.constant(LEAST_DRIVE)).sqrt();
    let sum = keep * p + flow * drive + out * peep + lung * a - drawn;
    let next = sum / (keep + lung + out + leaking);
    [opening, next, a + rise * stiffer * lung * (next - a), sensed + sensor * (next - sensed)]
}

#[cfg(test)]
mod tests {
    use super::*;
    use engine::Lane;
    use plant::bench::BenchConfig;

    #[test]
    fn the_lung_stiffens_as_the_benchs_does() {
        let bench = BenchConfig::default().lung.first;
        assert!((f64::from(STIFFENING) - bench.stiffening_cmh2o).abs() < 1e-6);
        let at = |recoil: f32| stiffness(Lane::splat(recoil), Lane::splat(35.0))[0];
        assert!((at(20.0) - 1.0).abs() < 1e-6, "not below the inflection");
        // V / C = 55 lies 20 beyond it: its recoil is 55 + 20^2 / 40, its elastance twice that below.
        assert!((at(65.0) - 2.0).abs() < 1e-5, "{}", at(65.0));
    }
}
