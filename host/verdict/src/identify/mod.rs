//! Classical identification: the parameters of a recorded lung, by least squares of the equation of motion.
//!
//! ```text
//! P = P0 + V/C + R q + R2 q |q|        q flow into the lung, V its integral
//! ```
//!
//! Each respiratory cycle is fitted separately. Properties of a real recording that would spoil the fit are fitted too:
//!
//! * **Drift.** Flow sensors have an offset of a few hundredths of a litre per second, whose integral is more than a
//!   breath of a stiff lung. In a steady breath the inspired volume is expired again, so the mean of the net flow over a
//!   cycle is the sensors' offset and is removed.
//! * **A delay** between flow and pressure, and **a leak** between flow sensor and lung (`flaws`).
//! * **The circuit.** Tubes between the flow sensors and the airway take up gas in proportion to the slope of the
//!   pressure. At a high resistance that is more than the lung gets, and the fit gives too small an R with a negative R2.
//!   The compliance of the circuit is chosen for the smallest residual over all breaths of a lung ([`BehindCircuit`]).
//! * **Odd breaths**, such as a cough or an effort of the patient, are left out ([`LeftOut`]).
//!
//! An interval has the spread of the breaths, what the residuals of all breaths have in common, the change with half of the rows, and the
//! intervals of delay and leak (`estimate`). What else the equation leaves out, no interval shows; the remarks of a lung name it.
//!
//! It is a strong baseline for a learned simulator: it uses the measured flow, which a simulator never sees.

pub mod bench;
pub mod cycle;
mod estimate;
mod flaws;
pub mod open_loop;
mod remarks;
#[cfg(test)]
mod tests;

use std::fmt;
use std::ops::Range;

use serde::{Serialize, Serializer};
use thiserror::Error;

use self::cycle::{COEFFICIENTS, Cycle, Drift, FitSpan, FlowPath};
pub use self::estimate::Estimate;
use self::estimate::{estimate, inverse};
use self::flaws::Flaws;
use crate::series::median;
use data::identity::TestRun;
use data::recording::Recording;
use data::recording::quality::{SD_PER_DEVIATION, noise};
use engine::least_squares::Solution;

/// Length of a cycle as a share of its lung's usual one, below which it counts as cut off by a gap.
const LEAST_CYCLE: f64 = 0.9;
/// Distance from the median from which on a breath is odd and left out: in standard deviations of the breaths, and, if that is more, as a
/// share of the median elastance and of the median residual.
const ODD: (f64, f64, f64) = (5.0, 0.1, 1.0);
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
    /// Breaths that are no whole cycles, or differ from all others.
    pub left_out: Vec<LeftOut>,
    /// Rows and fitted form of each cycle.
    pub breaths: Vec<(Range<usize>, Cycle)>,
}

/// A breath that is not used, and why.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct LeftOut {
    /// Number of the breath in the recording.
    pub breath: u32,
    /// Why, in words.
    pub why: &'static str,
}

/// What one breath says of the lung.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct OneBreath {
    /// Number of the breath in the recording.
    pub breath: u32,
    /// Compliance of circuit and lung, mL/cmH2O.
    pub compliance: f64,
    /// R, cmH2O/(L/s).
    pub resistance: f64,
    /// Root mean square of the fit's residual, cmH2O.
    pub residual: f64,
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
    /// Number of breaths in `left_out`, and of those that cannot be fitted.
    pub breaths_left_out: usize,
    /// Compliance of circuit and lung, mL/cmH2O.
    pub compliance: Estimate,
    /// R, cmH2O/(L/s).
    pub resistance: Estimate,
    /// R2, cmH2O/(L/s)^2.
    pub turbulence: Estimate,
    /// Offset of the flow sensors, L/s.
    pub offset: Estimate,
    /// Leak between the flow sensors and the lung, mL/s per cmH2O.
    pub leak: Estimate,
    /// Delay of the flow against the pressure, ms; negative if the flow is early.
    pub flow_delay_ms: Estimate,
    /// Root mean square of the fit's residual, cmH2O.
    pub residual: f64,
    /// Compliance without drift correction, from inspirations only, mL/cmH2O; `None` if their flow hardly changes.
    pub uncorrected_compliance: Option<f64>,
    /// The lung without the circuit.
    pub behind_circuit: BehindCircuit,
    /// The leak and the delay that are taken out of the flow.
    #[serde(skip)]
    pub taken_out: FlowPath,
    /// The same from each breath by itself.
    pub each_breath: Vec<OneBreath>,
    /// The breaths that are not used.
    pub left_out: Vec<LeftOut>,
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
        let mut lung = LungCycles {
            id: LungId::of(recording, part[0].start),
            left_out: Vec::new(),
            breaths: Vec::new(),
        };
        lung.take(recording, part);
        lung.leave_out_odd(recording);
        lungs.push(lung);
    }
    Ok(lungs)
}

