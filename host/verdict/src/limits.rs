//! What can be wrong with a breath, how much of it is allowed, and which limits a user declares.

use serde::Serialize;

use super::Breath;
use super::accuracy::{Band, USUAL};
use super::figures::CUT;

/// What can be wrong with a breath.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Kind {
    /// Mean absolute error over the inspiration, cmH2O.
    Error,
    /// Rise time, ms; exceeded as well by a rise that does not get to 90 % of the way.
    Rise,
    /// Overshoot, cmH2O.
    Overshoot,
    /// Undershoot in the inspiration, cmH2O.
    Undershoot,
    /// Largest swing of an oscillation, cmH2O.
    Oscillation,
    /// Plateau error, cmH2O.
    Plateau,
    /// Slope of the plateau, cmH2O/s.
    Slope,
    /// Distance from PEEP at the end of the expiration, cmH2O.
    Baseline,
    /// Undershoot below PEEP in the expiration, cmH2O.
    BelowPeep,
    /// Missing end of the inspiration, as a share of its usual length.
    CutShort,
}

/// Number of kinds.
const KINDS: usize = 10;
/// Fewest swings of an oscillation: the fall from an overshoot and its recovery are not one.
const OSCILLATES_FROM: usize = 3;

impl Kind {
    /// Every kind.
    pub const ALL: [Self; KINDS] = [
        Self::Error,
        Self::Rise,
        Self::Overshoot,
        Self::Undershoot,
        Self::Oscillation,
        Self::Plateau,
        Self::Slope,
        Self::Baseline,
        Self::BelowPeep,
        Self::CutShort,
    ];

    /// Name in reports and file names.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Error => "mean error",
            Self::Rise => "rise time",
            Self::Overshoot => "overshoot",
            Self::Undershoot => "undershoot",
            Self::Oscillation => "oscillation",
            Self::Plateau => "plateau error",
            Self::Slope => "slope of the plateau",
            Self::Baseline => "end of expiration",
            Self::BelowPeep => "fall below PEEP",
            Self::CutShort => "cut short",
        }
    }

    /// Unit of its values.
    pub const fn unit(self) -> &'static str {
        match self {
            Self::Rise => "ms",
            Self::Slope => "cmH2O/s",
            Self::CutShort => "of the inspiration",
            _ => "cmH2O",
        }
    }

    /// What is tolerated unless a limit is declared; `None`: a sore spot only with a declared limit.
    const fn tolerated(self) -> Option<Band> {
        let fixed = match self {
            Self::Error => return None,
            Self::Plateau | Self::Baseline => return Some(USUAL),
            Self::Rise => 300.0,
            Self::Overshoot | Self::Undershoot | Self::BelowPeep | Self::Oscillation => 2.0,
            Self::Slope => 5.0,
            Self::CutShort => CUT,
        };
        Some(Band { fixed, percent: 0.0 })
    }

    /// What is tolerated in a breath; `None` if there is no tolerance. A rise may take as long as its target's in addition,
    /// and any time if nobody knows the target's.
    fn tolerates(self, breath: &Breath) -> Option<f64> {
        let tolerated = self.tolerated()?.at(self.set(breath));
        match self {
            Self::Rise => Some(tolerated + breath.figures.target_rise_ms?),
            _ => Some(tolerated),
        }
    }

    /// The breath's value of this kind, its size and place; `None` if it is unknown.
    pub(super) fn finding(self, breath: &Breath) -> Option<Finding> {
        let figures = &breath.figures;
        let at_end = figures.inspiration_s;
        let found = |value: f64, at_s: f64| Some(Finding { value, at_s, beyond: false });
        match self {
            Self::Error => found(figures.error?, 0.0),
            Self::Rise if !figures.reached && figures.cut <= CUT => {
                Some(Finding { value: 1e3 * at_end, at_s: at_end, beyond: true })
            }
            Self::Rise => found(figures.rise_ms?, 0.0),
            Self::Overshoot => found(figures.overshoot, figures.peak_at_s),
            Self::Undershoot => found(figures.undershoot?, figures.undershoot_at_s.unwrap_or(at_end)),
            Self::Oscillation => {
                let swings = figures.swings?;
                let size = if swings.count >= OSCILLATES_FROM { swings.size } else { 0.0 };
                found(size, figures.peak_at_s)
            }
            Self::Plateau => found(figures.plateau_error?, at_end),
            Self::Slope => found(figures.slope?.abs(), at_end),
            Self::Baseline if !breath.set_point => None,
            Self::Baseline => found((figures.end_expiration? - breath.peep).abs(), figures.breath_s?),
            Self::BelowPeep => found(figures.below_peep?, figures.below_peep_at_s?),
            Self::CutShort => found(figures.cut, at_end),
        }
    }

    /// The set pressure that a percentage refers to, cmH2O.
    fn set(self, breath: &Breath) -> f64 {
        match self {
            Self::Baseline | Self::BelowPeep => breath.peep,
            _ => breath.figures.level,
        }
    }
}

