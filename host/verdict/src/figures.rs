//! The figures of one breath. A figure that cannot be known is `None`, and a remark says why.

use std::ops::Range;

use serde::Serialize;

use super::curve::{BreathCurve, SMALLEST_STEP};
use super::ramp::Ramp;
use super::series::{highest, lowest};
use super::swings::{Swings, Turns};
use engine::least_squares::solve;
use monitoring::curve::{RISE, mean_over_time, rise};
use score::evaluate::{PLATEAU_S, score_breath};
use shared::settings::Settings;

/// Time at the end of a phase over which the pressure is averaged, s.
const END_S: f64 = 0.05;
/// Earliest start of the plateau, s after the start of the inspiration.
const PLATEAU_FROM_S: f64 = 0.1;
/// Shortest plateau that is judged, s.
const SHORTEST_PLATEAU_S: f64 = 0.1;
/// Largest change of a target that counts as settled, cmH2O.
const SETTLED: f64 = 0.1;
/// Difference between a target and PIP that is worth a remark, cmH2O.
const CLIPPED: f64 = 0.1;

/// What the other breaths and the recording say about a breath.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Context {
    /// Whether the targets are set-points, not taken from the measured pressure.
    pub set_point: bool,
    /// Standard deviation of the pressure's noise, cmH2O.
    pub noise: f64,
    /// Usual length of the inspiration at these settings, s.
    pub usual_inspiration_s: f64,
    /// Whether the breath was recorded to its end.
    pub whole: bool,
}

/// Figures of one breath; pressures in cmH2O.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Figures {
    /// Pressure at which the target rests in the inspiration; all figures refer to it.
    pub level: f64,
    /// Mean absolute error over the inspiration (the score of `trainer evaluate`).
    pub error: Option<f64>,
    /// Time from 10 to 90 % of the way from PEEP to the level, ms.
    pub rise_ms: Option<f64>,
    /// The same time of the target; `None` if it is inferred.
    pub target_rise_ms: Option<f64>,
    /// Whether the pressure gets to 90 % of that way.
    pub reached: bool,
    /// Highest pressure above the level, at least 0.
    pub overshoot: f64,
    /// Its time, s after the start of the inspiration.
    pub peak_at_s: f64,
    /// Highest pressure of the inspiration.
    pub peak: f64,
    /// Deepest fall below the level after the first peak, at least 0.
    pub undershoot: Option<f64>,
    /// Its time, s after the start of the inspiration.
    pub undershoot_at_s: Option<f64>,
    /// Swings after the rise.
    pub swings: Option<Swings>,
    /// Mean distance from the level over the plateau, the last 0.3 s of the inspiration.
    pub plateau_error: Option<f64>,
    /// The same with its sign: positive if the plateau is too high.
    pub plateau_bias: Option<f64>,
    /// Slope of the pressure over the plateau, cmH2O/s.
    pub slope: Option<f64>,
    /// Mean pressure over the last 50 ms of the inspiration.
    pub end_inspiration: Option<f64>,
    /// Mean pressure over the last 50 ms of the expiration.
    pub end_expiration: Option<f64>,
    /// Deepest fall below PEEP after the inspiration, at least 0.
    pub below_peep: Option<f64>,
    /// Its time, s after the start of the inspiration.
    pub below_peep_at_s: Option<f64>,
    /// Length of the inspiration as the recording marks it, s.
    pub inspiration_s: f64,
    /// Time for which the pressure stays above half of the way from PEEP to the level, s.
    pub inspiratory_time_s: Option<f64>,
    /// Length of the breath, s.
    pub breath_s: Option<f64>,
    /// Part of the usual inspiration that is missing at its end, 0 to 1.
    pub cut: f64,
    /// Number of missing ticks of the inspiration that were bridged by straight lines.
    pub bridged: usize,
    /// Why figures are missing, or what to know about them.
    pub remarks: Vec<String>,
}

/// Part of its usual length from which on an inspiration counts as cut short.
pub(super) const CUT: f64 = 0.1;

