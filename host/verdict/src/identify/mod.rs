//! Classical identification: the parameters of a recorded lung, by least squares of the equation of motion.
//!
//! ```text
//! P = P0 + V/C + R q + R2 q |q|        q flow into the lung, V its integral
//! ```
//!
//! Each respiratory cycle is fitted separately; the spread from breath to breath gives the confidence intervals of a
//! lung. Two properties of a real ventilator would spoil the fit:
//!
//! * **Drift.** Flow sensors have an offset of a few hundredths of a litre per second, whose integral is more than a
//!   breath of a stiff lung. In a steady breath the inspired volume is expired again, so the mean of the net flow over a
//!   cycle is the sensors' offset and is removed.
//! * **The circuit.** Tubes between the flow sensors and the airway take up gas in proportion to the slope of the
//!   pressure. At a high resistance that is more than the lung gets, and the fit gives too small an R with a negative R2.
//!   The compliance of the circuit is chosen for the smallest residual over all breaths of a lung ([`BehindCircuit`]).
//!
//! What the equation leaves out (a late flow, a leak, too few samples, an odd breath) no interval shows; the remarks of a
//! lung name it.
//!
//! It is a strong baseline for a learned simulator: it uses the measured flow, which a simulator never sees.

pub mod bench;
pub mod cycle;
pub mod open_loop;
mod remarks;
#[cfg(test)]
mod tests;

use std::fmt;
use std::ops::Range;

use serde::{Serialize, Serializer};
use thiserror::Error;

use self::cycle::{COEFFICIENTS, Cycle, Drift, FitSpan};
use data::identity::TestRun;
use data::recording::Recording;
use data::recording::quality::SD_PER_DEVIATION;
use engine::least_squares::{Solution, student};

/// Length of a cycle as a share of its lung's usual one, below which it counts as cut off by a gap.
const LEAST_CYCLE: f64 = 0.9;
/// Distance of a breath's elastance from the median, in standard deviations of the other breaths and as a share, from
/// which on the breath is odd and left out.
const ODD: (f64, f64) = (5.0, 0.1);
/// Compliances of the circuit that are tried, mL/cmH2O: their number and spacing.
const CIRCUITS: (usize, f64) = (81, 0.05);

/// Why identification failed.
#[derive(Debug, Error)]
pub enum IdentifyError {
    /// The recording has no flow, which the equation of motion needs.
    #[error(
        "the recording has no flow (columns flow_in and flow_out): import one with flows, or learn its plant from \
         commands with `trainer fit`"
    )]
    NoFlow,
    /// None of this number of respiratory cycles could be fitted.
    #[error(
        "none of the {0} whole respiratory cycles can be fitted: a cycle needs an inspiration, a changing flow \
         and another breath after it"
    )]
    NoBreath(usize),
}

/// A value with its 95 % confidence interval.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Estimate {
    /// The estimated value.
    pub value: f64,
    /// Lower end of the interval.
    pub low: f64,
    /// Upper end of the interval.
    pub high: f64,
}

/// Identifies a lung within a recording.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct LungId {
    /// The test run, if the recording has any; printed as `all` if not.
    #[serde(rename = "lung", serialize_with = "serialize_run")]
    pub run: Option<TestRun>,
    /// Resistance stated in the recording, cmH2O/(L/s).
    pub nominal_resistance: Option<f64>,
    /// Compliance stated in the recording, mL/cmH2O.
    pub nominal_compliance: Option<f64>,
}

impl LungId {
    /// The lung of a row. Two test runs with the same stated values need not have used the same resistor, so they count
    /// as two lungs; without test runs the stated values distinguish lungs.
    pub(crate) fn of(recording: &Recording, row: usize) -> Self {
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

#[expect(clippy::ref_option, reason = "serde passes the field this way")]
fn serialize_run<S: Serializer>(run: &Option<TestRun>, serializer: S) -> Result<S::Ok, S::Error> {
    serializer.serialize_str(&run_name(run.as_ref()))
}

/// Breaths of one lung that are whole cycles.
#[derive(Debug, Clone, PartialEq)]
pub struct LungCycles {
    /// The lung.
    pub id: LungId,
    /// Number of breaths that are cut off, or that differ from all others.
    pub left_out: usize,
    /// Rows and fitted form of each cycle.
    pub breaths: Vec<(Range<usize>, Cycle)>,
}

/// Identification of one lung.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Identified {
    /// The lung.
    #[serde(flatten)]
    pub id: LungId,
    /// Number of breaths from which the estimates come.
    #[serde(rename = "breaths_used")]
    pub breaths: usize,
    /// Number of breaths that are cut off, differ from all others, or cannot be fitted.
    pub breaths_left_out: usize,
    /// Compliance of circuit and lung, mL/cmH2O.
    pub compliance: Estimate,
    /// R, cmH2O/(L/s).
    pub resistance: Estimate,
    /// R2, cmH2O/(L/s)^2.
    pub turbulence: Estimate,
    /// Offset of the flow sensors, L/s.
    pub offset: Estimate,
    /// Root mean square of the fit's residual, cmH2O.
    pub residual: f64,
    /// Compliance without drift correction, from inspirations only, mL/cmH2O; `None` if their flow hardly changes.
    pub uncorrected_compliance: Option<f64>,
    /// The lung without the circuit.
    pub behind_circuit: BehindCircuit,
    /// Why the estimates deserve less trust than their intervals say; empty if they can be believed.
    pub remarks: Vec<String>,
}

/// The lung with the circuit's share of the flow removed.
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
    /// Root mean square of the fit's residual, cmH2O.
    pub residual: f64,
    /// Root mean square of the flow in the inspirations, L/s: the flow at which R and R2 are valid.
    pub inspiratory_flow: f64,
}

