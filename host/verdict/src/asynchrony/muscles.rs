//! The pressure of the patient's muscles at the start of a breath, from the equation of motion.

use super::course::Course;
use engine::least_squares::solve;

/// Muscle pressure that starts no breath, cmH2O: triggers need one or two, and the efforts behind them grow to three and more.
const IDLE: f64 = 1.0;
/// Time before a breath from which its effort rises, s.
const AHEAD_S: f64 = 0.2;
/// Time before that in which the resting lung is followed, s: long beside noise; earlier, muscles may still relax.
const REST_S: f64 = 0.5;
/// Time after a switch of the valves in which gas sloshes and slow sensors lag, s.
const SLOSHES_S: f64 = 0.1;
/// Time into a breath at which the shortest effort is strongest, s; the longest lasts as long as the inspiration.
const SHORTEST_S: f64 = 0.3;
/// Time in which muscles relax, s.
const RELAXES_S: f64 = 0.2;

/// Whether the muscles are certainly idle from shortly before a breath to the end of its inspiration.
pub(super) fn idle(before: &Course, course: &Course) -> bool {
    [SHORTEST_S, course.inspiration_s()]
        .into_iter()
        .all(|strongest_s| most(before, course, strongest_s).is_some_and(|pressure| pressure.abs() < IDLE))
}

/// Most muscle pressure that an effort with this time of its peak may have, cmH2O: the upper end of its 95 % interval. It is what the
/// pressure lacks of resistance, elasticity, drifting flow and leak, in one fit from the rest before the breath to its end. It is
/// far below 0 where an effort of another shape, or a lung of another kind, bends the fit.
fn most(before: &Course, course: &Course, strongest_s: f64) -> Option<f64> {
    let ticks = course.ticks(AHEAD_S + REST_S);
    let rest = before.flow.len().saturating_sub(ticks).max(before.inspiration)..before.flow.len();
    // The next effort begins before the next breath.
    let breath = 0..course.flow.len().saturating_sub(course.ticks(AHEAD_S));
    let start = rest.len() as f64;
    let readings = rest.map(|n| (before, n)).chain(breath.map(|n| (course, n)));
    let (mut volume, mut leaked, mut rows, mut pressures) = (0.0, 0.0, Vec::new(), Vec::new());
    for (count, (course, n)) in readings.enumerate() {
        let t = (count as f64 - start) * course.period_s;
        let [pressure, flow] = course.readings[n];
        volume += flow * course.period_s;
        leaked += pressure * course.period_s;
        let switched = if n < course.inspiration { 0 } else { course.inspiration };
        if n - switched >= course.ticks(SLOSHES_S) {
            rows.push([1.0, t, volume, flow, leaked, -effort(t, strongest_s)]);
            pressures.push(pressure);
        }
    }
    let fit = solve(&rows, &pressures)?;
    Some(fit.coefficients[5] + fit.half_widths[5])
}

/// Muscle pressure as a share of its peak, `t` s after the start of a breath.
fn effort(t: f64, strongest_s: f64) -> f64 {
    let rises = (t + AHEAD_S) / (strongest_s + AHEAD_S);
    rises.min(1.0 - (t - strongest_s) / RELAXES_S).max(0.0)
}