impl Figures {
    /// Computes the figures of a breath.
    pub(super) fn new(curve: &BreathCurve, context: &Context) -> Self {
        let (level, settled) = level(&curve.target, curve.peep, curve.period_s);
        let settings = Settings { pip: level as f32, peep: curve.peep as f32, ..Settings::default() };
        let score = score_breath(&settings, curve.period_s, &curve.pressure, &curve.target);
        let highest = highest(&curve.pressure);
        let peak = curve.pressure[highest];
        let mut figures = Self {
            level,
            error: context.set_point.then_some(score.score),
            rise_ms: None,
            target_rise_ms: None,
            reached: false,
            overshoot: (peak - level).max(0.0),
            peak_at_s: highest as f64 * curve.period_s,
            peak,
            undershoot: None,
            undershoot_at_s: None,
            swings: None,
            plateau_error: None,
            plateau_bias: None,
            slope: None,
            end_inspiration: None,
            end_expiration: None,
            below_peep: None,
            below_peep_at_s: None,
            inspiration_s: curve.inspiration_s(),
            inspiratory_time_s: None,
            breath_s: context.whole.then(|| curve.length_s()),
            cut: (1.0 - curve.inspiration_s() / context.usual_inspiration_s).max(0.0),
            bridged: curve.bridged,
            remarks: Vec::new(),
        };
        figures.rise(curve, context);
        figures.settle(curve, context.noise);
        let risen = figures.risen(curve, settled.clone(), context);
        figures.plateau(curve, risen, context);
        figures.expiration(curve, context);
        figures.target(curve, &settled, context);
        figures
    }

    fn rise(&mut self, curve: &BreathCurve, context: &Context) {
        let way = (curve.peep, self.level);
        if context.set_point {
            self.target_rise_ms =
                rise(&curve.target, way, curve.period_s).map(|(start, end)| 1e3 * (end - start));
        }
        let reached = rise(&curve.pressure, way, curve.period_s);
        self.reached = reached.is_some();
        if curve.pressure[0] >= way.0 + RISE.0 * (way.1 - way.0) {
            self.remarks.push("no rise time: the pressure is above 10 % of the way at the start".to_owned());
        } else if let Some((start, end)) = reached {
            self.rise_ms = Some(1e3 * (end - start));
        } else {
            self.remarks.push("no rise time: the pressure does not reach 90 % of the way".to_owned());
        }
    }

    /// The settled ticks of the target without those in which the pressure still rises as a rise-time setting makes it: one
    /// that the target does not show, or any rise if the target is inferred.
    fn risen(&mut self, curve: &BreathCurve, settled: Range<usize>, context: &Context) -> Range<usize> {
        let way = (curve.peep, self.level);
        let ramp = |values: &[f64], noise: f64| Ramp::new(values, way, curve.period_s, noise);
        let Some(rise) = ramp(&curve.pressure, context.noise) else { return settled };
        let own = context.set_point && ramp(&curve.target, 0.0).is_some_and(|target| rise.is_own(&target));
        if own {
            self.remarks.push(
                "the pressure rises in a straight line, its target at once: a rise-time setting or a limited flow, which \
                 error and rise time include"
                    .to_owned(),
            );
        }
        let risen = (rise.end_s / curve.period_s).ceil() as usize;
        let first = if own || !context.set_point { settled.start.max(risen) } else { settled.start };
        first.min(settled.end)..settled.end
    }

    /// Undershoot and swings, from the end of the rise on.
    fn settle(&mut self, curve: &BreathCurve, noise: f64) {
        let Some((_, end)) = rise(&curve.pressure, (curve.peep, self.level), curve.period_s) else {
            return;
        };
        let from = ((end / curve.period_s).ceil() as usize).min(curve.pressure.len() - 1);
        let turns = Turns::new(&curve.pressure[from..], curve.period_s, noise);
        self.swings = Some(turns.swings());
        self.undershoot = Some(0.0);
        if let Some(peak) = turns.first_peak() {
            let after = from + peak;
            let lowest = after + lowest(curve.pressure[after..].iter().copied());
            self.undershoot = Some((self.level - curve.pressure[lowest]).max(0.0));
            self.undershoot_at_s = Some(lowest as f64 * curve.period_s);
        }
    }

