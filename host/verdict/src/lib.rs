//! A verdict on a recording, breath by breath and lung by lung: how well the pressure follows its target.
//!
//! The recording may come from any ventilator. Its targets may ramp, end below PIP or be missing; ticks, flows and the
//! true pressure may be missing; breaths may be cut short or end with the recording. Each of these has an answer: a
//! figure that cannot be known is absent with a remark, and a breath that cannot be judged is listed with the reason.
//!
//! [`judge`] gives the figures of each breath ([`Figures`]), the fields of a test report for each lung and pair of
//! settings ([`LungReport`]), the accuracy as manufacturers declare it ([`PhaseAccuracy`]), the result of declared limits
//! ([`LimitResult`]) and the *sore spots*, the worst breath of each kind of trouble in words ([`SoreSpot`]).
#![forbid(unsafe_code)]

mod accuracy;
mod advice;
mod asynchrony;
mod breath;
mod curve;
mod figures;
pub mod fit_summary;
pub mod identify;
mod limits;
mod lung_report;
mod ramp;
pub mod response;
mod series;
mod settled;
mod sore_spots;
mod swings;
#[cfg(test)]
mod tests;

use std::collections::{BTreeSet, HashMap};
use std::hash::Hash;
use std::ops::Range;

use serde::Serialize;
use thiserror::Error;

pub use self::accuracy::{Band, NoBand, PhaseAccuracy, USUAL, tightest};
use self::advice::Adviser;
pub use self::advice::{Advice, Cause};
pub use self::asynchrony::{Asynchronies, Asynchrony, AsynchronyCount};
use self::breath::lung_name;
pub use self::breath::{Breath, Unjudged};
use self::curve::BreathCurve;
pub use self::curve::Refusal;
use self::figures::Context;
pub use self::figures::Figures;
pub use self::limits::{Kind, LimitResult, Limits, Violation};
pub use self::lung_report::{IsoMatch, LungReport, Mean};
use self::series::median;
use self::settled::Settled;
pub use self::sore_spots::SoreSpot;
pub use self::swings::Swings;
use crate::identify::LungId;
use crate::identify::cycle::{Cycle, Drift, FlowPath};
use data::import::{NO_SET_POINT, had_set_point};
use data::recording::Recording;
use data::recording::quality::noise;

/// Length of a breath as a share of the one usual around it, below which its end counts as missing.
const WHOLE: f64 = 0.9;
/// Number of breaths before and after one that show what is usual.
const AROUND: usize = 2;
/// Litres per second in litres per minute.
const L_PER_MIN: f64 = 60.0;

/// Why a recording gives no verdict.
#[derive(Debug, Clone, PartialEq, Error)]
pub enum VerdictError {
    /// The sample period is 0.
    #[error("the recording has no sample period")]
    NoPeriod,
    /// There is no breath.
    #[error("the recording contains no breath")]
    NoBreath,
    /// No breath could be judged.
    #[error("none of {breaths} breaths can be judged; the first one: {reason}")]
    NoneJudged {
        /// Number of breaths.
        breaths: usize,
        /// Why the first one cannot.
        reason: Refusal,
    },
    /// A declared limit concerns a figure that no breath has.
    #[error("the limit on the {what} cannot be checked on any breath: {reason}")]
    Unknown {
        /// What is limited.
        what: &'static str,
        /// Why it is unknown.
        reason: String,
    },
}

/// Which pressure is judged.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Judged {
    /// The true airway pressure, which a bench records.
    True,
    /// The pressure that the sensor measured.
    Measured,
}

/// Where the target that the pressure is compared with comes from.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Target {
    /// The recording has set-points.
    AsSet,
    /// It is the plateau of each breath's pressure. Errors and accuracy are unknown, overshoot and undershoot refer to that
    /// plateau, and the rise is as slow as the ventilator makes it: what it was asked to do is unknown.
    Inferred,
}

/// The verdict on a recording.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Verdict {
    /// Name of the recorded plant.
    pub plant: String,
    /// Sample period, us.
    pub period_us: u32,
    /// Which pressure is judged.
    pub judged: Judged,
    /// Standard deviation of its noise, cmH2O.
    pub noise: f64,
    /// Where the target comes from.
    pub target: Target,
    /// Share of the inspiratory ticks with a random perturbation, 0 to 1: those breaths do not show the controller alone.
    pub explored: f64,
    /// Accuracy at the end of the inspiration, in relation to the target there.
    pub accuracy_inspiration: Option<PhaseAccuracy>,
    /// Accuracy at the end of the expiration, in relation to PEEP.
    pub accuracy_expiration: Option<PhaseAccuracy>,
    /// Report of each lung and pair of settings.
    pub lungs: Vec<LungReport>,
    /// Sore spots, the most severe first.
    pub sore_spots: Vec<SoreSpot>,
    /// Results of the declared limits.
    pub limits: Vec<LimitResult>,
    /// Asynchronies between patient and ventilator; `None` without flow.
    pub asynchronies: Option<Asynchronies>,
    /// All judged breaths, in the order of the recording.
    pub breaths: Vec<Breath>,
    /// The breaths that cannot be judged.
    pub unjudged: Vec<Unjudged>,
}