/// Value of one kind in one breath.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Finding {
    pub value: f64,
    /// Time of it, s after the start of the inspiration.
    pub at_s: f64,
    /// Whether the true value is larger than any that fits into the breath.
    pub beyond: bool,
}

/// Severity of a rise that never ends, at least.
const NEVER: f64 = 2.0;

impl Finding {
    /// Value as a share of what is allowed; the limit is kept up to 1.
    pub fn severity(&self, allowed: f64) -> f64 {
        let share = if self.value > 0.0 { self.value / allowed.max(1e-9) } else { 0.0 };
        if self.beyond { share.max(NEVER) } else { share }
    }
}

/// Declared limits; all others have the tolerances of the sore spots.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Limits {
    declared: [Option<Band>; KINDS],
}

impl Limits {
    /// Declares a limit.
    #[must_use]
    pub fn with(mut self, kind: Kind, limit: Option<Band>) -> Self {
        self.declared[kind as usize] = limit;
        self
    }

    /// The declared limits.
    pub(super) fn declared(&self) -> impl Iterator<Item = (Kind, Band)> {
        Kind::ALL.into_iter().filter_map(|kind| Some((kind, self.declared[kind as usize]?)))
    }

    /// Allowed value of a kind in a breath; `None` if there is no limit to it.
    pub(super) fn allowed(&self, kind: Kind, breath: &Breath) -> Option<f64> {
        match self.declared[kind as usize] {
            Some(declared) => Some(declared.at(kind.set(breath))),
            None => kind.tolerates(breath),
        }
    }
}

/// Result of one declared limit over all breaths.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct LimitResult {
    /// What is limited.
    pub kind: Kind,
    /// The declared limit, in the kind's unit.
    pub limit: Band,
    /// Number of breaths of which the value is known.
    pub checked: usize,
    /// Number of judged breaths of which it is not.
    pub unknown: usize,
    /// Breaths that violate the limit.
    pub violations: Vec<Violation>,
}

/// A breath beyond a declared limit.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Violation {
    /// Name of the lung.
    pub lung: String,
    /// Number of the breath in the recording.
    pub breath: u32,
    /// The value, in the kind's unit.
    pub value: f64,
    /// What the limit allows in this breath.
    pub allowed: f64,
}

/// Checks each declared limit on each breath.
pub(super) fn check(limits: &Limits, breaths: &[Breath]) -> Vec<LimitResult> {
    let one =
        |(kind, limit): (Kind, Band)| checked(kind, limit, breaths, |breath| limits.allowed(kind, breath));
    limits.declared().map(one).collect()
}

/// Checks each tolerance of the sore spots on each breath.
pub(super) fn tolerated(breaths: &[Breath]) -> Vec<LimitResult> {
    let one = |kind: Kind| Some(checked(kind, kind.tolerated()?, breaths, |breath| kind.tolerates(breath)));
    Kind::ALL.into_iter().filter_map(one).collect()
}

/// Checks one limit. A breath without the figure, or in which nothing is asked of it, counts as unknown.
fn checked(
    kind: Kind,
    limit: Band,
    breaths: &[Breath],
    allowed: impl Fn(&Breath) -> Option<f64>,
) -> LimitResult {
    let mut result = LimitResult { kind, limit, checked: 0, unknown: 0, violations: Vec::new() };
    for breath in breaths {
        let (Some(finding), Some(allowed)) = (kind.finding(breath), allowed(breath)) else {
            result.unknown += 1;
            continue;
        };
        result.checked += 1;
        let kept = !finding.beyond && finding.value <= allowed;
        if !kept {
            let (lung, value) = (breath.lung_name(), finding.value);
            result.violations.push(Violation { lung, breath: breath.number, value, allowed });
        }
    }
    result
}