    /// The end of the inspiration, as far as the target rests at its level.
    fn plateau(&mut self, curve: &BreathCurve, settled: Range<usize>, context: &Context) {
        if self.cut > CUT {
            self.remarks.push(format!(
                "no plateau: the inspiration ends after {:.2} s, usually after {:.2} s",
                self.inspiration_s, context.usual_inspiration_s
            ));
            return;
        }
        let first = settled.start.max((PLATEAU_FROM_S / curve.period_s).round() as usize);
        let ticks = |seconds: f64| ((seconds / curve.period_s).round() as usize).max(1);
        let longest = settled.end.saturating_sub(first).min(ticks(PLATEAU_S));
        if longest < ticks(SHORTEST_PLATEAU_S) {
            self.remarks
                .push("no plateau: the target still moves, or the inspiration is too short".to_owned());
            return;
        }
        let last = |count: usize| &curve.pressure[settled.end - count.min(settled.end)..settled.end];
        let plateau = last(longest);
        let rows: Vec<[f64; 2]> = (0..plateau.len()).map(|n| [1.0, n as f64 * curve.period_s]).collect();
        self.slope = solve(&rows, plateau).map(|line| line.coefficients[1]);
        self.end_inspiration = Some(mean(last(ticks(END_S))));
        if context.set_point {
            let errors: Vec<f64> = plateau.iter().map(|p| p - self.level).collect();
            let sizes: Vec<f64> = errors.iter().map(|error| error.abs()).collect();
            self.plateau_bias = Some(mean_over_time(&errors));
            self.plateau_error = Some(mean_over_time(&sizes));
        }
    }

    fn expiration(&mut self, curve: &BreathCurve, context: &Context) {
        let pressures = || curve.rest.iter().map(|(_, pressure)| *pressure);
        let lowest = lowest(pressures());
        if let Some((tick, pressure)) = curve.rest.get(lowest)
            && context.set_point
        {
            self.below_peep = Some((curve.peep - pressure).max(0.0));
            self.below_peep_at_s = Some(f64::from(*tick) * curve.period_s);
        }
        if context.whole {
            let from = curve.length_s() - END_S - 0.5 * curve.period_s;
            let end: Vec<f64> = curve
                .rest
                .iter()
                .filter(|(tick, _)| f64::from(*tick) * curve.period_s >= from)
                .map(|(_, pressure)| *pressure)
                .collect();
            self.end_expiration = (!end.is_empty()).then(|| mean(&end));
        } else {
            self.remarks.push(
                "no end of expiration: the breath is shorter than those around it, or the only one"
                    .to_owned(),
            );
        }
        let half = 0.5 * (curve.peep + self.level);
        let inspiration = curve.pressure.iter().enumerate().map(|(tick, pressure)| (tick as u32, *pressure));
        let mut all = inspiration.chain(curve.rest.iter().copied());
        let up = all.by_ref().find(|(_, pressure)| *pressure >= half);
        // A dip below half in the inspiration is not its end.
        let down = all.find(|(tick, pressure)| *tick as usize >= curve.pressure.len() && *pressure < half);
        self.inspiratory_time_s =
            up.zip(down).map(|((up, _), (down, _))| f64::from(down.saturating_sub(up)) * curve.period_s);
    }

    fn target(&mut self, curve: &BreathCurve, settled: &Range<usize>, context: &Context) {
        if !settled.is_empty() && settled.end < curve.target.len() {
            self.remarks.push("the target falls before the inspiration ends".to_owned());
        }
        let below = curve.pip - self.level;
        if context.set_point && below.abs() > CLIPPED {
            let side = if below > 0.0 { "below" } else { "above" };
            self.remarks.push(format!(
                "the target rests {:.1} cmH2O {side} PIP; judged against the target",
                below.abs()
            ));
        }
        if curve.bridged > 0 {
            self.remarks.push(format!("{} missing ticks are bridged by straight lines", curve.bridged));
        }
    }
}

/// The pressure at which the target rests in the second half of the inspiration, cmH2O, and the last ticks in which it
/// does; the highest target and no ticks if it does not rest.
fn level(target: &[f64], peep: f64, period_s: f64) -> (f64, Range<usize>) {
    let mut late = target[target.len() / 2..].to_vec();
    late.sort_by(f64::total_cmp);
    let level = late[late.len() / 2];
    let rests = |value: &f64| (value - level).abs() <= SETTLED;
    let end = target.iter().rposition(rests).map_or(0, |last| last + 1);
    let start = end - target[..end].iter().rev().take_while(|value| rests(value)).count();
    if (end - start) as f64 * period_s >= SHORTEST_PLATEAU_S - 1e-9 && level >= peep + SMALLEST_STEP {
        return (level, start..end);
    }
    (target.iter().copied().fold(f64::NEG_INFINITY, f64::max), 0..0)
}

fn mean(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len() as f64
}