impl Verdict {
    /// Number of breaths that violate a declared limit.
    pub fn violating_breaths(&self) -> usize {
        let breaths =
            self.limits.iter().flat_map(|limit| &limit.violations).map(|violation| violation.breath);
        breaths.collect::<BTreeSet<_>>().len()
    }

    /// Results of the tolerances that the sore spots have without declared limits, as far as a breath has the figure.
    pub fn tolerated(&self) -> Vec<LimitResult> {
        let mut results = limits::tolerated(&self.breaths);
        results.retain(|result| result.checked > 0);
        results
    }
}

/// Judges a recording: the true pressure if it is recorded and `judged` allows it, else the measured one.
///
/// # Errors
/// No sample period, no breath, none that can be judged, or a declared limit on a figure that no breath has.
pub fn judge(recording: &Recording, judged: Judged, limits: &Limits) -> Result<Verdict, VerdictError> {
    if recording.provenance.period_us == 0 {
        return Err(VerdictError::NoPeriod);
    }
    let (judged, pressure) = match (judged, &recording.pressure_true) {
        (Judged::True, Some(pressure)) => (Judged::True, pressure),
        _ => (Judged::Measured, &recording.pressure),
    };
    let readings: Vec<f32> = pressure.iter().copied().filter(|p| p.is_finite()).collect();
    let context = RecordingContext {
        recording,
        pressure,
        set_point: had_set_point(&recording.provenance),
        noise: noise(&readings),
    };
    let (breaths, unjudged) = context.breaths()?;
    let results = limits::check(limits, &breaths);
    if let Some(limit) = results.iter().find(|limit| limit.checked == 0) {
        let remark = breaths[0].figures.remarks.first().cloned();
        let reason = if context.set_point { remark } else { Some(NO_SET_POINT.to_owned()) };
        let reason = reason.unwrap_or_else(|| "no breath has this figure".to_owned());
        return Err(VerdictError::Unknown { what: limit.kind.name(), reason });
    }
    let errors = |error: fn(&Breath) -> Option<(f64, f64)>| {
        let known = breaths.iter().filter(|breath| breath.set_point).filter_map(error);
        accuracy::accuracy(&known.collect::<Vec<_>>())
    };
    Ok(Verdict {
        plant: recording.provenance.plant.clone(),
        period_us: recording.provenance.period_us,
        judged,
        noise: context.noise,
        target: if context.set_point { Target::AsSet } else { Target::Inferred },
        explored: recording.explored(),
        accuracy_inspiration: errors(|breath| {
            let level = breath.figures.level;
            Some((level, (breath.figures.end_inspiration? - level).abs()))
        }),
        accuracy_expiration: errors(|breath| {
            Some((breath.peep, (breath.figures.end_expiration? - breath.peep).abs()))
        }),
        lungs: lung_report::lung_reports(&breaths, &unjudged),
        sore_spots: sore_spots::sore_spots(
            limits,
            &breaths,
            &Adviser { recording, pressure, noise: context.noise },
        ),
        limits: results,
        asynchronies: context.asynchronies(),
        breaths,
        unjudged,
    })
}

/// A recording and what is known of it as a whole.
struct RecordingContext<'a> {
    recording: &'a Recording,
    /// The judged pressure.
    pressure: &'a [f32],
    set_point: bool,
    noise: f64,
}

/// What makes two breaths comparable: group, R and C. Bits, because NaN is possible.
type LungKey = [u32; 3];

