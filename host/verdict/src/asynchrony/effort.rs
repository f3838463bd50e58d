//! Signs of the patient's muscles in the pressure and the flow of a breath.

use super::course::{Course, Noise};
use crate::series::{highest, lowest, reversals};
use engine::least_squares::solve;

/// Bump of the flow towards zero of a missed effort, L/s: 5.45 L/min (Chen 2008).
const MISSED_FLOW: f64 = 5.45 / 60.0;
/// The same as a share of the strongest expiratory flow, for lungs that are too small for it.
const MISSED_SHARE: f64 = 0.2;
/// Fall of the pressure in a missed effort, cmH2O (Chen 2008; 0.5 in Thille 2006).
const MISSED_PRESSURE: f64 = 0.45;
/// Sum of both, each in its unit: a lung behind a closed valve shows an effort in the pressure, one that empties in the flow.
const BOTH: f64 = 2.0;
/// Least share of each.
const LEAST: f64 = 0.4;
/// Least fall back as a share of the flow at the peak: a strong flow is not steady.
const UNSTEADY: f64 = 0.15;
/// Time after the inspiration in which the expiratory valve opens and gas sloshes, s.
const OPENING_S: f64 = 0.25;
/// Time before and after the highest flow of an effort in which the pressure is lowest, s; and in which it recovers.
const AROUND_S: f64 = 0.3;
const RECOVERS_S: f64 = 1.0;
/// Part of that fall which precedes the highest flow.
const FALLS: f64 = 0.25;
/// Share of an inspiration's highest flow below which the flow has ended.
const ENDED: f64 = 0.1;
/// Rise of the flow that hardly raises the pressure, as a share of the highest.
const STEADY: f64 = 0.02;
/// Rise of the pressure against which the patient exhales, cmH2O: twice what is taken for an effort.
const AGAINST: f64 = 1.0;
/// Share of a pressure's rise that the inflow may explain, if muscles do the rest.
const EXPLAINED: f64 = 0.5;
/// Time in which flow and pressure leave their lines, and of the lines before that, s.
const SIGN_S: f64 = 0.35;
const LINE_S: f64 = 0.4;
/// Multiple of the noise that is no sign.
const NOISES: f64 = 6.0;

/// Number of efforts in the expiration that no breath follows: bumps of the flow towards the patient and back, each with a
/// fall of the pressure that recovers. A ventilator that lowers the pressure draws gas the other way.
pub(super) fn missed(course: &Course, noise: Noise) -> usize {
    let from = course.inspiration + course.ticks(OPENING_S);
    let to = course.flow.len();
    if from + course.ticks(RECOVERS_S) / 2 >= to {
        return 0;
    }
    let noise = noise.smoothed(course.period_s);
    let (flow, pressure) = (MISSED_FLOW.min(MISSED_SHARE * strongest(course)), MISSED_PRESSURE);
    let bump = (LEAST * flow).max(NOISES * noise.flow);
    let dip = (LEAST * pressure).max(NOISES * noise.pressure);
    let effort = |peak: &usize| {
        let peak = from + peak;
        let (back, (lowest, recovered)) = (falls_back(course, peak), recovered(course, peak));
        let draws = falls(course, peak, flow) >= FALLS * dip || leaves_lines(course, lowest, bump, dip);
        let still = back < UNSTEADY * course.flow[peak].abs();
        recovered >= dip && draws && !still && back / flow + recovered / pressure >= BOTH
    };
    // Peaks and valleys take turns; the first value is no peak.
    let (turns, _) = reversals(&course.flow[from..to], bump);
    turns.iter().step_by(2).filter(|peak| **peak > 0 && effort(peak)).count()
}

/// Strongest expiratory flow, L/s.
fn strongest(course: &Course) -> f64 {
    -course.flow[course.inspiration..].iter().copied().fold(0.0, f64::min)
}

/// Whether flow and pressure leave their lines in the sense of an effort until the pressure is lowest.
fn leaves_lines(course: &Course, lowest: usize, bump: f64, dip: f64) -> bool {
    let (line, sign) = (course.ticks(LINE_S), course.ticks(SIGN_S));
    let Some(from) = (lowest + 1).checked_sub(line + sign) else { return false };
    let at_end = |values: &[f64]| deviation(&values[from..=lowest], line, sign - 1);
    from >= course.inspiration + course.ticks(OPENING_S)
        && at_end(&course.flow).is_some_and(|flow| flow >= bump)
        && at_end(&course.pressure).is_some_and(|pressure| -pressure >= dip)
}

/// Fall of the flow after its peak, L/s.
fn falls_back(course: &Course, peak: usize) -> f64 {
    let after = &course.flow[peak..(peak + course.ticks(RECOVERS_S)).min(course.flow.len())];
    course.flow[peak] - after.iter().copied().fold(f64::INFINITY, f64::min)
}

/// Fall of the pressure while the flow rises by this bump to its peak, cmH2O. It rises where the ventilator fills the lung.
fn falls(course: &Course, peak: usize, bump: f64) -> f64 {
    let start = course.flow[..peak].iter().rposition(|flow| *flow <= course.flow[peak] - bump).unwrap_or(0);
    course.pressure[start] - course.pressure[peak]
}

/// Where the pressure is lowest around a peak of the flow, and its recovery afterwards, cmH2O.
fn recovered(course: &Course, peak: usize) -> (usize, f64) {
    let (around, recovers) = (course.ticks(AROUND_S), course.ticks(RECOVERS_S));
    let first = peak.saturating_sub(around).max(course.inspiration);
    let last = (peak + around).min(course.flow.len());
    let lowest = first + lowest(course.pressure[first..last].iter().copied());
    let after = &course.pressure[lowest..(peak + recovers).min(course.flow.len())];
    (lowest, after.iter().copied().fold(f64::NEG_INFINITY, f64::max) - course.pressure[lowest])
}

/// Whether the patient exhales in the second half of an inspiration: its pressure rises while its flow falls to nothing, and
/// the inflow does not explain the rise. In a passive lung a pressure that rises beside a falling flow is one that gas fills.
pub(super) fn exhales_in_inspiration(course: &Course, noise: Noise) -> bool {
    let (flow, pressure) = (&course.flow[..course.inspiration], &course.pressure[..course.inspiration]);
    let noise = noise.smoothed(course.period_s);
    let against = AGAINST.max(NOISES * noise.pressure);
    let half = pressure.len() / 2;
    let top = half + highest(&pressure[half..]);
    let bottom = (half..top).rfind(|n| pressure[*n] <= pressure[top] - against);
    let Some(bottom) = bottom else { return false };
    let compliance = course.inspired_ml() / course.way;
    let explains = course.volume_ml(bottom..top) > EXPLAINED * compliance * against;
    let most = flow[highest(flow)];
    let rises = flow[top] > flow[bottom] + STEADY * most + NOISES * noise.flow;
    flow[top] <= ENDED * most && !rises && !explains
}

/// How far values are above the line through the first `line` of them, at best from the place `least` after those on.
fn deviation(values: &[f64], line: usize, least: usize) -> Option<f64> {
    let rows: Vec<[f64; 2]> = (0..line).map(|n| [1.0, n as f64]).collect();
    let [level, slope] = solve(&rows, &values[..line])?.coefficients;
    (line + least..values.len()).map(|n| values[n] - level - slope * n as f64).reduce(f64::max)
}