/// The median of values, and how far from it a value may be: `share` of it, or more where all values spread.
fn usual(values: impl Iterator<Item = f64>, share: f64) -> (f64, f64) {
    let values: Vec<f64> = values.collect();
    let middle = median(values.clone());
    let spread = SD_PER_DEVIATION * median(values.iter().map(|value| (value - middle).abs()).collect());
    (middle, (ODD.0 * spread).max(share * middle.abs()))
}

impl LungCycles {
    /// Identifies the lung; `None` if no cycle can be fitted.
    pub fn identify(&self, recording: &Recording) -> Option<Identified> {
        let cycles: Vec<&Cycle> = self.breaths.iter().map(|(_, cycle)| cycle).collect();
        let flaws = Flaws::fit(&cycles, noise(&recording.pressure[self.rows()]))?;
        let ([elastance, resistance, turbulence], fits) = flaws.coefficients(&cycles, 0.0)?;
        let circuit = self.circuit(flaws.taken_out);
        let (behind, behind_fits) = flaws.coefficients(&cycles, circuit)?;
        let offsets: Vec<f64> = cycles.iter().map(|cycle| cycle.offset()).collect();
        let flow: f64 = cycles.iter().map(|cycle| cycle.inspiratory_flow()).sum();
        let mut found = Identified {
            id: self.id.clone(),
            breaths: fits.each.len(),
            breaths_left_out: self.left_out.len() + self.breaths.len() - fits.each.len(),
            compliance: inverse(&elastance),
            resistance,
            turbulence,
            offset: estimate(&offsets, 0.0)?,
            leak: flaws.leak,
            flow_delay_ms: flaws.delay_ms,
            residual: fits.residual(),
            uncorrected_compliance: self.uncorrected_compliance(),
            behind_circuit: BehindCircuit {
                circuit_compliance: circuit,
                compliance: inverse(&behind[0]),
                resistance: behind[1],
                turbulence: behind[2],
                residual: behind_fits.residual(),
                inspiratory_flow: flow / cycles.len() as f64,
            },
            taken_out: flaws.taken_out,
            each_breath: self.each_breath(recording, &flaws.taken_out),
            left_out: self.left_out.clone(),
            remarks: Vec::new(),
        };
        found.remarks = remarks::remarks(self, &found, &flaws, recording);
        Some(found)
    }

    /// Takes the breaths that are whole cycles: an inspiration, no missing tick, as long as the others, and another breath after it.
    fn take(&mut self, recording: &Recording, breaths: &[Range<usize>]) {
        let followed = &breaths[..breaths.len().saturating_sub(1)];
        let usual = median(followed.iter().map(|rows| rows.len() as f64).collect());
        for rows in followed {
            let inspiration = recording.inspiration(rows.clone()).map(|inspiration| inspiration.len());
            let cycle = inspiration.and_then(|inspiration| Cycle::new(recording, rows, inspiration));
            let whole = recording.tick[rows.end - 1] as usize + 1 == rows.len();
            let why = match cycle {
                _ if !whole => "rows are missing",
                None => "no inspiration",
                Some(_) if (rows.len() as f64) < LEAST_CYCLE * usual => "shorter than the others",
                Some(cycle) => {
                    self.breaths.push((rows.clone(), cycle));
                    continue;
                }
            };
            self.left_out.push(LeftOut { breath: recording.breath[rows.start], why });
        }
    }

