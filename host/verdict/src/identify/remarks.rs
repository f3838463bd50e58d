//! Says when an identified lung deserves no trust: its interval cannot show what the equation of motion leaves out.

use super::cycle::{Cycle, Drift, FitSpan, LEAK};
use super::{Identified, LungCycles, coefficient, compliance, estimate, residual};
use data::recording::Recording;
use data::recording::quality::noise;

/// Residual of the fit, in standard deviations of the pressure's noise, from which on it is more than noise.
const MOST_RESIDUAL: f64 = 3.0;
/// Smallest residual that is worth a remark, as a share of the pressure's range: the lag of a sound sensor leaves less.
const SOUND_RESIDUAL: f64 = 0.04;
/// Residual with a shift, as a share of the residual without, below which the shift explains the recording better.
const EXPLAINS: f64 = 0.7;
/// The same where R2 is negative already, which a late flow does and an early one does not: any clear fall decides.
const EXPLAINS_NEGATIVE: f64 = 0.95;
/// The same with a leak, whose own interval decides first: what is no leak changes the residual by a hundredth.
const LEAK_EXPLAINS: f64 = 0.95;
/// Farthest shift between flow and pressure that is tried, s.
const MOST_SHIFT_S: f64 = 0.1;
/// Spacing of the shifts that are tried, s.
const SHIFT_STEP_S: f64 = 0.004;
/// Compliances of the circuit that are tried with each shift, mL/cmH2O: a circuit and a shift bend the curve alike.
const SHIFT_CIRCUITS: [f64; 5] = [0.0, 0.75, 1.5, 2.5, 4.0];
/// Most breaths that are shifted.
const MOST_SHIFTED: usize = 6;
/// Smallest shift that is worth a remark, s: a pressure sensor lags the flow by a few milliseconds.
const LEAST_SHIFT_S: f64 = 0.008;
/// Most sample periods in a time constant R C that are too few.
const PERIODS: f64 = 5.0;
/// Change of the compliance that makes a leak worth a remark, as a share.
const LEAK_MATTERS: f64 = 0.03;
/// Share of the linear pressure drop that a negative R2 takes away, from which on it is no resistor.
const NEGATIVE_DROP: f64 = 0.1;

/// What to know about a lung's estimates, in words; nothing if they can be believed.
pub(super) fn remarks(lung: &LungCycles, found: &Identified, recording: &Recording) -> Vec<String> {
    let (shift, negative) = (best_shift(lung), negative_resistance(found));
    let named = |share: f64| shift.as_ref().and_then(|shift| late_flow(shift, share));
    let late = shift.as_ref().is_some_and(|shift| shift.delay_s > 0.0);
    // A cause, where one is found, stands for what it makes of the residual.
    let cause = named(EXPLAINS)
        .or_else(|| leak(lung, found))
        .or_else(|| (late && negative.is_some()).then(|| named(EXPLAINS_NEGATIVE)).flatten())
        .or(negative)
        .or_else(|| large_residual(found, &recording.pressure[lung.rows()]));
    let found = [few_breaths(found), coarse(found, recording.provenance.period_s()), cause];
    found.into_iter().flatten().collect()
}

fn few_breaths(found: &Identified) -> Option<String> {
    let (used, left_out) = (found.breaths, found.breaths_left_out);
    if used == 1 {
        return Some("only one breath is used: the interval does not show how breaths differ".to_owned());
    }
    (left_out > 0).then(|| {
        format!(
            "{left_out} of {} breaths left out: cut off, unlike the others, or not to be fitted",
            used + left_out
        )
    })
}

fn negative_resistance(found: &Identified) -> Option<String> {
    let behind = &found.behind_circuit;
    let flow = behind.inspiratory_flow;
    if behind.resistance.high < 0.0 {
        return Some(
            "R is negative, which no lung is: look for a wrong sign, unit or time of the flow".to_owned(),
        );
    }
    let taken = -behind.turbulence.value * flow * flow;
    (behind.turbulence.high < 0.0 && taken > NEGATIVE_DROP * behind.resistance.value * flow).then(|| {
        "R2 is negative, which no resistor is: the flow is late, leaks, or misses the circuit's share"
            .to_owned()
    })
}

fn coarse(found: &Identified, period_s: f64) -> Option<String> {
    let time_constant = found.resistance.value * found.compliance.value / 1000.0;
    (PERIODS * period_s > time_constant).then(|| {
        format!(
            "the sample period of {:.0} ms is long for R C = {:.0} ms: sample at least every {:.0} ms",
            1e3 * period_s,
            1e3 * time_constant,
            1e3 * time_constant / PERIODS
        )
    })
}

