//! Sore spots: for each lung and each kind of trouble the worst breath, in words, the most severe first.

use serde::Serialize;

use super::Breath;
use super::accuracy::Tenths;
use super::advice::{Advice, Adviser};
use super::limits::{Kind, Limits};

/// One kind of trouble on one lung.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct SoreSpot {
    /// Value as a share of what is tolerated; above 1.
    pub severity: f64,
    /// The kind of trouble.
    pub kind: Kind,
    /// Name of the lung.
    pub lung: String,
    /// Number of the worst breath in the recording.
    pub breath: u32,
    /// Time of it, s after the start of the breath.
    pub at_s: f64,
    /// Its value, in the kind's unit.
    pub value: f64,
    /// Number of breaths of this lung with the same trouble.
    pub breaths: usize,
    /// Number of judged breaths of this lung.
    pub of: usize,
    /// What is wrong.
    pub what: String,
    /// What is wrong, and where.
    pub text: String,
    /// Its likely cause, if the figures show one.
    pub advice: Option<Advice>,
    /// Index of the worst breath among the judged ones.
    #[serde(skip)]
    pub worst: usize,
}

/// Finds the sore spots of all breaths.
pub(super) fn sore_spots(limits: &Limits, breaths: &[Breath], adviser: &Adviser<'_>) -> Vec<SoreSpot> {
    let mut spots = Vec::new();
    let mut order: Vec<usize> = (0..breaths.len()).collect();
    order.sort_by_key(|index| (breaths[*index].lung_index, *index));
    for lung in order.chunk_by(|a, b| breaths[*a].lung_index == breaths[*b].lung_index) {
        let all: Vec<&Breath> = lung.iter().map(|index| &breaths[*index]).collect();
        let advised = |spot: SoreSpot| {
            let advice = adviser.advice(spot.kind, &breaths[spot.worst], &all);
            SoreSpot { advice, ..spot }
        };
        spots.extend(
            Kind::ALL.into_iter().filter_map(|kind| sore_spot(kind, limits, breaths, lung).map(advised)),
        );
    }
    // A stable sort: equal severities stay in the order of the recording.
    spots.sort_by(|a, b| b.severity.total_cmp(&a.severity));
    spots
}

/// The worst of the breaths with these indices, if it is beyond what is tolerated.
fn sore_spot(kind: Kind, limits: &Limits, breaths: &[Breath], lung: &[usize]) -> Option<SoreSpot> {
    let sore = lung.iter().filter_map(|index| {
        let breath = &breaths[*index];
        let finding = kind.finding(breath)?;
        let severity = finding.severity(limits.allowed(kind, breath)?);
        (severity > 1.0).then_some((severity, *index, finding))
    });
    let sore: Vec<_> = sore.collect();
    let worst = sore.iter().fold(sore.first()?, |worst, next| if next.0 > worst.0 { next } else { worst });
    let (severity, index, finding) = *worst;
    let breath = &breaths[index];
    let others = match sore.len() {
        1 => format!("the only one of {} breaths", lung.len()),
        count => format!("{count} of {} breaths", lung.len()),
    };
    let (lung_name, what) = (breath.lung_name(), words(kind, breath, finding.at_s));
    Some(SoreSpot {
        severity,
        kind,
        breath: breath.number,
        at_s: finding.at_s,
        value: finding.value,
        breaths: sore.len(),
        of: lung.len(),
        text: format!("{lung_name}, breath {}: {what} ({others})", breath.number),
        lung: lung_name,
        what,
        advice: None,
        worst: index,
    })
}

/// What is wrong with a breath, and when.
fn words(kind: Kind, breath: &Breath, at_s: f64) -> String {
    let figures = &breath.figures;
    let (level, peep) = (Tenths(figures.level), Tenths(breath.peep));
    let known = |value: Option<f64>| value.unwrap_or_default();
    match kind {
        Kind::Error => format!("mean error of {:.2} cmH2O over the inspiration", known(figures.error)),
        Kind::Rise if !figures.reached => {
            format!("does not get to 90 % of the way to {level} cmH2O in {:.2} s", figures.inspiration_s)
        }
        Kind::Rise => format!("slow rise, {:.0} ms to {level} cmH2O", known(figures.rise_ms)),
        Kind::Overshoot => {
            format!(
                "overshoot of {:.1} cmH2O above {level} cmH2O, {at_s:.2} s after the start",
                figures.overshoot
            )
        }
        Kind::Undershoot => format!(
            "falls {:.1} cmH2O below {level} cmH2O after its first peak, {at_s:.2} s after the start",
            known(figures.undershoot)
        ),
        Kind::Oscillation => figures.swings.map_or_else(String::new, |swings| {
            let hertz = swings.frequency.map_or_else(String::new, |hertz| format!(", {hertz:.1} Hz"));
            format!("oscillates: {} swings of up to {:.1} cmH2O{hertz}", swings.count, swings.size)
        }),
        Kind::Plateau => {
            let (bias, error) = (known(figures.plateau_bias), known(figures.plateau_error));
            let side = match bias {
                bias if bias > 0.9 * error => "above",
                bias if bias < -0.9 * error => "below",
                _ => "around",
            };
            format!("plateau {error:.1} cmH2O {side} {level} cmH2O")
        }
        Kind::Slope => {
            let slope = known(figures.slope);
            format!("plateau {} by {:.1} cmH2O/s", if slope > 0.0 { "rises" } else { "falls" }, slope.abs())
        }
        Kind::Baseline => {
            let above = known(figures.end_expiration) - breath.peep;
            let side = if above > 0.0 { "above" } else { "below" };
            format!("ends the expiration {:.1} cmH2O {side} PEEP {peep} cmH2O", above.abs())
        }
        Kind::BelowPeep => format!(
            "falls {:.1} cmH2O below PEEP {peep} cmH2O, {at_s:.2} s after the start",
            known(figures.below_peep)
        ),
        Kind::CutShort => {
            format!(
                "inspiration ends after {:.2} s, {:.0} % too early",
                figures.inspiration_s,
                100.0 * figures.cut
            )
        }
    }
}
