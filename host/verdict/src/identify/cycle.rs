//! One respiratory cycle as the rows of a least-squares problem.

use std::array::from_fn;
use std::ops::Range;

use data::recording::Recording;
use engine::least_squares::{Solution, solve};

/// Coefficients of the equation of motion: P0, 1/C, R, R2.
pub const COEFFICIENTS: usize = 4;
/// Coefficient of a leak in [`Cycle::leaking`], after those: minus the leak times 1/C.
pub const LEAK: usize = COEFFICIENTS;
const ML_PER_L: f64 = 1000.0;
/// Largest delay between flow and pressure that can be taken out, s.
pub const MOST_DELAY_S: f64 = 0.1;
/// Time over which rows are averaged before they are fitted, s.
const AVERAGE_S: f64 = 0.05;
/// Time span of the rows from which a row's pressure slope is computed, s.
const SLOPE_S: f64 = 0.02;

/// A whole respiratory cycle: pressures, net flow, and the pressure's slope.
#[derive(Debug, Clone, PartialEq)]
pub struct Cycle {
    period_s: f64,
    /// Number of rows of its inspiration.
    inspiration: usize,
    pressure: Vec<f64>,
    /// Measured inflow minus outflow, L/s, with the rows around the cycle that a shift needs.
    flow: Vec<f64>,
    /// Number of those rows before the cycle.
    before: usize,
    /// Slope of the pressure, cmH2O/s.
    slope: Vec<f64>,
}

/// The rows of a cycle that are fitted.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum FitSpan {
    /// The inspiration only.
    Inspiration,
    /// The whole cycle.
    Cycle,
}

/// What is removed from the measured flow as the drift of its sensors.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Drift {
    /// Nothing.
    Kept,
    /// Its mean over the cycle.
    Corrected,
    /// This offset, L/s.
    Known(f64),
}

/// What lies between the measured flow and the flow into the lung; nothing by default.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct FlowPath {
    /// Compliance of the circuit, mL/cmH2O.
    pub circuit: f64,
    /// Delay of the measured flow against the measured pressure, s.
    pub delay_s: f64,
    /// Leak, mL/s per cmH2O.
    pub leak: f64,
}

impl Cycle {
    /// The cycle in these rows of a recording with flows.
    pub fn new(recording: &Recording, rows: &Range<usize>, inspiration: usize) -> Option<Self> {
        let (flow_in, flow_out) = (recording.flow_in.as_deref()?, recording.flow_out.as_deref()?);
        let period_s = recording.provenance.period_s();
        let around = (MOST_DELAY_S / period_s).ceil() as usize;
        let first = rows.start.saturating_sub(around);
        let wide = first..(rows.end + around).min(flow_in.len());
        let flow = wide.map(|row| f64::from(flow_in[row]) - f64::from(flow_out[row])).collect();
        let pressure: Vec<f64> = recording.pressure[rows.clone()].iter().map(|p| f64::from(*p)).collect();
        let (slope, before) = (slopes(&pressure, period_s), rows.start - first);
        Some(Self { period_s, inspiration, pressure, flow, before, slope })
    }

    /// Measured pressures, cmH2O.
    pub fn pressure(&self) -> &[f64] {
        &self.pressure
    }

    /// Time between rows, s.
    pub fn period_s(&self) -> f64 {
        self.period_s
    }

    /// Mean net flow over the cycle, which is the offset of the sensors, L/s.
    pub fn offset(&self) -> f64 {
        mean(self.flow[self.before..].iter().take(self.pressure.len()).copied())
    }

    /// The least-squares fit of `P = P0 + V/C + R q + R2 q|q|`, where `q` is the flow into the lung on this path.
    /// Coefficients in that order, 1/C in cmH2O/mL.
    pub fn fit(&self, span: FitSpan, drift: Drift, path: &FlowPath) -> Option<Solution<COEFFICIENTS>> {
        let rows = self.rows(drift, path);
        match span {
            // Too few to be averaged.
            FitSpan::Inspiration => {
                let count = self.inspiration.min(rows.len());
                solve(&rows[..count], &self.pressure[..count])
            }
            FitSpan::Cycle => {
                let (rows, pressure) = self.averaged(&rows);
                solve(&rows, &pressure)
            }
        }
    }

    /// The fit over the whole cycle with a leak beyond that of the path as a fifth coefficient: the volume that it takes, per mL/s and
    /// cmH2O, is a column of its own. The mean leak is within the offset already.
    pub fn leaking(&self, path: &FlowPath) -> Option<Solution<{ LEAK + 1 }>> {
        let mean = mean(self.pressure.iter().copied());
        let mut escaped = 0.0;
        let column = self.pressure.iter().map(|pressure| {
            escaped += (pressure - mean) * self.period_s;
            escaped
        });
        let rows = self.rows(Drift::Corrected, path).into_iter().zip(column);
        let rows: Vec<_> = rows.map(|([a, b, c, d], escaped)| [a, b, c, d, escaped]).collect();
        let (rows, pressure) = self.averaged(&rows);
        solve(&rows, &pressure)
    }

