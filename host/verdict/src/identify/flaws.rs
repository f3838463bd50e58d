//! What spoils the flow of a recording: a delay against the pressure, and a leak. Both are fitted, and taken out of the flow if their
//! intervals do not contain 0 and they explain enough of the residual.

use super::cycle::{Cycle, Drift, FitSpan, FlowPath, LEAK, MOST_DELAY_S};
use super::estimate::{Estimate, Fits, common, estimate};
use crate::series::median;
use engine::least_squares::student;

/// Spacing of the delays that are tried, s.
const DELAY_STEP_S: f64 = 0.004;
/// Number of those spacings between the delays that are tried first.
const COARSE_STEPS: f64 = 5.0;
/// Compliances of the circuit that are tried with each delay, mL/cmH2O: a circuit and a delay bend the curve alike.
const DELAY_CIRCUITS: [f64; 5] = [0.0, 0.75, 1.5, 2.5, 4.0];
/// Most breaths from which the delay is searched.
const MOST_SEARCHED: usize = 6;
/// Residual with a delay, as a share of that without, below which the delay is taken out.
const DELAY_EXPLAINS: f64 = 0.9;
/// An early flow is taken out from here on, ms: a circuit and a lag of the pressure sensor resemble one.
const LEAST_EARLY_MS: f64 = 20.0;
/// Share of the residual beyond noise that a leak has to explain: a real lung is never exactly what the equation says, and a part of the
/// difference resembles a leak.
const EXPLAINS: f64 = 0.5;
/// Number of times that the leak is fitted to what the last fit has left.
const LEAK_ROUNDS: usize = 3;

/// The flaws of a lung's recording.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Flaws {
    /// Delay of the flow against the pressure, ms; negative if the flow is early.
    pub(super) delay_ms: Estimate,
    /// Leak, mL/s per cmH2O.
    pub(super) leak: Estimate,
    /// What of them is taken out of the flow.
    pub(super) taken_out: FlowPath,
    /// Both, whether taken out or not.
    all: FlowPath,
    /// Residuals without the delay and with it, cmH2O.
    pub(super) delay_residuals: (f64, f64),
}

impl Flaws {
    /// The flaws of a lung with these cycles; `None` if none can be fitted.
    ///
    /// `noise` is the standard deviation of the pressure's noise, cmH2O.
    pub(super) fn fit(cycles: &[&Cycle], noise: f64) -> Option<Self> {
        let searched: Vec<&Cycle> =
            cycles.iter().copied().step_by(cycles.len().div_ceil(MOST_SEARCHED).max(1)).collect();
        let delay = Delay::search(&searched)?;
        let path = |delay_s: f64, leak: f64| FlowPath { circuit: delay.circuit, delay_s, leak };
        let delay_ms = delay.interval(cycles);
        let late = (delay_ms.low > 0.0 || delay_ms.high < -LEAST_EARLY_MS)
            && delay.residuals.1 < DELAY_EXPLAINS * delay.residuals.0;
        let delay_s = if late { delay.seconds } else { 0.0 };
        let leak = leak(cycles, path(delay.seconds, 0.0))?;
        let with = |delay_ms: f64| leak_and_precision(cycles, path(delay_ms / 1e3, 0.0));
        let off = |delay_ms: f64| with(delay_ms).map_or(0.0, |(end, _)| (end.value - leak.value).abs());
        let leak = leak.widened(off(delay_ms.low).max(off(delay_ms.high)));
        let square = |leak: f64| {
            let fit =
                |cycle: &&Cycle| cycle.fit(FitSpan::Cycle, Drift::Corrected, &path(delay.seconds, leak));
            pooled(cycles.iter().filter_map(fit).map(|fit| fit.residual)).powi(2)
        };
        let (without, with) = (square(0.0), square(leak.value));
        let noise = noise * noise / cycles.first()?.rows_averaged() as f64;
        let leaks = leak.low > 0.0 && without - with > EXPLAINS * (without - noise);
        let of = |delay_s: f64, leak: f64| FlowPath { circuit: 0.0, delay_s, leak };
        Some(Self {
            delay_ms,
            leak,
            taken_out: of(delay_s, if leaks { leak.value } else { 0.0 }),
            all: of(delay.seconds, leak.value),
            delay_residuals: delay.residuals,
        })
    }

