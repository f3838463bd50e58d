//! The verdict on a recording for a page: the figures that `trainer judge` prints, with the tolerances of its sore spots as limits.

use std::collections::BTreeSet;

use data::recording::Recording;
use verdict::{Judged, LimitResult, Limits, judge};

use crate::stream::{LimitCheck, Tolerance, Verdict};

/// Most sore spots.
const SORE_SPOTS: usize = 12;

/// Judges a recording; one that cannot be judged gives the reason.
pub fn verdict(recording: &Recording) -> Verdict {
    let found = match judge(recording, Judged::True, &Limits::default()) {
        Ok(found) => found,
        Err(error) => return Verdict { refused: Some(error.to_string()), ..Verdict::default() },
    };
    let limits = found.tolerated();
    let violated = limits.iter().flat_map(|limit| &limit.violations).map(|violation| violation.breath);
    let errors: Vec<f64> = found.breaths.iter().filter_map(|breath| breath.figures.error).collect();
    Verdict {
        refused: None,
        breaths: found.breaths.len(),
        unjudged: found.unjudged.len(),
        violating: violated.collect::<BTreeSet<_>>().len(),
        error: (!errors.is_empty()).then(|| errors.iter().sum::<f64>() / errors.len() as f64),
        explored: found.explored,
        inspiration: found.accuracy_inspiration.map(|accuracy| tolerance(accuracy.declared)),
        expiration: found.accuracy_expiration.map(|accuracy| tolerance(accuracy.declared)),
        limits: limits.iter().map(check).collect(),
        sore_spots: found.sore_spots.iter().take(SORE_SPOTS).map(|spot| spot.text.clone()).collect(),
    }
}

fn tolerance(band: verdict::Band) -> Tolerance {
    Tolerance { fixed: band.fixed, percent: band.percent }
}

fn check(result: &LimitResult) -> LimitCheck {
    let worst = result.violations.iter().max_by(|a, b| a.value.total_cmp(&b.value));
    LimitCheck {
        name: result.kind.name(),
        unit: result.kind.unit(),
        limit: tolerance(result.limit),
        checked: result.checked,
        violations: result.violations.len(),
        worst: worst.map(|violation| violation.value),
        worst_breath: worst.map(|violation| violation.breath),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use data::provenance::Provenance;
    use data::recording::{EXPIRATION, INSPIRATION, Row};

    /// Square breaths of 3 s; those with a number in `bad` overshoot by 6 cmH2O.
    fn recording(breaths: u32, bad: &[u32]) -> Recording {
        let mut recording = Recording::new(Provenance::new(10_000, "test"), false);
        for (breath, tick) in (0..breaths).flat_map(|breath| (0..300).map(move |tick| (breath, tick))) {
            let inspires = tick < 100;
            let (phase, target) = if inspires { (INSPIRATION, 20.0) } else { (EXPIRATION, 5.0) };
            let rise = 5.0 + 15.0 * (f64::from(tick) / 10.0).min(1.0) as f32;
            let over = if bad.contains(&breath) && (12..20).contains(&tick) { 6.0 } else { 0.0 };
            let pressure = if inspires { rise + over } else { 5.0 };
            let (pip, peep) = (20.0, 5.0);
            recording.push(Row { breath, tick, phase, target, pressure, pip, peep, ..Row::default() });
        }
        recording
    }

    #[test]
    fn breaths_beyond_a_tolerance_are_counted_with_the_worst_one() {
        let found = verdict(&recording(5, &[1, 3]));
        assert_eq!((found.refused, found.breaths, found.unjudged, found.violating), (None, 5, 0, 2));
        let overshoot = found.limits.iter().find(|limit| limit.name == "overshoot").unwrap();
        assert_eq!((overshoot.checked, overshoot.violations), (5, 2));
        assert!((overshoot.worst.unwrap() - 6.0).abs() < 0.5, "{overshoot:?}");
        assert!(matches!(overshoot.worst_breath, Some(1 | 3)));
        assert!(found.sore_spots.iter().any(|spot| spot.contains("overshoot")), "{:?}", found.sore_spots);
        assert!(found.error.unwrap() > 0.0 && found.inspiration.is_some());
    }

    #[test]
    fn good_breaths_violate_nothing() {
        let found = verdict(&recording(4, &[]));
        assert_eq!((found.violating, found.sore_spots.len()), (0, 0), "{found:?}");
    }

    #[test]
    fn what_cannot_be_judged_gives_the_reason() {
        let found = verdict(&recording(0, &[]));
        assert_eq!(found.refused.as_deref(), Some("the recording contains no breath"));
    }
}
