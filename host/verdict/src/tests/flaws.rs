//! Flaws of recordings: each has an answer, and none gives a wrong number or a panic.

use super::*;
use data::recording::FALL;
use proptest::prelude::*;

/// Why the second of four breaths is not judged; the others must be.
fn refusal(edit: &dyn Fn(f64, &mut Row) -> bool) -> Refusal {
    let build = Build { edit: &|t, row| row.breath != 1 || edit(t, row), ..Build::default() };
    let verdict = build.verdict();
    assert_eq!(verdict.breaths.iter().map(|breath| breath.number).collect::<Vec<_>>(), [0, 2, 3]);
    let [unjudged] = &verdict.unjudged[..] else { panic!("{:?}", verdict.unjudged) };
    assert_eq!((unjudged.breath, unjudged.lung.as_str()), (1, "all"));
    unjudged.reason
}

/// Whether a time is in the half-open interval, up to rounding.
fn within(t: f64, from: f64, to: f64) -> bool {
    t > from - 1e-6 && t < to - 1e-6
}

#[test]
fn a_value_that_is_no_number_is_named() {
    let spoil = |set: fn(&mut Row)| {
        refusal(&move |t, row| {
            if within(t, 0.007, 0.008) {
                set(row);
            }
            true
        })
    };
    let in_row_7 = |column| Refusal::NotFinite { column, row: 7 };
    assert_eq!(spoil(|row| row.pressure = f32::NAN), in_row_7("pressure"));
    assert_eq!(spoil(|row| row.target = f32::INFINITY), in_row_7("target"));
    assert_eq!(spoil(|row| row.pip = f32::NAN), in_row_7("PIP"));
    assert_eq!(spoil(|row| row.peep = f32::NAN), in_row_7("PEEP"));
}

#[test]
fn an_inspiration_without_start_or_end_is_refused() {
    assert_eq!(refusal(&|t, _| t > 1e-6), Refusal::Start);
    assert_eq!(refusal(&|t, _| t >= 1.0 - 1e-6), Refusal::Start);
    assert_eq!(refusal(&|t, _| t < 1.0 - 1e-6), Refusal::End);
    assert_eq!(refusal(&|t, _| t < 0.4), Refusal::End);
}

#[test]
fn an_inspiration_of_few_ticks_is_refused() {
    let ticks = |until: f64| {
        move |t: f64, row: &mut Row| {
            row.phase = if t < until { INSPIRATION } else { EXPIRATION };
            true
        }
    };
    assert_eq!(refusal(&ticks(0.0085)), Refusal::TooFew(9));
    let build = Build { edit: &ticks(0.0095), ..Build::default() };
    assert!(remarked(&build.figures(), "too short"));
}

#[test]
fn a_target_that_does_not_rise_is_refused() {
    let low = |height: f32| {
        move |_: f64, row: &mut Row| {
            row.target = row.target.min(5.0 + height);
            true
        }
    };
    assert_eq!(refusal(&low(0.49)), Refusal::NoStep);
    assert_eq!(Build { edit: &low(0.51), ..Build::default() }.verdict().unjudged, []);
}

#[test]
fn short_holes_are_bridged_and_longer_ones_refused() {
    let whole = Build::default().figures();
    let bridged = Build { edit: &|t, _| !within(t, 0.03, 0.05), ..Build::default() }.figures();
    assert_eq!(bridged.bridged, 20);
    assert!(remarked(&bridged, "20 missing ticks are bridged"));
    // The missing rise is a straight line.
    close(bridged.rise_ms, whole.rise_ms.unwrap(), 1e-3);
    close(bridged.error, whole.error.unwrap(), 1e-4);
    assert_eq!(refusal(&|t, _| !within(t, 0.03, 0.051)), Refusal::Holes { missing: 21, ticks: 1000 });
}

#[test]
fn many_short_holes_are_refused() {
    let every = |count: u32| move |_: f64, row: &mut Row| row.tick == 0 || !row.tick.is_multiple_of(count);
    assert_eq!(Build { edit: &every(20), ..Build::default() }.figures().bridged, 49);
    assert_eq!(refusal(&every(19)), Refusal::Holes { missing: 52, ticks: 1000 });
}