    /// The coefficients 1/C, R and R2 behind a circuit, and the fits with what is taken out. Their intervals count with the ends of those
    /// of the flaws, and what is not taken out may yet be there.
    pub(super) fn coefficients(&self, cycles: &[&Cycle], circuit: f64) -> Option<([Estimate; 3], Fits)> {
        let at = |path: FlowPath| Fits::new(cycles, &FlowPath { circuit, ..path });
        let (taken, all) = (at(self.taken_out), at(self.all));
        let ends = self.ends().map(|ends| ends.map(at));
        let coefficient = |place: usize| {
            let middle = all.coefficient(place)?;
            let off = |fits: &Fits| fits.coefficient(place).map_or(0.0, |end| end.value - middle.value);
            let middle = ends
                .iter()
                .fold(middle, |middle, [low, high]| middle.widened(off(low).abs().max(off(high).abs())));
            Some(taken.coefficient(place)?.hull(&middle))
        };
        Some(([coefficient(1)?, coefficient(2)?, coefficient(3)?], taken))
    }

    /// The path with both ends of the delay's interval, and with both of the leak's.
    fn ends(&self) -> [[FlowPath; 2]; 2] {
        let (delay, leak) = (&self.delay_ms, &self.leak);
        [
            [delay.low, delay.high].map(|ms| FlowPath { delay_s: ms / 1e3, ..self.all }),
            [leak.low, leak.high].map(|leak| FlowPath { leak, ..self.all }),
        ]
    }
}

/// The delay with the smallest residual, whatever circuit and leak take.
struct Delay {
    seconds: f64,
    /// The circuit's compliance beside it, mL/cmH2O.
    circuit: f64,
    /// Residual without the delay and with it, cmH2O.
    residuals: (f64, f64),
}

impl Delay {
    fn search(cycles: &[&Cycle]) -> Option<Self> {
        let at = |delay_s: f64| {
            let residuals = DELAY_CIRCUITS.map(|circuit| {
                let path = FlowPath { circuit, delay_s, leak: 0.0 };
                (circuit, pooled(cycles.iter().filter_map(|cycle| leaking_residual(cycle, &path))))
            });
            residuals.into_iter().min_by(|a, b| a.1.total_cmp(&b.1)).unwrap_or((0.0, f64::INFINITY))
        };
        // In wide steps, then in narrow ones around the best: the residual has one valley.
        let mut best = (0.0, at(0.0));
        for step_s in [COARSE_STEPS * DELAY_STEP_S, DELAY_STEP_S] {
            let count = if step_s > DELAY_STEP_S { MOST_DELAY_S / step_s } else { COARSE_STEPS };
            let around = |n: i32| (best.0 + f64::from(n) * step_s).clamp(-MOST_DELAY_S, MOST_DELAY_S);
            let tried = (-(count as i32)..=count as i32).map(around).map(|delay| (delay, at(delay)));
            best = tried.min_by(|a, b| a.1.1.total_cmp(&b.1.1))?;
        }
        let (delay, (circuit, least)) = best;
        if !least.is_finite() {
            return None;
        }
        let square = |delay: f64| {
            let path = FlowPath { circuit, delay_s: delay, leak: 0.0 };
            pooled(cycles.iter().filter_map(|cycle| leaking_residual(cycle, &path))).powi(2)
        };
        let seconds = delay + vertex(square, delay).map_or(0.0, |vertex| vertex.0);
        Some(Self { seconds, circuit, residuals: (at(0.0).1, least) })
    }