/// Identifies every lung of a recording.
///
/// # Errors
/// The recording has no flow, or none of its lungs has a cycle that can be fitted.
pub fn identify(recording: &Recording) -> Result<Vec<Identified>, IdentifyError> {
    let lungs = lungs(recording)?;
    let found: Vec<_> = lungs.iter().filter_map(|lung| lung.identify(recording)).collect();
    if found.is_empty() {
        return Err(IdentifyError::NoBreath(lungs.iter().map(|lung| lung.breaths.len()).sum()));
    }
    Ok(found)
}

/// The lungs of a recording, in its order.
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
        let cycles = cycles(recording, part);
        let breaths = without_odd(&cycles);
        let left_out = part.len() - 1 - breaths.len();
        lungs.push(LungCycles { id: LungId::of(recording, part[0].start), left_out, breaths });
    }
    Ok(lungs)
}

/// Whole cycles: an inspiration, no missing tick, as long as the others, and another breath after it.
fn cycles(recording: &Recording, breaths: &[Range<usize>]) -> Vec<(Range<usize>, Cycle)> {
    let followed = &breaths[..breaths.len().saturating_sub(1)];
    let usual = median(followed.iter().map(|rows| rows.len() as f64).collect());
    let cycle = |rows: &Range<usize>| {
        let inspiration = recording.inspiration(rows.clone())?.len();
        let whole = recording.tick[rows.end - 1] as usize + 1 == rows.len();
        let long = rows.len() as f64 >= LEAST_CYCLE * usual;
        (whole && long).then(|| Cycle::new(recording, rows, inspiration)).flatten()
    };
    followed.iter().filter_map(|rows| Some((rows.clone(), cycle(rows)?))).collect()
}

/// The cycles without those whose elastance is far from that of all others: a cough, a disconnection, a fault.
fn without_odd(cycles: &[(Range<usize>, Cycle)]) -> Vec<(Range<usize>, Cycle)> {
    let elastance = |cycle: &Cycle| Some(cycle.fit(FitSpan::Cycle, Drift::Corrected, 0.0)?.coefficients[1]);
    let known: Vec<f64> = cycles.iter().filter_map(|(_, cycle)| elastance(cycle)).collect();
    let middle = median(known.clone());
    let spread = SD_PER_DEVIATION * median(known.iter().map(|value| (value - middle).abs()).collect());
    let most = (ODD.0 * spread).max(ODD.1 * middle.abs());
    let odd = |cycle: &Cycle| elastance(cycle).is_some_and(|value| (value - middle).abs() > most);
    cycles.iter().filter(|(_, cycle)| !odd(cycle)).cloned().collect()
}

/// Median, 0 without values.
fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values.get(values.len() / 2).copied().unwrap_or(0.0)
}

impl LungCycles {
    /// Identifies the lung; `None` if no cycle can be fitted.
    pub fn identify(&self, recording: &Recording) -> Option<Identified> {
        let corrected = self.fits(FitSpan::Cycle, Drift::Corrected, 0.0);
        let raw = self.fits(FitSpan::Inspiration, Drift::Kept, 0.0);
        let circuit = self.circuit();
        let behind = self.fits(FitSpan::Cycle, Drift::Corrected, circuit);
        let offsets: Vec<f64> = self.breaths.iter().map(|(_, breath)| breath.offset).collect();
        let flow: f64 = self.breaths.iter().map(|(_, breath)| breath.inspiratory_flow()).sum();
        let mut found = Identified {
            id: self.id.clone(),
            breaths: corrected.len(),
            breaths_left_out: self.left_out + self.breaths.len() - corrected.len(),
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
            remarks: Vec::new(),
        };
        found.remarks = remarks::remarks(self, &found, recording);
        Some(found)
    }

    /// From the first to the last row of its cycles.
    fn rows(&self) -> Range<usize> {
        let (first, last) = (self.breaths.first(), self.breaths.last());
        first.zip(last).map_or(0..0, |((first, _), (last, _))| first.start..last.end)
    }

    /// The fits of its cycles, without those with a negative compliance.
    fn fits(&self, span: FitSpan, drift: Drift, circuit: f64) -> Vec<Solution<COEFFICIENTS>> {
        let fits = self.breaths.iter().filter_map(|(_, breath)| breath.fit(span, drift, circuit));
        fits.filter(|fit| fit.coefficients[1] > 0.0).collect()
    }

    /// Compliance of the circuit with the smallest residual over all cycles, mL/cmH2O.
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

fn residual<const N: usize>(fits: &[Solution<N>]) -> f64 {
    let square: f64 = fits.iter().map(|fit| fit.residual.powi(2)).sum();
    (square / fits.len().max(1) as f64).sqrt()
}

/// The compliance from the mean elastance.
fn compliance<const N: usize>(fits: &[Solution<N>]) -> Option<Estimate> {
    let elastance = coefficient(fits, 1)?;
    let positive = |elastance: f64| if elastance > 0.0 { 1.0 / elastance } else { f64::MAX };
    Some(Estimate { value: 1.0 / elastance.value, low: 1.0 / elastance.high, high: positive(elastance.low) })
}

/// Estimate of a coefficient over breaths; a single breath uses its own interval.
fn coefficient<const N: usize>(fits: &[Solution<N>], index: usize) -> Option<Estimate> {
    let values: Vec<f64> = fits.iter().map(|fit| fit.coefficients[index]).collect();
    estimate(&values, fits.first()?.half_widths[index])
}

/// Mean and 95 % interval from the spread of the values; `single` is the half-width for a single value.
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
