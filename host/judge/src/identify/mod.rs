//! Classical identification: what the lung of a recording is, by least squares of the equation of motion.
//!
//! ```text
//! P = P0 + V/C + R q + R2 q |q|        q flow into the lung, V its integral
//! ```
//!
//! Each respiratory cycle is fitted by itself; the spread from breath to breath gives the confidence intervals of a
//! lung. Two things of a real ventilator would spoil the fit:
//!
//! * **Drift.** Flow sensors show a few hundredths of a litre per second too much, and the integral of that is more
//!   than a breath of a stiff lung. What went in comes out again in a steady breath, so the mean of the net flow over a
//!   cycle is the sensors' and is taken out.
//! * **The circuit.** Tubes between the flow sensors and the airway take gas in proportion to the slope of the
//!   pressure. At a high resistance that is more than the lung gets, and R comes out too small with a negative R2. The
//!   compliance of the circuit is the one with the least residual over all breaths of a lung ([`BehindCircuit`]).
//!
//! This is the honest rival of a learned simulator; it is told the measured flow, which a simulator is not.

pub mod bench;
pub mod cycle;
pub mod open_loop;
#[cfg(test)]
mod tests;

use std::fmt;
use std::ops::Range;

use serde::{Serialize, Serializer};
use thiserror::Error;

use self::cycle::{COEFFICIENTS, Cycle, Drift, FitSpan};
use data::identity::TestRun;
use data::recording::Recording;
use engine::least_squares::{Solution, student};

/// A cycle counts if it is at least this share of its lung's longest: a shorter one was cut off by a gap.
const LEAST_CYCLE: f64 = 0.9;
/// Compliances of the circuit that are tried, mL/cmH2O: this many, this far apart.
const CIRCUITS: (usize, f64) = (81, 0.05);

/// Why nothing can be identified.
#[derive(Debug, Error)]
pub enum IdentifyError {
    /// The equation of motion needs the flow.
    #[error(
        "the recording has no flow (columns flow_in and flow_out): import one that has, or learn its plant from \
         commands with `trainer fit`"
    )]
    NoFlow,
    /// No respiratory cycle of so many says anything.
    #[error(
        "none of {0} whole respiratory cycles can be fitted: a cycle needs an inspiration, flow that changes, \
         and another breath behind it"
    )]
    NoBreath(usize),
}

/// A value with its 95 % confidence interval.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Estimate {
    /// Best value.
    pub value: f64,
    /// Lower end.
    pub low: f64,
    /// Upper end.
    pub high: f64,
}

/// Which lung of a recording it is.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct LungId {
    /// Its test run, if the recording has any. Printed as `all` if not.
    #[serde(rename = "lung", serialize_with = "serialize_run")]
    pub run: Option<TestRun>,
    /// Resistance that the recording claims, cmH2O/(L/s).
    pub nominal_resistance: Option<f64>,
    /// Compliance that the recording claims, mL/cmH2O.
    pub nominal_compliance: Option<f64>,
}

impl LungId {
    /// The lung of a row. Two test runs with the same claims need not have had the same resistor, so they are two lungs;
    /// without test runs the claims tell lungs apart.
    fn of(recording: &Recording, row: usize) -> Self {
        let number = |column: &Option<Vec<f32>>| column.as_ref().map(|values| f64::from(values[row]));
        Self {
            run: recording.test_run(row).cloned(),
            nominal_resistance: number(&recording.resistance),
            nominal_compliance: number(&recording.compliance),
        }
    }
}

impl fmt::Display for LungId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&run_name(self.run.as_ref()))
    }
}

fn run_name(run: Option<&TestRun>) -> String {
    run.map_or_else(|| "all".to_owned(), TestRun::to_string)
}

#[expect(clippy::ref_option, reason = "serde hands the field over like this")]
fn serialize_run<S: Serializer>(run: &Option<TestRun>, serializer: S) -> Result<S::Ok, S::Error> {
    serializer.serialize_str(&run_name(run.as_ref()))
}

