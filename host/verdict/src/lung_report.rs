//! The fields of a pressure-control test report (ISO 80601-2-12, table 201.105, as the open-ventilator community
//! transcribed it; not checked against the standard), for each lung and pair of settings, with the mean figures.

use serde::Serialize;

use super::{Breath, Unjudged};
use crate::identify::LungId;
use shared::breath::ISO_ROWS;

/// The row of the test table with this lung and these settings.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct IsoMatch {
    /// Number of the row.
    pub row: u8,
    /// Rate that the row asks for, breaths per minute.
    pub rate: f64,
    /// Inspiratory time that the row asks for, s.
    pub inspiratory_time_s: f64,
    /// Tidal volume that the row expects, mL.
    pub tidal_volume_ml: f64,
}

/// Mean and worst of a figure over the breaths of which it is known; the worst is the largest in size.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Mean {
    /// Mean.
    pub mean: f64,
    /// Worst.
    pub worst: f64,
    /// Number of breaths.
    pub breaths: usize,
}

/// Breaths of one lung at one pair of settings; pressures in cmH2O.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct LungReport {
    /// The lung.
    #[serde(flatten)]
    pub lung: LungId,
    /// Its name.
    pub name: String,
    /// PIP setting.
    pub pip: f64,
    /// PEEP setting.
    pub peep: f64,
    /// Row of the test table, if one has this lung and these settings.
    pub iso: Option<IsoMatch>,
    /// Number of judged breaths.
    pub breaths: usize,
    /// Number of breaths of this lung, at any settings, that cannot be judged.
    pub unjudged: usize,
    /// Measured PIP: the highest pressure of each inspiration.
    pub measured_pip: Option<Mean>,
    /// Pressure at the end of the inspiration.
    pub end_inspiration: Option<Mean>,
    /// Measured PEEP: the pressure at the end of the expiration.
    pub measured_peep: Option<Mean>,
    /// Measured rate, breaths per minute; assumes that the recorded breaths follow each other without a pause.
    pub rate: Option<Mean>,
    /// Measured inspiratory time, s.
    pub inspiratory_time_s: Option<Mean>,
    /// Tidal volume, mL.
    pub tidal_volume_ml: Option<Mean>,
    /// Peak flow, L/min.
    pub peak_flow_l_min: Option<Mean>,
    /// Mean absolute error over the inspiration.
    pub error: Option<Mean>,
    /// Rise time, ms.
    pub rise_ms: Option<Mean>,
    /// Overshoot.
    pub overshoot: Option<Mean>,
    /// Undershoot in the inspiration.
    pub undershoot: Option<Mean>,
    /// Number of swings.
    pub swings: Option<Mean>,
    /// Largest swing.
    pub swing_size: Option<Mean>,
    /// Frequency of the swings, Hz.
    pub frequency: Option<Mean>,
    /// Plateau error.
    pub plateau_error: Option<Mean>,
    /// Slope of the plateau, cmH2O/s.
    pub slope: Option<Mean>,
    /// Undershoot below PEEP.
    pub below_peep: Option<Mean>,
}

/// One report for each lung and pair of settings, in the order of the recording.
pub(super) fn lung_reports(breaths: &[Breath], unjudged: &[Unjudged]) -> Vec<LungReport> {
    let key = |breath: &Breath| (breath.lung_index, rounded(breath.pip), rounded(breath.peep));
    let mut sorted: Vec<&Breath> = breaths.iter().collect();
    sorted.sort_by_key(|breath| (key(breath), breath.rows.start));
    sorted.chunk_by(|a, b| key(a) == key(b)).map(|chunk| report(chunk, unjudged)).collect()
}

/// A pressure as a number of 0.001 cmH2O: settings that differ by less are the same, as in the test table.
fn rounded(pressure: f64) -> i64 {
    (1e3 * pressure).round() as i64
}

fn report(breaths: &[&Breath], unjudged: &[Unjudged]) -> LungReport {
    let first = breaths[0];
    let name = first.lung_name();
    let mean = |figure: &dyn Fn(&Breath) -> Option<f64>| mean(breaths, figure);
    LungReport {
        lung: first.lung.clone(),
        pip: first.pip,
        peep: first.peep,
        iso: iso(first),
        breaths: breaths.len(),
        unjudged: unjudged.iter().filter(|breath| breath.lung == name).count(),
        name,
        measured_pip: mean(&|breath| Some(breath.figures.peak)),
        end_inspiration: mean(&|breath| breath.figures.end_inspiration),
        measured_peep: mean(&|breath| breath.figures.end_expiration),
        rate: mean(&|breath| Some(60.0 / breath.figures.breath_s?)),
        inspiratory_time_s: mean(&|breath| breath.figures.inspiratory_time_s),
        tidal_volume_ml: mean(&|breath| breath.tidal_volume_ml),
        peak_flow_l_min: mean(&|breath| breath.peak_flow_l_min),
        error: mean(&|breath| breath.figures.error),
        rise_ms: mean(&|breath| breath.figures.rise_ms),
        overshoot: mean(&|breath| Some(breath.figures.overshoot)),
        undershoot: mean(&|breath| breath.figures.undershoot),
        swings: mean(&|breath| Some(breath.figures.swings?.count as f64)),
        swing_size: mean(&|breath| Some(breath.figures.swings?.size)),
        frequency: mean(&|breath| breath.figures.swings?.frequency),
        plateau_error: mean(&|breath| breath.figures.plateau_error),
        slope: mean(&|breath| breath.figures.slope),
        below_peep: mean(&|breath| breath.figures.below_peep),
    }
}

fn mean(breaths: &[&Breath], figure: &dyn Fn(&Breath) -> Option<f64>) -> Option<Mean> {
    let known: Vec<f64> = breaths.iter().filter_map(|breath| figure(breath)).collect();
    let worst = known.iter().copied().reduce(|a, b| if b.abs() > a.abs() { b } else { a })?;
    Some(Mean { mean: known.iter().sum::<f64>() / known.len() as f64, worst, breaths: known.len() })
}

fn iso(breath: &Breath) -> Option<IsoMatch> {
    let (resistance, compliance) = (breath.lung.nominal_resistance?, breath.lung.nominal_compliance?);
    let same = |a: f32, b: f64| (f64::from(a) - b).abs() < 1e-3;
    let row = ISO_ROWS.iter().find(|row| {
        same(row.resistance, resistance)
            && same(row.compliance, compliance)
            && same(row.pip, breath.pip)
            && same(row.peep, breath.peep)
    })?;
    Some(IsoMatch {
        row: row.number,
        rate: f64::from(row.rate),
        inspiratory_time_s: f64::from(row.settings().inspiratory_time),
        tidal_volume_ml: f64::from(row.tidal_volume),
    })
}