#[test]
fn a_breath_with_a_hole_has_no_volume() {
    let build = Build {
        extras: &[Extra::FlowIn, Extra::FlowOut],
        edit: &|t, row| {
            (row.flow_in, row.flow_out) = (Some(0.1), Some(0.05));
            row.breath != 1 || !within(t, 2.0, 2.001)
        },
        ..Build::default()
    };
    let volumes: Vec<_> = build.verdict().breaths.iter().map(|b| b.tidal_volume_ml.is_some()).collect();
    assert_eq!(volumes, [true, false, true, true]);
}

#[test]
fn a_breath_that_ends_early_has_no_end_of_expiration() {
    let until = |end: f64| {
        let edit = move |t: f64, row: &mut Row| row.breath != 3 || t < end - 1e-6;
        let verdict = Build { edit: &edit, ..Build::default() }.verdict();
        (verdict.breaths[3].figures.clone(), verdict.lungs[0].rate.unwrap().breaths)
    };
    let (cut, rates) = until(2.6);
    assert_eq!((cut.end_expiration, cut.breath_s, rates), (None, None, 3));
    assert!(remarked(&cut, "no end of expiration"));
    close(cut.plateau_error, 0.0, 1e-6);
    assert!(until(2.7).0.end_expiration.is_some());
}

#[test]
fn a_run_of_faster_breaths_is_a_new_setting() {
    let edit = |t: f64, row: &mut Row| {
        let fast = row.breath >= 9;
        if fast && t > 0.6 - 1e-6 {
            row.phase = EXPIRATION;
        }
        !fast || t < 1.2 - 1e-6
    };
    let verdict = Build { breaths: 17, edit: &edit, ..Build::default() }.verdict();
    for breath in &verdict.breaths {
        let figures = &breath.figures;
        assert!(figures.end_expiration.is_some() && figures.plateau_error.is_some(), "{}", breath.number);
        assert_eq!((figures.breath_s.is_some(), figures.cut), (true, 0.0), "{}", breath.number);
    }
    assert!(verdict.sore_spots.iter().all(|spot| spot.kind != Kind::CutShort));
}

#[test]
fn the_length_of_a_single_breath_means_nothing() {
    let alone = Build { breaths: 1, ..Build::default() }.figures();
    assert_eq!((alone.breath_s, alone.end_expiration), (None, None));
    assert!(remarked(&alone, "the only one"));
}

#[test]
fn an_inspiration_that_is_cut_short_has_no_plateau() {
    let until = |end: f64| {
        let edit = move |t: f64, row: &mut Row| {
            if row.breath == 2 && t > end - 1e-6 {
                row.phase = EXPIRATION;
            }
            true
        };
        Build { edit: &edit, ..Build::default() }.verdict()
    };
    let verdict = until(0.6);
    let cut = &verdict.breaths[2].figures;
    close(Some(cut.cut), 0.4, 1e-6);
    assert_eq!((cut.plateau_error, cut.slope, cut.end_inspiration), (None, None, None));
    assert!(remarked(cut, "ends after 0.60 s, usually after 1.00 s"));
    close(cut.rise_ms, 80.0, 1e-3);
    let spot = verdict.sore_spots.iter().find(|spot| spot.kind == Kind::CutShort).unwrap();
    assert_eq!((spot.breath, spot.breaths, spot.of), (2, 1, 4));
    assert!(until(0.901).breaths[2].figures.plateau_error.is_some());
    // A cut before the end of the rise is no slow rise.
    let early = until(0.05);
    assert!(early.sore_spots.iter().all(|spot| spot.kind != Kind::Rise), "{:?}", early.sore_spots);
}

#[test]
fn a_ramp_is_followed_and_its_end_is_the_level() {
    let ramp = |t: f64| if t < 1.0 { (PEEP + 50.0 * t).min(PIP) } else { PEEP };
    let figures = Build { target: &ramp, pressure: &ramp, ..Build::default() }.figures();
    close(figures.error, 0.0, 1e-6);
    close(figures.rise_ms, 320.0, 1e-3);
    assert_eq!((figures.level, figures.overshoot), (PIP, 0.0));
    close(figures.plateau_error, 0.0, 1e-6);
}