    /// Number of rows that are averaged.
    pub fn rows_averaged(&self) -> usize {
        ((AVERAGE_S / self.period_s).round() as usize).max(2)
    }

    /// Rows and pressures, averaged over [`AVERAGE_S`]. Averages follow the same equation, and noise of the flow, which makes R too
    /// small, is less in them.
    fn averaged<const N: usize>(&self, rows: &[[f64; N]]) -> (Vec<[f64; N]>, Vec<f64>) {
        let block = self.rows_averaged();
        let average = |part: &[[f64; N]]| from_fn(|n| mean(part.iter().map(|row| row[n])));
        let pressures = self.pressure[..rows.len()].chunks(block);
        (
            rows.chunks(block).map(average).collect(),
            pressures.map(|part| mean(part.iter().copied())).collect(),
        )
    }

    /// Pressures that the fit over the whole cycle predicts from the corrected flow on this path, cmH2O.
    pub fn fitted(&self, path: &FlowPath) -> Option<Vec<f64>> {
        let fit = self.fit(FitSpan::Cycle, Drift::Corrected, path)?;
        let value = |row: [f64; COEFFICIENTS]| row.iter().zip(fit.coefficients).map(|(x, c)| x * c).sum();
        Some(self.rows(Drift::Corrected, path).into_iter().map(value).collect())
    }

    /// Measured pressures minus those of the fit, averaged as they are fitted, cmH2O.
    pub fn left(&self, path: &FlowPath) -> Option<Vec<f64>> {
        let fitted = self.fitted(path)?;
        let left: Vec<_> =
            fitted.iter().zip(&self.pressure).map(|(fitted, pressure)| [pressure - fitted]).collect();
        Some(self.averaged(&left).0.into_iter().map(|[left]| left).collect())
    }

    /// Every second row: what a recorder of half the rate would have seen.
    #[must_use]
    pub fn thinned(&self) -> Self {
        let second = |values: &[f64], from: usize| values.iter().skip(from).step_by(2).copied().collect();
        Self {
            period_s: 2.0 * self.period_s,
            inspiration: self.inspiration.div_ceil(2),
            pressure: second(&self.pressure, 0),
            flow: second(&self.flow, self.before % 2),
            before: self.before / 2,
            slope: second(&self.slope, 0),
        }
    }

    /// One row per sample: 1, volume since the start of the cycle (mL), flow, flow times its magnitude.
    pub fn rows(&self, drift: Drift, path: &FlowPath) -> Vec<[f64; COEFFICIENTS]> {
        let mut flows: Vec<f64> = self.flows(path);
        let offset = match drift {
            Drift::Kept => 0.0,
            Drift::Corrected => mean(flows.iter().copied()),
            Drift::Known(offset) => offset,
        };
        for (flow, slope) in flows.iter_mut().zip(&self.slope) {
            *flow -= offset + path.circuit / ML_PER_L * slope;
        }
        let mut volume = 0.0;
        let mut before = None;
        let row = |flow: f64| {
            // Trapezoidal rule; the first row has no predecessor.
            volume +=
                before.replace(flow).map_or(0.0, |last: f64| 0.5 * (last + flow)) * self.period_s * ML_PER_L;
            [1.0, volume, flow, flow * flow.abs()]
        };
        flows.into_iter().map(row).collect()
    }

    /// Net flow without the leak, with the delay taken out, L/s.
    fn flows(&self, path: &FlowPath) -> Vec<f64> {
        let later = path.delay_s / self.period_s + self.before as f64;
        let leak = path.leak / ML_PER_L;
        let at = |(row, pressure): (usize, &f64)| between(&self.flow, later + row as f64) - leak * pressure;
        self.pressure.iter().enumerate().map(at).collect()
    }

    /// Root mean square of the corrected flow during the inspiration, L/s.
    pub fn inspiratory_flow(&self) -> f64 {
        let rows = self.rows(Drift::Corrected, &FlowPath::default());
        mean(rows.iter().take(self.inspiration).map(|row| row[2] * row[2])).sqrt()
    }
}

/// The value at a place between two rows, on the straight line between them; at the ends, that of the outermost row.
fn between(values: &[f64], place: f64) -> f64 {
    let last = values.len() - 1;
    let place = place.clamp(0.0, last as f64);
    let (row, share) = (place as usize, place.fract());
    values[row] + (values[(row + 1).min(last)] - values[row]) * share
}

fn mean(values: impl ExactSizeIterator<Item = f64>) -> f64 {
    let count = values.len().max(1) as f64;
    values.sum::<f64>() / count
}

/// Slope of a least-squares line through the rows around each row.
fn slopes(values: &[f64], period_s: f64) -> Vec<f64> {
    let reach = ((SLOPE_S / period_s).round() as usize).max(1);
    (0..values.len())
        .map(|row| {
            let rows = row.saturating_sub(reach)..(row + reach + 1).min(values.len());
            let middle = (rows.start + rows.end - 1) as f64 / 2.0;
            let (mut product, mut square) = (0.0, 0.0);
            for row in rows {
                let time = (row as f64 - middle) * period_s;
                product += time * values[row];
                square += time * time;
            }
            if square > 0.0 { product / square } else { 0.0 }
        })
        .collect()
}