/// Breaths of one lung that are whole cycles.
#[derive(Debug, Clone, PartialEq)]
pub struct LungCycles {
    /// Which one.
    pub id: LungId,
    /// Rows and fitted form of each cycle.
    pub breaths: Vec<(Range<usize>, Cycle)>,
}

/// What was found of one lung.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Identified {
    /// Which one.
    #[serde(flatten)]
    pub id: LungId,
    /// Cycles that were fitted.
    pub breaths: usize,
    /// Whole cycles that could not be fitted.
    pub refused: usize,
    /// Compliance of circuit and lung, mL/cmH2O.
    pub compliance: Estimate,
    /// R, cmH2O/(L/s).
    pub resistance: Estimate,
    /// R2, cmH2O/(L/s)^2.
    pub turbulence: Estimate,
    /// What the flow sensors show too much, L/s.
    pub offset: Estimate,
    /// Root mean square of what the equation does not explain, cmH2O.
    pub residual: f64,
    /// Compliance without the correction of drift, from inspirations alone, mL/cmH2O; none where their flow hardly changes.
    pub uncorrected_compliance: Option<f64>,
    /// The lung without the circuit.
    pub behind_circuit: BehindCircuit,
}

/// The lung with the circuit's share of the flow taken out.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct BehindCircuit {
    /// Compliance of the circuit, mL/cmH2O.
    pub circuit_compliance: f64,
    /// Compliance of the lung, mL/cmH2O.
    pub compliance: Estimate,
    /// R, cmH2O/(L/s).
    pub resistance: Estimate,
    /// R2, cmH2O/(L/s)^2.
    pub turbulence: Estimate,
    /// Root mean square of what the equation does not explain, cmH2O.
    pub residual: f64,
    /// Root mean square of the flow in the inspirations, L/s: where R and R2 hold.
    pub inspiratory_flow: f64,
}

/// Identifies every lung of a recording.
///
/// # Errors
/// The recording has no flow, or no lung of it has a cycle that can be fitted.
pub fn identify(recording: &Recording) -> Result<Vec<Identified>, IdentifyError> {
    let lungs = lungs(recording)?;
    let found: Vec<_> = lungs.iter().filter_map(LungCycles::identify).collect();
    if found.is_empty() {
        return Err(IdentifyError::NoBreath(lungs.iter().map(|lung| lung.breaths.len()).sum()));
    }
    Ok(found)
}

/// The lungs of a recording in its order.
///
/// # Errors
/// The recording has no flow.
pub fn lungs(recording: &Recording) -> Result<Vec<LungCycles>, IdentifyError> {
    if recording.flow_in.is_none() || recording.flow_out.is_none() {
        return Err(IdentifyError::NoFlow);
    }
    let mut lungs: Vec<LungCycles> = Vec::new();
    let breaths = recording.breaths();
    for part in breaths.chunk_by(|a, b| LungId::of(recording, a.start) == LungId::of(recording, b.start)) {
        lungs.push(LungCycles { id: LungId::of(recording, part[0].start), breaths: cycles(recording, part) });
    }
    Ok(lungs)
}

/// Whole cycles: an inspiration, no missing tick, as long as the others, and another breath behind it.
fn cycles(recording: &Recording, breaths: &[Range<usize>]) -> Vec<(Range<usize>, Cycle)> {
    let followed = &breaths[..breaths.len().saturating_sub(1)];
    let longest = followed.iter().map(ExactSizeIterator::len).max().unwrap_or(0) as f64;
    let cycle = |rows: &Range<usize>| {
        let inspiration = recording.inspiration(rows.clone())?.len();
        let whole = recording.tick[rows.end - 1] as usize + 1 == rows.len();
        let long = rows.len() as f64 >= LEAST_CYCLE * longest;
        (whole && long).then(|| Cycle::new(recording, rows, inspiration)).flatten()
    };
    followed.iter().filter_map(|rows| Some((rows.clone(), cycle(rows)?))).collect()
}