#[test]
fn a_target_that_never_rests_has_no_plateau() {
    let ramp = |t: f64| if t < 1.0 { PEEP + 20.0 * t } else { PEEP };
    let figures = Build { target: &ramp, pressure: &ramp, ..Build::default() }.figures();
    assert_eq!((figures.plateau_error, figures.slope), (None, None));
    assert!(remarked(&figures, "the target still moves"));
    close(figures.error, 0.0, 1e-6);
    close(Some(figures.level), 24.98, 1e-5);
}

#[test]
fn a_clipped_target_is_the_level_and_is_remarked() {
    let clipped = |t: f64| square(t).min(22.0);
    let figures = Build { target: &clipped, pressure: &|t| good(t).min(22.0), ..Build::default() }.figures();
    close(Some(figures.level), 22.0, 0.0);
    assert!(remarked(&figures, "the target rests 3.0 cmH2O below PIP"));
    close(figures.plateau_error, 0.0, 1e-6);
    let above = Build { target: &|t| square(t) * 1.02, ..Build::default() }.figures();
    assert!(remarked(&above, "0.5 cmH2O above PIP"));
}

#[test]
fn a_target_that_falls_within_the_inspiration_still_has_its_level() {
    let early = |t: f64| if t < 0.95 { square(t) } else { PEEP };
    let figures = Build { target: &early, ..Build::default() }.figures();
    close(Some(figures.level), PIP, 0.0);
    assert!(remarked(&figures, "falls before the inspiration ends"));
    close(figures.plateau_error, 0.0, 1e-6);
    close(figures.end_inspiration, PIP, 1e-6);
}

#[test]
fn rows_of_the_fall_are_not_judged() {
    let fall = |t: f64, row: &mut Row| {
        if within(t, 0.9, 1.0) {
            row.phase = FALL;
        }
        true
    };
    let figures = Build {
        pressure: &|t| if within(t, 0.9, 1.0) { 40.0 } else { good(t) },
        edit: &fall,
        ..Build::default()
    }
    .figures();
    close(Some(figures.overshoot), 0.0, 0.0);
    close(figures.inspiratory_time_s, 1.0, 2e-3);
}

#[test]
fn without_set_points_nothing_is_said_about_errors() {
    let mut recording = Build::default().recording();
    recording.provenance.notes.push(NO_SET_POINT.to_owned());
    let verdict = judge(&recording, Judged::True, &Limits::default()).unwrap();
    let figures = &verdict.breaths[0].figures;
    assert_eq!(verdict.target, Target::Inferred);
    // As an earlier revision said it.
    let mut earlier = Build::default().recording();
    let note = "no set-point in the tables: target and PIP are the measured plateau, PEEP the first pressure";
    earlier.provenance.notes.push(note.to_owned());
    assert_eq!(judge(&earlier, Judged::True, &Limits::default()).unwrap().target, Target::Inferred);
    assert_eq!((figures.error, figures.plateau_error, figures.below_peep), (None, None, None));
    assert_eq!((verdict.accuracy_inspiration, verdict.accuracy_expiration), (None, None));
    close(figures.rise_ms, 80.0, 1e-3);
    for kind in [Kind::Plateau, Kind::Error, Kind::Baseline] {
        let limits = Limits::default().with(kind, Some(USUAL));
        let refused = judge(&recording, Judged::True, &limits).unwrap_err();
        assert!(refused.to_string().contains("no set-point"), "{refused}");
    }
    assert!(judge(&recording, Judged::True, &Limits::default().with(Kind::Overshoot, Some(USUAL))).is_ok());
}

#[test]
fn without_set_points_equal_breaths_are_one_setting_although_no_two_measurements_are_equal() {
    let mut recording = Build::default().recording();
    let breaths = recording.breaths();
    assert!(breaths.len() > 1);
    for (n, rows) in breaths.into_iter().enumerate() {
        let off = 0.1 * n as f32;
        recording.pip[rows.clone()].iter_mut().for_each(|pip| *pip += off);
        recording.peep[rows].iter_mut().for_each(|peep| *peep -= off);
    }
    let lungs =
        |recording: &Recording| judge(recording, Judged::True, &Limits::default()).unwrap().lungs.len();
    assert!(lungs(&recording) > 1, "set-points stand for themselves");
    recording.provenance.notes.push(NO_SET_POINT.to_owned());
    assert_eq!(lungs(&recording), 1);
}

