//! The course of a whole breath: pressure and net flow, as measured and smoothed.

use std::ops::Range;

use crate::curve::BreathCurve;
use crate::series::averaged;
use data::recording::Recording;
use data::recording::quality::noise;

/// Time over which noise is averaged out, s: short beside an effort, long beside a converter's steps.
const SMOOTHED_S: f64 = 0.05;
/// Highest outflow as a share of the highest inflow, up to which the outflow was not measured.
const ONE_WAY: f64 = 0.02;
const ML_PER_L: f64 = 1e3;

/// Standard deviations of the noise: pressure, cmH2O, and flow, L/s.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Noise {
    pub pressure: f64,
    pub flow: f64,
}

impl Noise {
    /// The noise that is left in a [`Course`] of this sample period.
    pub fn smoothed(self, period_s: f64) -> Self {
        let part = (1.0 / (2.0 * reach(period_s) as f64 + 1.0)).sqrt();
        Self { pressure: part * self.pressure, flow: part * self.flow }
    }
}

/// A breath without missing rows.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Course {
    /// Number in the recording.
    pub number: u32,
    /// Its test run.
    pub group: Option<u32>,
    pub period_s: f64,
    /// Ticks of the inspiration.
    pub inspiration: usize,
    /// Way from PEEP to the level, cmH2O.
    pub way: f64,
    /// Pressure, cmH2O, and net flow, L/s, as measured.
    pub readings: Vec<[f64; 2]>,
    /// Smoothed pressure, cmH2O, and net flow towards the patient, L/s, tick by tick.
    pub pressure: Vec<f64>,
    pub flow: Vec<f64>,
}

impl Course {
    /// The breath in these rows; `None` if rows or flows are missing, or the flow of one direction was not recorded.
    pub fn new(recording: &Recording, rows: Range<usize>, curve: &BreathCurve, flow: &[f64]) -> Option<Self> {
        let rest = curve.rest.iter().map(|(_, pressure)| *pressure);
        let pressure: Vec<f64> = curve.pressure.iter().copied().chain(rest).collect();
        let even = recording.tick[rows.end - 1] as usize + 1 == rows.len() && pressure.len() == rows.len();
        let flow = &flow[rows.clone()];
        let known = even && flow.iter().all(|flow| flow.is_finite());
        let highest = curve.target.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        let extreme = |sign: f64| flow.iter().map(|flow| sign * flow).fold(0.0, f64::max);
        let both = extreme(-1.0) > ONE_WAY * extreme(1.0);
        (known && both).then(|| Self {
            number: recording.breath[rows.start],
            group: recording.group.as_ref().map(|groups| groups[rows.start]),
            period_s: curve.period_s,
            inspiration: curve.pressure.len(),
            way: highest - curve.peep,
            readings: pressure.iter().zip(flow).map(|(pressure, flow)| [*pressure, *flow]).collect(),
            pressure: averaged(&pressure, reach(curve.period_s)),
            flow: averaged(flow, reach(curve.period_s)),
        })
    }

    /// Number of ticks in this time, at least one.
    pub fn ticks(&self, seconds: f64) -> usize {
        ((seconds / self.period_s).round() as usize).max(1)
    }

    pub fn inspiration_s(&self) -> f64 {
        self.inspiration as f64 * self.period_s
    }

    pub fn expiration_s(&self) -> f64 {
        (self.flow.len() - self.inspiration) as f64 * self.period_s
    }

    /// Net volume that flows in during some ticks, mL.
    pub fn volume_ml(&self, ticks: Range<usize>) -> f64 {
        ML_PER_L * self.flow[ticks].iter().sum::<f64>() * self.period_s
    }

    pub fn inspired_ml(&self) -> f64 {
        self.volume_ml(0..self.inspiration)
    }

    pub fn expired_ml(&self) -> f64 {
        -self.volume_ml(self.inspiration..self.flow.len())
    }
}

/// Net flow towards the patient, L/s, row by row.
pub(super) fn net_flow(recording: &Recording) -> Option<Vec<f64>> {
    let (into, out) = (recording.flow_in.as_deref()?, recording.flow_out.as_deref()?);
    Some(into.iter().zip(out).map(|(into, out)| f64::from(*into) - f64::from(*out)).collect())
}

/// Standard deviation of a flow's noise, L/s.
pub(super) fn noise_of(flow: &[f64]) -> f64 {
    let known: Vec<f32> = flow.iter().filter(|flow| flow.is_finite()).map(|flow| *flow as f32).collect();
    noise(&known)
}

/// Samples on either side over which a value is averaged.
fn reach(period_s: f64) -> usize {
    (0.5 * SMOOTHED_S / period_s).floor() as usize
}
