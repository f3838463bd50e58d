//! Reports of lungs, declared limits and sore spots.

use super::*;

/// Good breaths of two test runs on the lung R20 C50; the second run has a plateau this much above the target.
fn two_runs(above: f32) -> Recording {
    let edit = move |t: f64, row: &mut Row| {
        let run = row.breath / 3;
        row.group = Some(run);
        if run == 1 && (0.1..1.0 - 1e-9).contains(&t) {
            row.pressure += above;
        }
        true
    };
    let extras = &[Extra::Group, Extra::Resistance, Extra::Compliance];
    Build { breaths: 6, extras, edit: &edit, ..Build::default() }.recording()
}

fn limit(fixed: f64) -> Band {
    Band { fixed, percent: 0.0 }
}

#[test]
fn each_run_has_a_report_with_the_fields_of_the_test_table() {
    let verdict = judge(&two_runs(1.5), Judged::True, &Limits::default()).unwrap();
    let [first, second] = &verdict.lungs[..] else { panic!("{:?}", verdict.lungs) };
    assert_eq!((first.name.as_str(), second.name.as_str()), ("A:1 (R20 C50)", "A:2 (R20 C50)"));
    assert_eq!((first.breaths, second.breaths, first.pip, first.peep), (3, 3, PIP, PEEP));
    close(first.rate.map(|rate| rate.mean), 20.0, 1e-9);
    close(second.measured_pip.map(|pip| pip.mean), 26.5, 1e-6);
    close(second.end_inspiration.map(|end| end.mean), 26.5, 1e-6);
    close(first.measured_peep.map(|peep| peep.mean), PEEP, 1e-6);
    assert_eq!(first.tidal_volume_ml, None);
}

#[test]
fn a_row_of_the_test_table_is_found_by_lung_and_settings() {
    let with = |resistance: f32, peep: f32| {
        let edit = move |_: f64, row: &mut Row| {
            (row.resistance, row.peep) = (Some(resistance), peep);
            true
        };
        let extras = &[Extra::Resistance, Extra::Compliance];
        Build { extras, edit: &edit, ..Build::default() }.verdict().lungs.remove(0)
    };
    let lung = with(20.0, 10.0);
    assert_eq!(lung.name, "R20C50");
    let iso = lung.iso.unwrap();
    assert_eq!((iso.row, iso.rate, iso.tidal_volume_ml), (2, 12.0, 500.0));
    close(Some(iso.inspiratory_time_s), 1.0, 1e-6);
    assert_eq!(with(20.0, 5.0).iso, None);
    assert_eq!(with(21.0, 10.0).iso, None);
}

#[test]
fn settings_of_one_lung_are_reported_apart_in_the_order_of_pip() {
    let edit = |_: f64, row: &mut Row| {
        let pip = if row.breath.is_multiple_of(2) { 25.0 } else { 15.0 };
        (row.pip, row.target, row.pressure) = (pip, row.target.min(pip), row.pressure.min(pip));
        true
    };
    let lungs = Build { edit: &edit, ..Build::default() }.verdict().lungs;
    assert_eq!(lungs.iter().map(|lung| (lung.pip, lung.breaths)).collect::<Vec<_>>(), [(15.0, 2), (25.0, 2)]);
}

/// As when a set-point is converted from another unit, or drawn from a very narrow range.
#[test]
fn settings_that_differ_by_rounding_only_are_one() {
    let edit = |_: f64, row: &mut Row| {
        row.pip += [0.0, 2e-6, -2e-6][row.breath as usize % 3];
        true
    };
    let lungs = Build { breaths: 6, edit: &edit, ..Build::default() }.verdict().lungs;
    assert_eq!(lungs.iter().map(|lung| lung.breaths).collect::<Vec<_>>(), [6]);
}

#[test]
fn the_accuracy_covers_both_ends() {
    let verdict = judge(&two_runs(1.5), Judged::True, &Limits::default()).unwrap();
    let inspiration = verdict.accuracy_inspiration.unwrap();
    assert_eq!((inspiration.breaths, inspiration.declared), (6, Band { fixed: 1.5, percent: 0.0 }));
    close(Some(inspiration.of_usual), 0.5, 1e-6);
    assert_eq!(verdict.accuracy_expiration.unwrap().declared, Band { fixed: 0.0, percent: 0.0 });
}