#[test]
fn the_true_pressure_is_judged_unless_it_is_absent_or_unwanted() {
    let build = Build {
        extras: &[Extra::PressureTrue],
        edit: &|_, row| {
            row.pressure_true = Some(row.pressure);
            row.pressure += 2.5;
            true
        },
        ..Build::default()
    };
    let recording = build.recording();
    let plateau = |recording: &Recording, judged| {
        let verdict = judge(recording, judged, &Limits::default()).unwrap();
        (verdict.judged, verdict.breaths[0].figures.plateau_error.unwrap())
    };
    assert_eq!(plateau(&recording, Judged::True), (Judged::True, 0.0));
    assert_eq!(plateau(&recording, Judged::Measured), (Judged::Measured, 2.5));
    let without = Recording { pressure_true: None, ..recording };
    assert_eq!(plateau(&without, Judged::True), (Judged::Measured, 2.5));
}

#[test]
fn recordings_that_give_no_verdict_say_why() {
    let refused = |recording: &Recording| judge(recording, Judged::True, &Limits::default()).unwrap_err();
    let empty = Build { breaths: 0, ..Build::default() }.recording();
    assert_eq!(refused(&empty), VerdictError::NoBreath);
    let mut timeless = Build::default().recording();
    timeless.provenance.period_us = 0;
    assert_eq!(refused(&timeless), VerdictError::NoPeriod);
    let headless = Build { edit: &|t, _| t > 0.5, ..Build::default() }.recording();
    assert_eq!(refused(&headless), VerdictError::NoneJudged { breaths: 4, reason: Refusal::Start });
}

#[test]
fn exploration_is_reported() {
    let edit = |t: f64, row: &mut Row| {
        row.explore = if t < 0.25 - 1e-9 { 3.0 } else { 0.0 };
        true
    };
    close(Some(Build { edit: &edit, ..Build::default() }.verdict().explored), 0.25, 1e-9);
}

/// Any value, and now and then one that is no number.
fn value() -> impl Strategy<Value = f32> {
    prop_oneof![20 => -20.0f32..100.0, 1 => Just(f32::NAN), 1 => Just(5.0f32)]
}

proptest! {
    #[test]
    fn any_rows_give_finite_figures_or_a_reason(
        rows in prop::collection::vec((value(), value(), 0u8..3, 1u32..4, prop::bool::weighted(0.05)), 0..300),
        period_us in prop::sample::select(vec![250u32, 1_000, 10_000, 50_000]),
    ) {
        let mut recording =
            Recording::with_extras(Provenance::new(period_us, "test"), &[Extra::FlowIn, Extra::FlowOut]);
        let (mut breath, mut tick) = (0, 0);
        for (pressure, target, phase, step, starts) in rows {
            (breath, tick) = if starts { (breath + 1, 0) } else { (breath, tick + if step == 3 { 2 } else { 1 }) };
            // Mostly an inspiration at first, so that some breaths can be judged.
            let phase = if tick < 40 { INSPIRATION } else { phase };
            let flow = Some(0.01 * pressure);
            let row = Row { breath, tick, phase, target: target.abs(), pressure, pip: 25.0, peep: 5.0, ..Row::default() };
            recording.push(Row { flow_in: flow, flow_out: Some(0.2), ..row });
        }
        let limits = Limits::default().with(Kind::Overshoot, Some(Band { fixed: 2.0, percent: 0.0 }));
        if let Ok(verdict) = judge(&recording, Judged::True, &limits) {
            prop_assert_eq!(verdict.breaths.len() + verdict.unjudged.len(), recording.breaths().len());
            let text = serde_json::to_string(&verdict.breaths).unwrap();
            for breath in &verdict.breaths {
                let f = &breath.figures;
                let sizes = [Some(f.overshoot), f.error, f.rise_ms, f.undershoot, f.plateau_error, f.below_peep];
                prop_assert!(sizes.iter().flatten().all(|size| *size >= 0.0 && size.is_finite()), "{}", text);
                let others = [f.plateau_bias, f.slope, f.end_inspiration, f.end_expiration, breath.tidal_volume_ml];
                prop_assert!(others.iter().flatten().all(|value| value.is_finite()), "{}", text);
            }
            prop_assert!(verdict.sore_spots.iter().all(|spot| spot.severity > 1.0));
        }
    }
}