    /// Leaves out the cycles whose elastance or residual is far from that of all others: a cough, a disconnection, a patient's effort.
    fn leave_out_odd(&mut self, recording: &Recording) {
        let fit = |cycle: &Cycle| cycle.fit(FitSpan::Cycle, Drift::Corrected, &FlowPath::default());
        let fits: Vec<_> = self.breaths.iter().map(|(_, cycle)| fit(cycle)).collect();
        let elastance = usual(fits.iter().flatten().map(|fit| fit.coefficients[1]), ODD.1);
        let residual = usual(fits.iter().flatten().map(|fit| fit.residual), ODD.2);
        let why = |fit: &Solution<COEFFICIENTS>| {
            let off = fit.coefficients[1] - elastance.0;
            if fit.coefficients[1] <= 0.0 && elastance.0 > 0.0 {
                Some("negative compliance")
            } else if off.abs() > elastance.1 {
                Some("compliance unlike the others")
            } else {
                (fit.residual > residual.0 + residual.1).then_some("residual far above the others")
            }
        };
        let mut fits = fits.iter();
        self.breaths.retain(|(rows, _)| {
            let fit = fits.next().and_then(Option::as_ref);
            let Some(why) = fit.map_or(Some("no changing flow"), why) else { return true };
            self.left_out.push(LeftOut { breath: recording.breath[rows.start], why });
            false
        });
        self.left_out.sort_by_key(|left_out| left_out.breath);
    }

    /// From the first to the last row of its cycles.
    fn rows(&self) -> Range<usize> {
        let (first, last) = (self.breaths.first(), self.breaths.last());
        first.zip(last).map_or(0..0, |((first, _), (last, _))| first.start..last.end)
    }

    fn each_breath(&self, recording: &Recording, path: &FlowPath) -> Vec<OneBreath> {
        let one = |(rows, cycle): &(Range<usize>, Cycle)| {
            let fit = cycle.fit(FitSpan::Cycle, Drift::Corrected, path)?;
            let [_, elastance, resistance, _] = fit.coefficients;
            let breath = recording.breath[rows.start];
            Some(OneBreath { breath, compliance: 1.0 / elastance, resistance, residual: fit.residual })
        };
        self.breaths.iter().filter_map(one).collect()
    }

    /// The compliance that the inspirations alone give from the flow as measured, mL/cmH2O; `None` if their flow hardly changes.
    fn uncorrected_compliance(&self) -> Option<f64> {
        let fit = |cycle: &Cycle| cycle.fit(FitSpan::Inspiration, Drift::Kept, &FlowPath::default());
        let elastances = self.breaths.iter().filter_map(|(_, cycle)| Some(fit(cycle)?.coefficients[1]));
        let elastances: Vec<f64> = elastances.filter(|elastance| *elastance > 0.0).collect();
        Some(1.0 / estimate(&elastances, 0.0)?.value)
    }

    /// Compliance of the circuit with the smallest residual over all cycles, mL/cmH2O.
    fn circuit(&self, path: FlowPath) -> f64 {
        let (count, step) = CIRCUITS;
        let fits = |circuit: f64| {
            let fit = |(_, cycle): &(Range<usize>, Cycle)| {
                cycle.fit(FitSpan::Cycle, Drift::Corrected, &FlowPath { circuit, ..path })
            };
            let fits = self.breaths.iter().filter_map(fit).filter(|fit| fit.coefficients[1] > 0.0);
            fits.fold((0, 0.0), |(count, sum), fit| (count + 1, sum + fit.residual.powi(2)))
        };
        let (fitted, _) = fits(0.0);
        let candidates = (0..count).map(|n| n as f64 * step).filter_map(|circuit| {
            let (count, sum) = fits(circuit);
            (count == fitted).then_some((circuit, sum))
        });
        candidates.min_by(|a, b| a.1.total_cmp(&b.1)).map_or(0.0, |best| best.0)
    }
}
