//! Rise-time settings: the figures of a breath do not depend on one that the target does not show.

use super::*;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, Normal};

/// Noise of the pressure, cmH2O (sd).
const NOISE: f64 = 0.05;

/// A breath that rises from PEEP to PIP in this time, overshoots by 1.5 cmH2O, and rests 0.4 cmH2O above PIP.
fn rising(rise_s: f64, t: f64) -> f64 {
    if t >= 1.0 {
        return (PIP - 200.0 * (t - 1.0)).max(PEEP);
    }
    let ramp = PEEP + (PIP - PEEP) * (t / rise_s.max(0.02)).min(1.0);
    let bump = if (0.0..0.06).contains(&(t - rise_s - 0.05)) { 1.5 } else { 0.0 };
    ramp + bump + if t > rise_s + 0.12 { 0.4 } else { 0.0 }
}

/// Four such breaths with noise. The target is a square, or inferred: the plateau.
fn recording(rise_s: f64, inferred: bool) -> Recording {
    let noise = std::cell::RefCell::new(ChaCha8Rng::seed_from_u64(3));
    let normal = Normal::new(0.0, NOISE).unwrap();
    let pressure = |t: f64| rising(rise_s, t) + normal.sample(&mut *noise.borrow_mut());
    let edit = |t: f64, row: &mut Row| {
        if inferred && t < 1.0 - 1e-9 {
            (row.target, row.pip) = (PIP as f32 + 0.4, PIP as f32 + 0.4);
        }
        true
    };
    let mut recording = Build { pressure: &pressure, edit: &edit, ..Build::default() }.recording();
    if inferred {
        recording.provenance.notes.push(NO_SET_POINT.to_owned());
    }
    recording
}

#[test]
fn a_rise_time_setting_changes_neither_level_nor_overshoot_nor_plateau() {
    for inferred in [false, true] {
        let of = |rise_s: f64| {
            let mut verdict = judge(&recording(rise_s, inferred), Judged::True, &Limits::default()).unwrap();
            assert_eq!(verdict.target, if inferred { Target::Inferred } else { Target::AsSet });
            verdict.breaths.remove(0).figures
        };
        let square = of(0.0);
        for rise_s in [0.1, 0.2, 0.3, 0.4, 0.5] {
            let ramped = of(rise_s);
            close(Some(ramped.level), square.level, 1e-9);
            close(Some(ramped.overshoot), square.overshoot, 4.0 * NOISE);
            close(ramped.slope, square.slope.unwrap(), 0.25);
            close(ramped.end_inspiration, square.end_inspiration.unwrap(), NOISE);
            assert_eq!(ramped.plateau_error.is_none(), inferred);
            if !inferred {
                close(ramped.plateau_error, 0.4, NOISE);
                assert_eq!(remarked(&ramped, "rises in a straight line"), rise_s > 0.15, "{rise_s}");
            }
        }
    }
}

#[test]
fn a_plateau_begins_after_a_rise_that_the_target_does_not_show() {
    let slow = |t: f64| if t < 1.0 { (PEEP + (PIP - PEEP) * t / 0.8).min(PIP) } else { PEEP };
    for inferred in [false, true] {
        let mut recording = Build { pressure: &slow, ..Build::default() }.recording();
        if inferred {
            recording.provenance.notes.push(NO_SET_POINT.to_owned());
        }
        let verdict = judge(&recording, Judged::True, &Limits::default()).unwrap();
        close(verdict.breaths[0].figures.slope, 0.0, 0.1);
    }
}

#[test]
fn a_target_that_was_square_says_so_and_one_that_rises_may_take_its_time() {
    let spots = |recording: &Recording| {
        let verdict = judge(recording, Judged::True, &Limits::default()).unwrap();
        let rise = verdict.sore_spots.iter().any(|spot| spot.kind == Kind::Rise);
        assert_eq!(
            verdict.tolerated().iter().any(|r| r.kind == Kind::Rise && !r.violations.is_empty()),
            rise
        );
        rise
    };
    assert!(spots(&recording(0.6, false)), "the target rises at once");
    assert!(!spots(&recording(0.6, true)), "nobody knows the target");
    let ramp = |t: f64| if t < 1.0 - 1e-9 { (PEEP + (PIP - PEEP) * t / 0.6).min(PIP) } else { PEEP };
    let follows = Build { target: &ramp, pressure: &ramp, ..Build::default() };
    assert!(!spots(&follows.recording()), "480 ms are asked for");
    let figures = follows.figures();
    close(figures.target_rise_ms, 480.0, 1e-3);
    assert!(figures.remarks.is_empty(), "{figures:?}");
    let late = |t: f64| if t < 1.0 { (PEEP + (PIP - PEEP) * t / 0.99).min(PIP) } else { PEEP };
    assert!(spots(&Build { target: &ramp, pressure: &late, ..Build::default() }.recording()), "792 ms");
}

#[test]
fn a_declared_limit_on_the_rise_stands_as_it_is() {
    let limits = Limits::default().with(Kind::Rise, Some(Band { fixed: 300.0, percent: 0.0 }));
    let verdict = judge(&recording(0.6, true), Judged::True, &limits).unwrap();
    assert_eq!((verdict.violating_breaths(), verdict.limits[0].checked), (4, 4));
}

/// Orders of magnitude of rise times and noise: no draw makes a ramp of a lag.
#[test]
fn a_lag_is_no_rise_time_setting() {
    let mut random = ChaCha8Rng::seed_from_u64(9);
    for _ in 0..40 {
        let (lag, noise) = (random.random_range(0.03..0.3), random.random_range(0.0..0.3));
        let normal = Normal::new(0.0, noise).unwrap();
        let values = std::cell::RefCell::new(ChaCha8Rng::seed_from_u64(random.random()));
        let pressure = |t: f64| {
            let clean = if t < 1.0 { PIP - 20.0 * (-t / lag).exp() } else { PEEP };
            clean + normal.sample(&mut *values.borrow_mut())
        };
        let figures = Build { pressure: &pressure, ..Build::default() }.figures();
        assert!(!remarked(&figures, "straight line"), "lag {lag}, noise {noise}");
    }
}
