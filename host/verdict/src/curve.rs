//! One breath of a recording as even curves over time, or the reason why it cannot be judged.

use std::ops::Range;

use serde::{Serialize, Serializer};
use thiserror::Error;

use data::recording::{INSPIRATION, Recording};

/// Longest hole in an inspiration that a straight line bridges, s: nothing of note fits into it.
const LONGEST_BRIDGE_S: f64 = 0.02;
/// Largest share of an inspiration's ticks that may be bridged.
const MOST_BRIDGED: f64 = 0.05;
/// Fewest ticks of an inspiration.
const FEWEST_TICKS: usize = 10;
/// Smallest step from PEEP to the target that makes a breath, cmH2O.
pub(super) const SMALLEST_STEP: f64 = 0.5;

/// Why a breath cannot be judged.
#[derive(Debug, Clone, Copy, PartialEq, Error)]
pub enum Refusal {
    /// A value is NaN or infinite.
    #[error("{column} is not a number in row {row} of the breath")]
    NotFinite {
        /// Name of the column.
        column: &'static str,
        /// Row within the breath, from 0.
        row: usize,
    },
    /// No row belongs to an inspiration, or the first ones are missing.
    #[error("the start of the inspiration is missing")]
    Start,
    /// No row follows the inspiration.
    #[error("the recording ends within the inspiration")]
    End,
    /// Rows are missing.
    #[error("{missing} of {ticks} ticks of the inspiration are missing")]
    Holes {
        /// Number of missing ticks.
        missing: usize,
        /// Number of ticks of the inspiration.
        ticks: usize,
    },
    /// The inspiration is too short for its sampling.
    #[error("the inspiration has {0} ticks, at least {FEWEST_TICKS} are needed")]
    TooFew(usize),
    /// The target never rises.
    #[error("the target does not rise above PEEP")]
    NoStep,
}

impl Serialize for Refusal {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_str(self)
    }
}

/// The curves of one breath. The inspiration is even: one value per tick, from tick 0 on.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct BreathCurve {
    /// Time between ticks, s.
    pub period_s: f64,
    /// Settings of the breath, cmH2O.
    pub pip: f64,
    pub peep: f64,
    /// Pressure and target of the inspiration, cmH2O.
    pub pressure: Vec<f64>,
    pub target: Vec<f64>,
    /// Tick and pressure of each later row of the breath.
    pub rest: Vec<(u32, f64)>,
    /// Number of ticks of the inspiration that were missing and are bridged by straight lines.
    pub bridged: usize,
}

impl BreathCurve {
    /// The breath in these rows; `pressure` is the column to judge.
    pub fn new(recording: &Recording, pressure: &[f32], rows: Range<usize>) -> Result<Self, Refusal> {
        check_finite("pressure", &pressure[rows.clone()])?;
        check_finite("target", &recording.target[rows.clone()])?;
        check_finite("PIP", &recording.pip[rows.clone()])?;
        check_finite("PEEP", &recording.peep[rows.clone()])?;
        let phases = &recording.phase[rows.clone()];
        let count = phases.iter().position(|phase| *phase != INSPIRATION).ok_or(Refusal::End)?;
        if count == 0 || recording.tick[rows.start] != 0 {
            return Err(Refusal::Start);
        }
        let period_s = recording.provenance.period_s();
        let first_later = rows.start + count;
        let ticks = &recording.tick[rows.start..first_later];
        let bridged = bridged(ticks, period_s)?;
        let even = |values: &[f32]| even(ticks, &values[rows.start..first_later]);
        let curve = Self {
            period_s,
            pip: f64::from(recording.pip[rows.start]),
            peep: f64::from(recording.peep[rows.start]),
            pressure: even(pressure),
            target: even(&recording.target),
            rest: (first_later..rows.end)
                .map(|row| (recording.tick[row], f64::from(pressure[row])))
                .collect(),
            bridged,
        };
        if curve.pressure.len() < FEWEST_TICKS {
            return Err(Refusal::TooFew(curve.pressure.len()));
        }
        let highest = curve.target.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        if highest < curve.peep + SMALLEST_STEP { Err(Refusal::NoStep) } else { Ok(curve) }
    }

    /// Length of the inspiration, s.
    pub fn inspiration_s(&self) -> f64 {
        self.pressure.len() as f64 * self.period_s
    }

    /// Length of the breath as recorded, s.
    pub fn length_s(&self) -> f64 {
        let ticks = self.rest.last().map_or(self.pressure.len(), |(tick, _)| *tick as usize + 1);
        ticks as f64 * self.period_s
    }
}

fn check_finite(column: &'static str, values: &[f32]) -> Result<(), Refusal> {
    match values.iter().position(|value| !value.is_finite()) {
        Some(row) => Err(Refusal::NotFinite { column, row }),
        None => Ok(()),
    }
}

/// Number of missing ticks, if they can be bridged.
fn bridged(ticks: &[u32], period_s: f64) -> Result<usize, Refusal> {
    let whole = ticks.last().map_or(0, |last| *last as usize + 1);
    let missing = whole.saturating_sub(ticks.len());
    let longest = ticks.windows(2).map(|pair| pair[1].saturating_sub(pair[0]).saturating_sub(1)).max();
    let too_long = f64::from(longest.unwrap_or(0)) * period_s > LONGEST_BRIDGE_S + 1e-9;
    if too_long || missing as f64 > MOST_BRIDGED * whole as f64 {
        return Err(Refusal::Holes { missing, ticks: whole });
    }
    Ok(missing)
}

/// One value per tick; straight lines bridge missing ticks.
fn even(ticks: &[u32], values: &[f32]) -> Vec<f64> {
    let mut curve = Vec::with_capacity(values.len());
    for (tick, value) in ticks.iter().zip(values) {
        let value = f64::from(*value);
        let hole = (*tick as usize).saturating_sub(curve.len());
        if let Some(before) = curve.last().copied() {
            let step = (value - before) / (hole + 1) as f64;
            curve.extend((1..=hole).map(|n| before + step * n as f64));
        }
        curve.push(value);
    }
    curve
}
