//! One respiratory cycle as the rows of a least-squares problem.

use std::ops::Range;

use data::recording::Recording;
use engine::least_squares::{Solution, solve};

/// Coefficients of the equation of motion: P0, 1/C, R, R2.
pub const COEFFICIENTS: usize = 4;
/// Coefficient of a leak in [`Cycle::leaking`], after those: minus the leak times 1/C.
pub const LEAK: usize = COEFFICIENTS;
const ML_PER_L: f64 = 1000.0;
/// Time span of the rows from which a row's pressure slope is computed, s.
const SLOPE_S: f64 = 0.02;

/// A whole respiratory cycle: pressures, net flow without the drift of its sensors, and the pressure's slope.
#[derive(Debug, Clone, PartialEq)]
pub struct Cycle {
    period_s: f64,
    /// Number of rows of its inspiration.
    inspiration: usize,
    pressure: Vec<f64>,
    /// Measured inflow minus outflow, L/s.
    flow: Vec<f64>,
    /// Slope of the pressure, cmH2O/s.
    slope: Vec<f64>,
    /// Mean net flow over the cycle, which is the sensors' offset, L/s.
    pub offset: f64,
}

/// The rows of a cycle that are fitted.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum FitSpan {
    /// The inspiration only.
    Inspiration,
    /// The whole cycle.
    Cycle,
}

/// Whether the drift of the flow sensors is removed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Drift {
    /// The flow as measured.
    Kept,
    /// The flow minus its mean over the cycle.
    Corrected,
}

impl Cycle {
    /// The cycle in these rows of a recording with flows; the slope also uses rows around the cycle where available.
    pub fn new(recording: &Recording, rows: &Range<usize>, inspiration: usize) -> Option<Self> {
        let (flow_in, flow_out) = (recording.flow_in.as_deref()?, recording.flow_out.as_deref()?);
        let flow: Vec<f64> =
            rows.clone().map(|row| f64::from(flow_in[row]) - f64::from(flow_out[row])).collect();
        let pressure: Vec<f64> = recording.pressure[rows.clone()].iter().map(|p| f64::from(*p)).collect();
        let period_s = recording.provenance.period_s();
        let offset = flow.iter().sum::<f64>() / flow.len().max(1) as f64;
        Some(Self { period_s, inspiration, slope: slopes(&pressure, period_s), pressure, flow, offset })
    }

    /// Measured pressures, cmH2O.
    pub fn pressure(&self) -> &[f64] {
        &self.pressure
    }

    /// Time between rows, s.
    pub fn period_s(&self) -> f64 {
        self.period_s
    }

    /// The least-squares fit of `P = P0 + V/C + R q + R2 q|q|`, where `q` is the net flow minus the flow into the
    /// circuit (`circuit`, mL/cmH2O, times the slope of the pressure). Coefficients in that order, 1/C in cmH2O/mL.
    pub fn fit(&self, span: FitSpan, drift: Drift, circuit: f64) -> Option<Solution<COEFFICIENTS>> {
        let rows = self.rows(drift, circuit);
        let count = match span {
            FitSpan::Inspiration => self.inspiration.min(rows.len()),
            FitSpan::Cycle => rows.len(),
        };
        solve(&rows[..count], &self.pressure[..count])
    }

    /// Pressures that the fit over the whole cycle predicts from the corrected flow behind a circuit of this compliance
    /// (mL/cmH2O), cmH2O.
    pub fn fitted(&self, circuit: f64) -> Option<Vec<f64>> {
        let fit = self.fit(FitSpan::Cycle, Drift::Corrected, circuit)?;
        let value = |row: [f64; COEFFICIENTS]| row.iter().zip(fit.coefficients).map(|(x, c)| x * c).sum();
        Some(self.rows(Drift::Corrected, circuit).into_iter().map(value).collect())
    }

    /// The fit over the whole cycle, behind a circuit, with a leak in proportion to the pressure as a fifth coefficient:
    /// the volume that it takes, per mL/s and cmH2O, is a column of its own. The mean leak is within the offset already.
    pub fn leaking(&self, circuit: f64) -> Option<Solution<{ LEAK + 1 }>> {
        let mean = self.pressure.iter().sum::<f64>() / self.pressure.len() as f64;
        let mut escaped = 0.0;
        let column = self.pressure.iter().map(|pressure| {
            escaped += (pressure - mean) * self.period_s;
            escaped
        });
        let rows = self.rows(Drift::Corrected, circuit).into_iter().zip(column);
        let rows: Vec<_> = rows.map(|([a, b, c, d], escaped)| [a, b, c, d, escaped]).collect();
        solve(&rows, &self.pressure)
    }

    /// The cycle with the flow of `rows` rows later beside each pressure (earlier if negative); without the rows at the
    /// ends that then have no partner. `None` if none is left.
    pub fn shifted(&self, rows: i32) -> Option<Self> {
        let by = rows.unsigned_abs() as usize;
        let length = self.flow.len().checked_sub(by).filter(|length| *length > 0)?;
        let (flow_from, pressure_from) = if rows > 0 { (by, 0) } else { (0, by) };
        Some(Self {
            flow: self.flow[flow_from..][..length].to_vec(),
            pressure: self.pressure[pressure_from..][..length].to_vec(),
            slope: self.slope[pressure_from..][..length].to_vec(),
            ..self.clone()
        })
    }

    /// One row per sample: 1, volume since the start of the cycle (mL), flow, flow times its magnitude.
    pub fn rows(&self, drift: Drift, circuit: f64) -> Vec<[f64; COEFFICIENTS]> {
        let offset = if drift == Drift::Corrected { self.offset } else { 0.0 };
        let mut volume = 0.0;
        let mut before = None;
        let row = |(flow, slope): (&f64, &f64)| {
            let flow = flow - offset - circuit / ML_PER_L * slope;
            // Trapezoidal rule; the first row has no predecessor.
            volume +=
                before.replace(flow).map_or(0.0, |last: f64| 0.5 * (last + flow)) * self.period_s * ML_PER_L;
            [1.0, volume, flow, flow * flow.abs()]
        };
        self.flow.iter().zip(&self.slope).map(row).collect()
    }

    /// Root mean square of the corrected flow during the inspiration, L/s.
    pub fn inspiratory_flow(&self) -> f64 {
        let flows = &self.flow[..self.inspiration.min(self.flow.len())];
        let square: f64 = flows.iter().map(|flow| (flow - self.offset).powi(2)).sum();
        (square / flows.len().max(1) as f64).sqrt()
    }
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