impl RecordingContext<'_> {
    /// Judges each breath.
    fn breaths(&self) -> Result<(Vec<Breath>, Vec<Unjudged>), VerdictError> {
        let all = self.recording.breaths();
        let curves: Vec<_> =
            all.iter().map(|rows| BreathCurve::new(self.recording, self.pressure, rows.clone())).collect();
        let sound = || all.iter().zip(&curves).filter_map(|(rows, curve)| Some((rows, curve.as_ref().ok()?)));
        let lengths = usual(sound().map(|(rows, curve)| (rows.start, self.lung_key(rows), curve.length_s())));
        let settled = |level: fn(&BreathCurve) -> f64| {
            if self.set_point { Settled::exact() } else { Settled::measured(sound().map(|(_, c)| level(c))) }
        };
        let (pips, peeps) = (settled(|curve| curve.pip), settled(|curve| curve.peep));
        let settings = |curve: &BreathCurve| (pips.setting(curve.pip), peeps.setting(curve.peep));
        let key = |rows: &Range<usize>, curve: &BreathCurve| {
            let (pip, peep) = settings(curve);
            (self.lung_key(rows), pip.to_bits(), peep.to_bits())
        };
        let inspirations =
            usual(sound().map(|(rows, curve)| (rows.start, key(rows, curve), curve.inspiration_s())));
        let mut lungs: HashMap<LungKey, usize> = HashMap::new();
        let (mut breaths, mut unjudged) = (Vec::new(), Vec::new());
        for (rows, curve) in all.iter().zip(&curves) {
            let (number, lung) = (self.recording.breath[rows.start], LungId::of(self.recording, rows.start));
            let curve = match curve {
                Ok(curve) => curve,
                Err(reason) => {
                    unjudged.push(Unjudged { breath: number, lung: lung_name(&lung), reason: *reason });
                    continue;
                }
            };
            let (usual_length, count) = lengths[&rows.start];
            let context = Context {
                set_point: self.set_point,
                noise: self.noise,
                usual_inspiration_s: inspirations[&rows.start].0,
                whole: count > 1 && curve.length_s() >= WHOLE * usual_length,
            };
            let next = lungs.len();
            let flow = context.whole.then(|| self.flow(rows, curve)).flatten();
            let (pip, peep) = settings(curve);
            breaths.push(Breath {
                number,
                lung,
                pip,
                peep,
                figures: Figures::new(curve, &context),
                tidal_volume_ml: flow.map(|flow| flow.0),
                peak_flow_l_min: flow.map(|flow| flow.1),
                rows: rows.clone(),
                set_point: self.set_point,
                lung_index: *lungs.entry(self.lung_key(rows)).or_insert(next),
            });
        }
        match (breaths.first(), unjudged.first()) {
            (None, None) => Err(VerdictError::NoBreath),
            (None, Some(first)) => Err(VerdictError::NoneJudged { breaths: all.len(), reason: first.reason }),
            _ => Ok((breaths, unjudged)),
        }
    }

    /// The asynchronies of all breaths that have curves.
    fn asynchronies(&self) -> Option<Asynchronies> {
        let all = self.recording.breaths();
        let curves: Vec<_> = all
            .iter()
            .map(|rows| BreathCurve::new(self.recording, self.pressure, rows.clone()).ok())
            .collect();
        let breaths = all.iter().cloned().zip(curves.iter().map(Option::as_ref));
        asynchrony::asynchronies(self.recording, breaths, self.noise)
    }

    fn lung_key(&self, rows: &Range<usize>) -> LungKey {
        let bits =
            |column: &Option<Vec<f32>>| column.as_ref().map_or(0, |values| values[rows.start].to_bits());
        let group = self.recording.group.as_ref().map_or(0, |groups| groups[rows.start]);
        [group, bits(&self.recording.resistance), bits(&self.recording.compliance)]
    }

    /// Tidal volume, mL, and highest flow, L/min, of a whole breath; `None` without flows or with missing rows.
    fn flow(&self, rows: &Range<usize>, curve: &BreathCurve) -> Option<(f64, f64)> {
        let even = self.recording.tick[rows.end - 1] as usize + 1 == rows.len();
        let cycle = even.then(|| Cycle::new(self.recording, rows, curve.pressure.len())).flatten()?;
        let flows = cycle.rows(Drift::Corrected, &FlowPath::default());
        let volume = flows.iter().map(|row| row[1]).reduce(f64::max)?;
        let flow = flows[..curve.pressure.len()].iter().map(|row| row[2]).reduce(f64::max)?;
        (volume.is_finite() && flow.is_finite()).then_some((volume, L_PER_MIN * flow))
    }
}

/// What is usual around each value, by its place: the median of the values of its key among the [`AROUND`] before and after it, and
/// the number of values of its key. A run of other values, as after a change of the rate, is soon usual itself.
fn usual<K: Eq + Hash>(values: impl Iterator<Item = (usize, K, f64)>) -> HashMap<usize, (f64, usize)> {
    let mut by_key: HashMap<K, Vec<(usize, f64)>> = HashMap::new();
    for (place, key, value) in values {
        by_key.entry(key).or_default().push((place, value));
    }
    let around = |values: &[(usize, f64)], n: usize| {
        let near = &values[n.saturating_sub(AROUND)..values.len().min(n + AROUND + 1)];
        median(near.iter().map(|(_, value)| *value).collect())
    };
    let of_key = |values: &Vec<(usize, f64)>| -> Vec<(usize, (f64, usize))> {
        (0..values.len()).map(|n| (values[n].0, (around(values, n), values.len()))).collect()
    };
    by_key.values().flat_map(of_key).collect()
}
