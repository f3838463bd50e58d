//! Says when an identified lung deserves no trust: its interval cannot show what the equation of motion leaves out.

use super::cycle::{Cycle, FlowPath};
use super::estimate::Fits;
use super::flaws::Flaws;
use super::{Identified, LungCycles};
use data::recording::Recording;
use data::recording::quality::noise;

/// Residual of the fit, in standard deviations of the pressure's noise, from which on it is more than noise.
const MOST_RESIDUAL: f64 = 3.0;
/// Smallest residual that is worth a remark, as a share of the pressure's range: the lag of a sound sensor leaves less.
const SOUND_RESIDUAL: f64 = 0.04;
/// Smallest delays that are worth a remark, s: of a late flow and of an early one. A pressure sensor lags the flow by a few milliseconds,
/// and a circuit makes the flow of a low resistance early.
const LEAST_DELAY_S: (f64, f64) = (0.008, 0.02);
/// Residual with the delay taken out, as a share of the residual without, below which the delay is worth a remark.
const EXPLAINS: f64 = 0.7;
/// Residual with a leak, as a share of that without, below which a leak that is not taken out may be there.
const LEAK_EXPLAINS: f64 = 0.95;
/// Change of the compliance that makes a leak worth a remark, as a share.
const LEAK_MATTERS: f64 = 0.03;
/// Most sample periods in a time constant R C that are too few.
const PERIODS: f64 = 5.0;
/// Share of the linear pressure drop that a negative R2 takes away, from which on it is no resistor.
const NEGATIVE_DROP: f64 = 0.1;

/// What to know about a lung's estimates, in words; nothing if they can be believed.
pub(super) fn remarks(
    lung: &LungCycles,
    found: &Identified,
    flaws: &Flaws,
    recording: &Recording,
) -> Vec<String> {
    let unexplained =
        || negative_resistance(found).or_else(|| large_residual(found, &recording.pressure[lung.rows()]));
    let mut remarks: Vec<_> = [
        few_breaths(found),
        coarse(found, recording.provenance.period_s()),
        delay(flaws),
        leak(lung, found, flaws),
    ]
    .into_iter()
    .flatten()
    .collect();
    remarks.extend(unexplained());
    remarks
}

fn few_breaths(found: &Identified) -> Option<String> {
    let (used, left_out) = (found.breaths, found.breaths_left_out);
    if used == 1 {
        return Some("only one breath is used: the interval does not show how breaths differ".to_owned());
    }
    let mut reasons: Vec<&str> = found.left_out.iter().map(|left_out| left_out.why).collect();
    reasons.sort_unstable();
    let counted = reasons.chunk_by(|a, b| a == b).map(|same| format!("{} {}", same.len(), same[0]));
    let counted = counted.collect::<Vec<_>>().join(", ");
    (left_out > 0).then(|| format!("{left_out} of {} breaths left out: {counted}", used + left_out))
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

/// The remark on a delay that is taken out, unless a pressure sensor's lag explains it.
fn delay(flaws: &Flaws) -> Option<String> {
    let (before, after) = flaws.delay_residuals;
    let delay_s = flaws.taken_out.delay_s;
    let large = delay_s >= LEAST_DELAY_S.0 || -delay_s >= LEAST_DELAY_S.1;
    (large && after < EXPLAINS * before).then(|| {
        format!(
            "the flow is {:.0} ms {}; with it moved, the residual falls from {before:.2} to {after:.2} cmH2O",
            1e3 * delay_s.abs(),
            if delay_s > 0.0 { "late" } else { "early" },
        )
    })
}

/// The remark on a leak that changes the compliance: one that is taken out, or one that may be there.
fn leak(lung: &LungCycles, found: &Identified, flaws: &Flaws) -> Option<String> {
    let cycles: Vec<&Cycle> = lung.breaths.iter().map(|(_, cycle)| cycle).collect();
    let path = FlowPath { circuit: found.behind_circuit.circuit_compliance, ..flaws.taken_out };
    let fits = |leak: f64| Fits::new(&cycles, &FlowPath { leak, ..path });
    let (with, without) = (fits(flaws.leak.value), fits(0.0));
    let compliance = |fits: &Fits| Some(1.0 / fits.coefficient(1)?.value);
    let (with_it, not) = (compliance(&with)?, compliance(&without)?);
    let taken_out = flaws.taken_out.leak > 0.0;
    let fits_better = flaws.leak.low > 0.0 && with.residual() < LEAK_EXPLAINS * without.residual();
    let matters = (not / with_it - 1.0).abs() > LEAK_MATTERS;
    let verb = if taken_out { "is taken out" } else { "may be there" };
    (matters && (taken_out || fits_better)).then(|| {
        format!(
            "a leak of {:.1} mL/s per cmH2O {verb}: with it C is {with_it:.1} mL/cmH2O, not {not:.1}",
            flaws.leak.value
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