    /// The delay in ms, from the spread of the breaths' own best delays, the precision of each, and what the sampling hides.
    fn interval(&self, cycles: &[&Cycle]) -> Estimate {
        let thinned: Vec<Cycle> = cycles.iter().map(|cycle| cycle.thinned()).collect();
        let own = |cycles: &mut dyn Iterator<Item = &Cycle>| -> Vec<_> {
            cycles.filter_map(|cycle| self.of_cycle(cycle)).collect()
        };
        let (full, thinned) = (own(&mut cycles.iter().copied()), own(&mut thinned.iter()));
        let half = median(full.iter().map(|(_, half)| *half).collect());
        let mean =
            |own: &[(f64, f64)]| estimate(&own.iter().map(|(value, _)| *value).collect::<Vec<_>>(), half);
        mean(&full).map_or(
            Estimate { value: 1e3 * self.seconds, low: -1e3 * MOST_DELAY_S, high: 1e3 * MOST_DELAY_S },
            |found| {
                let sampling = mean(&thinned).map_or(0.0, |thinned| thinned.value - found.value);
                found.widened(half).widened(sampling).centred(1e3 * self.seconds)
            },
        )
    }

    /// The delay of one cycle and its half-width, ms.
    fn of_cycle(&self, cycle: &Cycle) -> Option<(f64, f64)> {
        let path = |delay_s: f64| FlowPath { circuit: self.circuit, delay_s, leak: 0.0 };
        let square = |delay_s: f64| leaking_residual(cycle, &path(delay_s)).map_or(f64::INFINITY, |r| r * r);
        let independent = cycle.leaking(&path(self.seconds))?.independent;
        let (off, curvature) = vertex(square, self.seconds)?;
        let best = self.seconds + off;
        let half = student(usize::MAX) * (square(best) / independent / curvature).sqrt();
        Some((1e3 * best, 1e3 * half))
    }
}

/// The distance from `middle` to the lowest point of the parabola through a function's values around it, and its second derivative by
/// half; `None` if it has no lowest point.
fn vertex(function: impl Fn(f64) -> f64, middle: f64) -> Option<(f64, f64)> {
    let [left, here, right] = [-1.0, 0.0, 1.0].map(|side| function(middle + side * DELAY_STEP_S));
    let bend = 0.5 * (left + right) - here;
    (bend > 0.0 && bend.is_finite()).then(|| {
        let off = 0.25 * (left - right) / bend;
        (off.clamp(-2.0, 2.0) * DELAY_STEP_S, bend / DELAY_STEP_S.powi(2))
    })
}

/// The leak, mL/s per cmH2O. As with every coefficient, its interval also has what all cycles have in common and what the sampling hides.
fn leak(cycles: &[&Cycle], path: FlowPath) -> Option<Estimate> {
    let (leak, single) = leak_and_precision(cycles, path)?;
    let thinned: Vec<Cycle> = cycles.iter().map(|cycle| cycle.thinned()).collect();
    let thinned = leak_and_precision(&thinned.iter().collect::<Vec<_>>(), path);
    let sampling = thinned.map_or(0.0, |(thinned, _)| thinned.value - leak.value);
    let path = FlowPath { leak: leak.value, ..path };
    Some(leak.widened(single * common(cycles, &path)).widened(sampling))
}

/// The leak with the interval that its spread over the cycles gives, and the usual precision of a single cycle.
fn leak_and_precision(cycles: &[&Cycle], mut path: FlowPath) -> Option<(Estimate, f64)> {
    let mut found = None;
    for _ in 0..LEAK_ROUNDS {
        let own = |cycle: &&Cycle| {
            let fit = cycle.leaking(&path)?;
            let elastance = fit.coefficients[1];
            Some((path.leak - fit.coefficients[LEAK] / elastance, fit.half_widths[LEAK] / elastance.abs()))
        };
        let own: Vec<(f64, f64)> = cycles.iter().filter_map(own).collect();
        let single = median(own.iter().map(|(_, half)| *half).collect());
        let leak = estimate(&own.iter().map(|(leak, _)| *leak).collect::<Vec<_>>(), single)?;
        path.leak = leak.value;
        found = Some((leak, single));
    }
    found
}

fn leaking_residual(cycle: &Cycle, path: &FlowPath) -> Option<f64> {
    Some(cycle.leaking(path)?.residual)
}

/// Root mean square of residuals; infinite without any.
fn pooled(residuals: impl Iterator<Item = f64>) -> f64 {
    let (sum, count) =
        residuals.fold((0.0, 0.0), |(sum, count), residual| (sum + residual * residual, count + 1.0));
    if count > 0.0 { (sum / count).sqrt() } else { f64::INFINITY }
}