#[test]
fn a_limit_is_kept_up_to_its_value() {
    let with = |kind, limit| {
        let verdict = judge(&two_runs(1.5), Judged::True, &Limits::default().with(kind, limit)).unwrap();
        (verdict.violating_breaths(), verdict.limits[0].checked)
    };
    for kind in [Kind::Plateau, Kind::Overshoot] {
        assert_eq!(with(kind, Some(limit(1.5))), (0, 6), "{kind:?}");
        assert_eq!(with(kind, Some(limit(1.49))), (3, 6), "{kind:?}");
    }
    // 1.49 of 1.5 fixed, the rest from a percentage of the target.
    assert_eq!(with(Kind::Plateau, Some(Band { fixed: 1.0, percent: 2.0 })), (0, 6));
    assert_eq!(with(Kind::Plateau, Some(Band { fixed: 1.0, percent: 1.9 })), (3, 6));
    assert_eq!(with(Kind::Rise, Some(limit(80.001))), (0, 6));
    assert_eq!(with(Kind::Rise, Some(limit(79.0))), (6, 6));
    assert_eq!(with(Kind::Baseline, Some(limit(0.0))), (0, 6));
    assert_eq!(with(Kind::Error, Some(limit(0.0))), (6, 6));
}

#[test]
fn a_violation_names_lung_breath_value_and_limit() {
    let limits = Limits::default().with(Kind::Plateau, Some(Band { fixed: 0.0, percent: 4.0 }));
    let verdict = judge(&two_runs(1.5), Judged::True, &limits).unwrap();
    let violation = &verdict.limits[0].violations[0];
    assert_eq!((violation.lung.as_str(), violation.breath), ("A:2 (R20 C50)", 3));
    close(Some(violation.value), 1.5, 1e-6);
    close(Some(violation.allowed), 1.0, 1e-6);
}

#[test]
fn a_breath_beyond_two_limits_is_counted_once() {
    let limits =
        Limits::default().with(Kind::Plateau, Some(limit(1.0))).with(Kind::Overshoot, Some(limit(1.0)));
    let verdict = judge(&two_runs(1.5), Judged::True, &limits).unwrap();
    assert_eq!((verdict.violating_breaths(), verdict.limits.len()), (3, 2));
}

#[test]
fn a_rise_that_never_ends_violates_every_limit_on_the_rise() {
    let build = Build { pressure: &|t| good(t).min(20.0), ..Build::default() };
    let limits = Limits::default().with(Kind::Rise, Some(limit(5_000.0)));
    assert_eq!(judge(&build.recording(), Judged::True, &limits).unwrap().violating_breaths(), 4);
}

#[test]
fn a_figure_that_some_breaths_lack_is_counted_as_unknown() {
    let edit = |t: f64, row: &mut Row| row.breath != 3 || t < 2.0;
    let limits = Limits::default().with(Kind::Baseline, Some(limit(1.0)));
    let recording = Build { edit: &edit, ..Build::default() }.recording();
    let verdict = judge(&recording, Judged::True, &limits).unwrap();
    assert_eq!((verdict.limits[0].checked, verdict.limits[0].unknown), (3, 1));
    let alone = Build { breaths: 1, ..Build::default() }.recording();
    let refused = judge(&alone, Judged::True, &limits).unwrap_err();
    assert!(matches!(refused, VerdictError::Unknown { what: "end of expiration", .. }), "{refused}");
}

#[test]
fn good_breaths_have_no_sore_spots() {
    assert_eq!(Build::default().verdict().sore_spots, []);
}

#[test]
fn sore_spots_start_above_the_tolerance_or_the_declared_limit() {
    let spots =
        |above: f32, limits: &Limits| judge(&two_runs(above), Judged::True, limits).unwrap().sore_spots.len();
    let none = Limits::default();
    assert_eq!((spots(2.0, &none), spots(2.01, &none)), (0, 1), "overshoot of 2 cmH2O");
    let strict = none.with(Kind::Overshoot, Some(limit(1.0)));
    assert_eq!((spots(1.0, &strict), spots(1.01, &strict)), (0, 1));
}

/// The text of the only sore spot of this kind.
fn text(kind: Kind, pressure: &dyn Fn(f64) -> f64) -> String {
    let verdict = Build { pressure, ..Build::default() }.verdict();
    let spots: Vec<_> = verdict.sore_spots.iter().filter(|spot| spot.kind == kind).collect();
    let [spot] = spots[..] else { panic!("{kind:?}: {:?}", verdict.sore_spots) };
    spot.text.clone()
}