/// The shift of the flow against the pressure with the smallest residual, whatever the circuit takes.
struct Shift {
    /// Delay of the flow, s.
    delay_s: f64,
    /// Residual without the shift and with it, cmH2O.
    residuals: (f64, f64),
}

fn best_shift(lung: &LungCycles) -> Option<Shift> {
    let cycles: Vec<&Cycle> = spread(&lung.breaths).map(|(_, cycle)| cycle).collect();
    let period_s = cycles.first()?.period_s();
    let residual = |rows: i32| {
        let shifted: Vec<Cycle> = cycles.iter().filter_map(|cycle| cycle.shifted(rows)).collect();
        let residuals = SHIFT_CIRCUITS.map(|circuit| {
            let fit = |cycle: &Cycle| cycle.fit(FitSpan::Cycle, Drift::Corrected, circuit);
            residual(&shifted.iter().filter_map(fit).collect::<Vec<_>>())
        });
        residuals.into_iter().fold(f64::INFINITY, f64::min)
    };
    let most = (MOST_SHIFT_S / period_s) as i32;
    let step = (SHIFT_STEP_S / period_s).ceil() as usize;
    let shifts = (-most..=most).step_by(step).map(|rows| (rows, residual(rows)));
    let (rows, least) = shifts.min_by(|a, b| a.1.total_cmp(&b.1))?;
    Some(Shift { delay_s: f64::from(rows) * period_s, residuals: (residual(0), least) })
}

/// The remark on a shift that leaves at most this share of the residual.
fn late_flow(shift: &Shift, share: f64) -> Option<String> {
    let (before, after) = shift.residuals;
    (shift.delay_s.abs() >= LEAST_SHIFT_S && after < share * before).then(|| {
        let side = if shift.delay_s > 0.0 { "late" } else { "early" };
        format!(
            "the flow is about {:.0} ms {side}: with that shift the residual falls from {before:.2} to {after:.2} \
             cmH2O; shift the flow's column and identify again",
            1e3 * shift.delay_s.abs(),
        )
    })
}

/// At most [`MOST_SHIFTED`] of the breaths, evenly spread.
fn spread<T>(breaths: &[T]) -> impl Iterator<Item = &T> {
    breaths.iter().step_by(breaths.len().div_ceil(MOST_SHIFTED).max(1))
}

/// Whether a leak in proportion to the pressure explains the flow that is not expired again.
fn leak(lung: &LungCycles, found: &Identified) -> Option<String> {
    let behind = &found.behind_circuit;
    let fit = |cycle: &Cycle| cycle.leaking(behind.circuit_compliance);
    let fits: Vec<_> = lung.breaths.iter().filter_map(|(_, cycle)| fit(cycle)).collect();
    let leaks: Vec<f64> = fits.iter().map(|fit| -fit.coefficients[LEAK] / fit.coefficients[1]).collect();
    let leak = estimate(&leaks, f64::INFINITY)?;
    // The fit multiplies R with the whole flow, of which the leak is a part that grows with the pressure.
    let through_resistance = 1.0 - coefficient(&fits, 2)?.value * leak.value / 1000.0;
    let (compliance, residual) = (compliance(&fits)?.value * through_resistance, residual(&fits));
    let matters = (behind.compliance.value / compliance - 1.0).abs() > LEAK_MATTERS;
    (leak.low > 0.0 && compliance > 0.0 && matters && residual < LEAK_EXPLAINS * behind.residual).then(|| {
        format!(
            "a leak of {:.1} mL/s per cmH2O fits: with it C is {compliance:.1} mL/cmH2O, not {:.1}, and the residual \
             {residual:.2} cmH2O, not {:.2}",
            leak.value, behind.compliance.value, behind.residual
        )
    })
}

fn large_residual(found: &Identified, pressure: &[f32]) -> Option<String> {
    let residual = found.behind_circuit.residual;
    let (lowest, highest) = pressure
        .iter()
        .fold((f32::INFINITY, f32::NEG_INFINITY), |(low, high), p| (low.min(*p), high.max(*p)));
    let noise = noise(pressure);
    (residual > SOUND_RESIDUAL * f64::from(highest - lowest) && residual > MOST_RESIDUAL * noise).then(|| {
        format!(
            "the residual of {residual:.2} cmH2O is far above the pressure's noise of {noise:.2}: the intervals are too \
             narrow"
        )
    })
}