impl LungCycles {
    /// What the lung is; none if no cycle can be fitted.
    pub fn identify(&self) -> Option<Identified> {
        let corrected = self.fits(FitSpan::Cycle, Drift::Corrected, 0.0);
        let raw = self.fits(FitSpan::Inspiration, Drift::Kept, 0.0);
        let circuit = self.circuit();
        let behind = self.fits(FitSpan::Cycle, Drift::Corrected, circuit);
        let offsets: Vec<f64> = self.breaths.iter().map(|(_, breath)| breath.offset).collect();
        let flow: f64 = self.breaths.iter().map(|(_, breath)| breath.inspiratory_flow()).sum();
        Some(Identified {
            id: self.id.clone(),
            breaths: corrected.len(),
            refused: self.breaths.len() - corrected.len(),
            compliance: compliance(&corrected)?,
            resistance: coefficient(&corrected, 2)?,
            turbulence: coefficient(&corrected, 3)?,
            offset: estimate(&offsets, 0.0)?,
            residual: residual(&corrected),
            uncorrected_compliance: compliance(&raw).map(|raw| raw.value),
            behind_circuit: BehindCircuit {
                circuit_compliance: circuit,
                compliance: compliance(&behind)?,
                resistance: coefficient(&behind, 2)?,
                turbulence: coefficient(&behind, 3)?,
                residual: residual(&behind),
                inspiratory_flow: flow / self.breaths.len() as f64,
            },
        })
    }

    /// The fits of its cycles; those with a compliance below zero say nothing.
    fn fits(&self, span: FitSpan, drift: Drift, circuit: f64) -> Vec<Solution<COEFFICIENTS>> {
        let fits = self.breaths.iter().filter_map(|(_, breath)| breath.fit(span, drift, circuit));
        fits.filter(|fit| fit.coefficients[1] > 0.0).collect()
    }

    /// Compliance of the circuit with the least residual over all cycles, mL/cmH2O.
    fn circuit(&self) -> f64 {
        let (count, step) = CIRCUITS;
        let fitted = self.fits(FitSpan::Cycle, Drift::Corrected, 0.0).len();
        let candidates = (0..count).map(|n| n as f64 * step).filter_map(|circuit| {
            let fits = self.fits(FitSpan::Cycle, Drift::Corrected, circuit);
            let sum: f64 = fits.iter().map(|fit| fit.residual.powi(2)).sum();
            (fits.len() == fitted).then_some((circuit, sum))
        });
        candidates.min_by(|a, b| a.1.total_cmp(&b.1)).map_or(0.0, |best| best.0)
    }
}

fn residual(fits: &[Solution<COEFFICIENTS>]) -> f64 {
    let square: f64 = fits.iter().map(|fit| fit.residual.powi(2)).sum();
    (square / fits.len().max(1) as f64).sqrt()
}

/// The compliance from the mean elastance.
fn compliance(fits: &[Solution<COEFFICIENTS>]) -> Option<Estimate> {
    let elastance = coefficient(fits, 1)?;
    let positive = |elastance: f64| if elastance > 0.0 { 1.0 / elastance } else { f64::MAX };
    Some(Estimate { value: 1.0 / elastance.value, low: 1.0 / elastance.high, high: positive(elastance.low) })
}

/// A coefficient over breaths; a single breath has its own interval.
fn coefficient(fits: &[Solution<COEFFICIENTS>], index: usize) -> Option<Estimate> {
    let values: Vec<f64> = fits.iter().map(|fit| fit.coefficients[index]).collect();
    estimate(&values, fits.first()?.half_widths[index])
}

/// Mean and 95 % interval from the spread of the values; `single` is the half-width where there is but one.
fn estimate(values: &[f64], single: f64) -> Option<Estimate> {
    let count = values.len() as f64;
    if values.is_empty() {
        return None;
    }
    let value = values.iter().sum::<f64>() / count;
    let half = if values.len() == 1 {
        single
    } else {
        let variance = values.iter().map(|v| (v - value).powi(2)).sum::<f64>() / (count - 1.0);
        student(values.len() - 1) * (variance / count).sqrt()
    };
    Some(Estimate { value, low: value - half, high: value + half })
}