#[test]
fn sore_spots_are_named_in_words() {
    use std::f64::consts::TAU;
    let held = |t: f64| (0.3..1.0 - 1e-9).contains(&t);
    assert_eq!(
        text(Kind::Overshoot, &|t| if (0.2..0.25).contains(&t) { 28.4 } else { good(t) }),
        "all, breath 0: overshoot of 3.4 cmH2O above 25 cmH2O, 0.20 s after the start (4 of 4 breaths)"
    );
    assert_eq!(
        text(Kind::Plateau, &|t| if held(t) { 20.5 } else { good(t) }),
        "all, breath 0: plateau 4.5 cmH2O below 25 cmH2O (4 of 4 breaths)"
    );
    assert_eq!(
        text(Kind::Undershoot, &|t| if (0.3..0.35).contains(&t) { 21.0 } else { good(t) }),
        "all, breath 0: falls 4.0 cmH2O below 25 cmH2O after its first peak, 0.30 s after the start (4 of 4 breaths)"
    );
    assert_eq!(
        text(Kind::Slope, &|t| if held(t) { 25.0 - 6.0 * (t - 0.85) } else { good(t) }),
        "all, breath 0: plateau falls by 6.0 cmH2O/s (4 of 4 breaths)"
    );
    assert_eq!(
        text(Kind::Rise, &|t| if t < 1.0 { (PEEP + 40.0 * t).min(PIP) } else { PEEP }),
        "all, breath 0: slow rise, 400 ms to 25 cmH2O (4 of 4 breaths)"
    );
    assert_eq!(
        text(Kind::Rise, &|t| good(t).min(15.0)),
        "all, breath 0: does not get to 90 % of the way to 25 cmH2O in 1.00 s (4 of 4 breaths)"
    );
    assert_eq!(
        text(Kind::BelowPeep, &|t| if (1.3..1.4).contains(&t) { 1.0 } else { good(t) }),
        "all, breath 0: falls 4.0 cmH2O below PEEP 5 cmH2O, 1.30 s after the start (4 of 4 breaths)"
    );
    assert_eq!(
        text(Kind::Baseline, &|t| if t >= 1.0 { good(t).max(8.0) } else { good(t) }),
        "all, breath 0: ends the expiration 3.0 cmH2O above PEEP 5 cmH2O (4 of 4 breaths)"
    );
    assert_eq!(
        text(Kind::Oscillation, &|t| if held(t) { 25.0 + 1.6 * (TAU * 5.0 * t).sin() } else { good(t) }),
        "all, breath 0: oscillates: 8 swings of up to 3.2 cmH2O, 5.0 Hz (4 of 4 breaths)"
    );
}

#[test]
fn an_oscillation_has_at_least_three_swings() {
    let pulses = |count: u32| {
        let pressure = move |t: f64| {
            let pulse =
                (0..count).any(|n| (0.3 + 0.1 * f64::from(n)..0.35 + 0.1 * f64::from(n)).contains(&t));
            if pulse { 28.0 } else { good(t) }
        };
        let verdict = Build { pressure: &pressure, ..Build::default() }.verdict();
        verdict.sore_spots.iter().any(|spot| spot.kind == Kind::Oscillation)
    };
    assert_eq!((pulses(1), pulses(2)), (false, true));
}

#[test]
fn the_worst_breath_is_named_and_the_most_severe_spot_comes_first() {
    let edit = |t: f64, row: &mut Row| {
        if (0.2..0.21).contains(&t) {
            row.pressure += [0.0, 3.0, 5.0, 4.0][row.breath as usize];
        }
        if (1.3..1.4).contains(&t) && row.breath == 1 {
            row.pressure -= 3.0;
        }
        true
    };
    let verdict = Build { edit: &edit, ..Build::default() }.verdict();
    let spots: Vec<_> = verdict.sore_spots.iter().map(|s| (s.kind, s.breath, s.breaths, s.worst)).collect();
    assert_eq!(spots, [(Kind::Overshoot, 2, 3, 2), (Kind::BelowPeep, 1, 1, 1)]);
    close(Some(verdict.sore_spots[0].severity), 2.5, 1e-6);
    assert!(verdict.sore_spots[1].text.ends_with("(the only one of 4 breaths)"));
}
