//! Asynchronies between patient and ventilator, breath by breath, from pressure and flow.
//!
//! The definitions are those of Thille et al. (Intensive Care Med 2006;32:1515), the sizes of a missed effort those of
//! Chen et al. (Crit Care Med 2008;36:455). A ventilator's clock makes breaths as well, so a breath counts as early only
//! among later ones before and after it: a change of the rate is none, and neither is a short expiration that is set.
//! Everything is meant to be silent on a passive lung. What noise or a rule may hide stays unnamed.

mod course;
mod effort;
mod muscles;

use std::ops::Range;

use serde::Serialize;

use self::course::{Course, Noise};
use crate::curve::BreathCurve;
use data::recording::Recording;

/// Longest expiration before a double trigger, as a share of the mean inspiration (Thille 2006).
const DOUBLE: f64 = 0.5;
/// Largest share of the inspired volume that is expired before a breath that stacks on the rest. It is a double trigger after
/// any expiration that is shorter than the mean inspiration.
const STACKED: f64 = 0.5;
/// An expiration before a double trigger, and before an early breath, as a share of one before and of one after it.
const SHORT: f64 = 0.5;
const EARLY: f64 = 0.75;
/// Number of expirations before and after one that it is compared with.
const AROUND: usize = 2;

/// A kind of asynchrony.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Asynchrony {
    /// The breath follows the one before it before that could be expired.
    DoubleTrigger,
    /// An effort in the expiration, which no breath follows.
    MissedEffort,
    /// The patient exhales, but the inspiration goes on.
    DelayedCycling,
    /// An early breath without an effort.
    AutoTrigger,
}

impl Asynchrony {
    /// Every kind.
    pub const ALL: [Self; 4] =
        [Self::DoubleTrigger, Self::MissedEffort, Self::DelayedCycling, Self::AutoTrigger];

    /// Name in reports.
    pub const fn name(self) -> &'static str {
        match self {
            Self::DoubleTrigger => "double trigger",
            Self::MissedEffort => "missed effort",
            Self::DelayedCycling => "delayed cycling",
            Self::AutoTrigger => "auto-trigger",
        }
    }
}

/// Asynchronies of one kind.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct AsynchronyCount {
    /// The kind.
    pub kind: Asynchrony,
    /// Number of events; a breath can have several missed efforts.
    pub events: usize,
    /// The same per checked breath.
    pub share: f64,
    /// Numbers of the breaths.
    pub breaths: Vec<u32>,
}

/// Asynchronies of a recording with flow.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Asynchronies {
    /// Number of breaths that were checked: whole ones without missing rows, with flow in both directions.
    pub checked: usize,
    /// Number of breaths that were not.
    pub unchecked: usize,
    /// Events per 100 breaths and missed efforts, percent (Thille's asynchrony index).
    pub index_percent: f64,
    /// All kinds.
    pub kinds: Vec<AsynchronyCount>,
}

/// Finds the asynchronies of a recording whose breaths have these rows and, if they can be judged, curves; `noise` is the
/// pressure's, cmH2O (sd). `None` without flow.
pub(super) fn asynchronies<'a>(
    recording: &Recording,
    breaths: impl Iterator<Item = (Range<usize>, Option<&'a BreathCurve>)>,
    noise: f64,
) -> Option<Asynchronies> {
    let flow = course::net_flow(recording)?;
    let noise = Noise { pressure: noise, flow: course::noise_of(&flow) };
    let courses: Vec<Option<Course>> =
        breaths.map(|(rows, curve)| Course::new(recording, rows, curve?, &flow)).collect();
    let inspirations: Vec<f64> = courses.iter().flatten().map(Course::inspiration_s).collect();
    let checked = inspirations.len();
    let mean_inspiration_s = inspirations.iter().sum::<f64>() / checked.max(1) as f64;
    let series = Series { courses: &courses, noise, mean_inspiration_s };
    let found: Vec<(u32, Asynchrony)> = (0..courses.len()).flat_map(|n| series.of_breath(n)).collect();
    let kinds: Vec<_> = Asynchrony::ALL.into_iter().map(|kind| count(kind, &found, checked)).collect();
    let cycles = checked + kinds[Asynchrony::MissedEffort as usize].events;
    (checked > 0).then(|| Asynchronies {
        checked,
        unchecked: courses.len() - checked,
        index_percent: 100.0 * found.len() as f64 / cycles as f64,
        kinds,
    })
}

fn count(kind: Asynchrony, found: &[(u32, Asynchrony)], checked: usize) -> AsynchronyCount {
    let mut breaths: Vec<u32> = found.iter().filter(|(_, k)| *k == kind).map(|(breath, _)| *breath).collect();
    let events = breaths.len();
    breaths.dedup();
    AsynchronyCount { kind, events, share: events as f64 / checked.max(1) as f64, breaths }
}

/// The breaths of a recording, one after the other.
struct Series<'a> {
    courses: &'a [Option<Course>],
    noise: Noise,
    mean_inspiration_s: f64,
}

impl Series<'_> {
    /// The asynchronies of breath `n`, with its number.
    fn of_breath(&self, n: usize) -> Vec<(u32, Asynchrony)> {
        let Some(course) = &self.courses[n] else { return Vec::new() };
        let mut found = vec![Asynchrony::MissedEffort; effort::missed(course, self.noise)];
        if effort::exhales_in_inspiration(course, self.noise) {
            found.push(Asynchrony::DelayedCycling);
        }
        if let Some(before) = self.beside(n, n.wrapping_sub(1)) {
            // However early: a double trigger's effort lasts on.
            if self.is_early(n, EARLY) && muscles::idle(before, course) {
                found.push(Asynchrony::AutoTrigger);
            } else if self.is_double(n, before) {
                found.push(Asynchrony::DoubleTrigger);
            }
        }
        found.into_iter().map(|kind| (course.number, kind)).collect()
    }

    /// Whether breath `n` follows an expiration that is far too short for the breath before.
    fn is_double(&self, n: usize, before: &Course) -> bool {
        let stacks = before.expired_ml() < STACKED * before.inspired_ml();
        let longest = if stacks { 1.0 } else { DOUBLE };
        before.expiration_s() < longest * self.mean_inspiration_s && self.is_early(n, SHORT)
    }

    /// Whether the expiration before breath `n` is at most this share of one of those before it and of one of those after
    /// it.
    fn is_early(&self, n: usize, share: f64) -> bool {
        let expiration = |other: usize| self.beside(n, other).map(Course::expiration_s);
        let Some(own) = expiration(n - 1) else { return false };
        let longer = |other: usize| expiration(other).is_some_and(|other| own <= share * other);
        (1..=AROUND).any(|by| longer((n - 1).wrapping_sub(by))) && (1..=AROUND).any(|by| longer(n - 1 + by))
    }

    /// Another breath of the same test run as breath `n`.
    fn beside(&self, n: usize, other: usize) -> Option<&Course> {
        let other = self.courses.get(other)?.as_ref()?;
        (self.courses[n].as_ref()?.group == other.group).then_some(other)
    }
}
