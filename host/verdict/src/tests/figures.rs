//! Synthetic breaths with known figures.

use super::*;
use score::evaluate::score_breath;
use shared::settings::Settings;
use std::f64::consts::TAU;

#[test]
fn a_ramp_rises_in_eight_tenths_of_its_time_at_any_sample_rate() {
    for period_us in [1_000, 4_000, 10_000] {
        let figures = Build { period_us, ..Build::default() }.figures();
        close(figures.rise_ms, 80.0, 1e-3);
        assert!(figures.reached && figures.remarks.is_empty(), "{figures:?}");
    }
}

#[test]
fn error_overshoot_and_plateau_error_are_those_of_an_evaluation() {
    let curve = |t: f64| if t < 1.0 { 24.0 - 19.0 * (-t / 0.05).exp() + (TAU * 3.0 * t).sin() } else { PEEP };
    let figures = figures_of(curve);
    let pressure: Vec<f64> = (0..1000).map(|n| f64::from(curve(f64::from(n) * 1e-3) as f32)).collect();
    let settings = Settings { pip: 25.0, peep: 5.0, ..Settings::default() };
    let score = score_breath(&settings, 1e-3, &pressure, &[PIP; 1000]);
    close(figures.error, score.score, 1e-9);
    close(figures.rise_ms, score.rise_ms, 1e-9);
    close(figures.plateau_error, score.plateau_error, 1e-9);
    close(Some(figures.overshoot), score.overshoot, 1e-9);
}

#[test]
fn overshoot_has_its_size_and_time() {
    let figures = figures_of(|t| if (0.249..0.2505).contains(&t) { 28.5 } else { good(t) });
    assert_eq!((figures.overshoot, figures.peak), (3.5, 28.5));
    close(Some(figures.peak_at_s), 0.249, 1e-9);
    close(Some(figures_of(|t| good(t).min(24.0)).overshoot), 0.0, 0.0);
}

#[test]
fn undershoot_counts_after_the_first_peak_only() {
    let figures = figures_of(|t| match t {
        t if (0.2..0.25).contains(&t) => 27.0,
        t if (0.3..0.32).contains(&t) => 23.2,
        t => good(t),
    });
    close(figures.undershoot, 1.8, 1e-5);
    close(figures.undershoot_at_s, 0.3, 1e-9);
    let rising = figures_of(|t| if t < 1.0 { 25.0 - 20.0 * (-t / 0.1).exp() } else { PEEP });
    assert_eq!((rising.undershoot, rising.undershoot_at_s), (Some(0.0), None));
}

#[test]
fn a_plateau_has_bias_error_and_slope() {
    let figures = figures_of(|t| if (0.7..1.0).contains(&t) { 24.0 + 4.0 * (t - 0.7) } else { good(t) });
    close(figures.slope, 4.0, 1e-4);
    // From 24 to 25.2 cmH2O: one below, the rest above; the last sample is at 0.999 s.
    close(figures.plateau_bias, -0.402, 1e-3);
    close(figures.plateau_error, 0.434, 1e-3);
    close(figures.end_inspiration, 25.098, 1e-3);
}

#[test]
fn an_oscillation_has_swings_size_and_frequency() {
    let ringing =
        |t: f64| if (0.1..1.0).contains(&t) { 25.0 + 1.5 * (TAU * 5.0 * (t - 0.1)).sin() } else { good(t) };
    for period_us in [1_000, 10_000] {
        let swings = Build { period_us, pressure: &ringing, ..Build::default() }.figures().swings.unwrap();
        assert_eq!(swings.count, 9);
        close(Some(swings.size), 3.0, 1e-5);
        close(swings.frequency, 5.0, 1e-6);
    }
    assert_eq!(figures_of(good).swings.unwrap().count, 0);
}

#[test]
fn the_expiration_has_its_end_and_its_lowest_pressure() {
    let figures = figures_of(|t| match t {
        t if (1.3..1.31).contains(&t) => 2.5,
        t if t >= 2.9495 => 6.25,
        t => good(t),
    });
    close(figures.end_expiration, 6.25, 1e-6);
    close(figures.below_peep, 2.5, 1e-6);
    close(figures.below_peep_at_s, 1.3, 1e-9);
}

#[test]
fn the_end_of_a_phase_is_its_last_50_ms() {
    let late = |from: f64| figures_of(move |t| if (from..1.0).contains(&t) { 30.0 } else { good(t) });
    close(late(0.9495).end_inspiration, 30.0, 1e-6);
    close(late(0.9505).end_inspiration, 29.9, 1e-6);
    let low = figures_of(|t| if t >= 2.9505 { 4.0 } else { good(t) });
    close(low.end_expiration, 4.02, 1e-5);
}

#[test]
fn times_are_measured_at_half_of_the_way() {
    let figures = figures_of(good);
    // Up at 0.05 s; at 1.05 s the pressure is at half, a tick later below it.
    close(figures.inspiratory_time_s, 1.0, 2e-3);
    close(Some(figures.inspiration_s), 1.0, 1e-9);
    close(figures.breath_s, 3.0, 1e-9);
    let dip = figures_of(|t| if (0.5..0.52).contains(&t) { 6.0 } else { good(t) });
    close(dip.inspiratory_time_s, 1.0, 2e-3);
}

#[test]
fn a_rise_that_does_not_end_is_said_to() {
    let low = figures_of(|t| good(t).min(22.9));
    assert!(!low.reached && low.rise_ms.is_none() && low.swings.is_none() && low.undershoot.is_none());
    assert!(remarked(&low, "does not reach 90 %"));
    close(low.plateau_error, 2.1, 1e-6);
    assert!(figures_of(|t| good(t).min(23.01)).reached);
}

#[test]
fn a_breath_that_starts_high_has_no_rise_time() {
    let stacked = figures_of(|t| good(t).max(7.0));
    assert!(stacked.reached && stacked.rise_ms.is_none());
    assert!(remarked(&stacked, "above 10 % of the way at the start"));
    assert!(figures_of(|t| good(t).max(6.99)).rise_ms.is_some());
}

#[test]
fn flows_give_volume_and_peak_flow_without_their_drift() {
    let build = Build {
        extras: &[Extra::FlowIn, Extra::FlowOut],
        edit: &|t, row| {
            // 0.5 L/s for 1 s in, 0.25 L/s for 2 s out; the inflow sensor is off by 0.03 L/s.
            row.flow_in = Some(0.03 + if t < 1.0 - 1e-9 { 0.5 } else { 0.0 });
            row.flow_out = Some(if t < 1.0 - 1e-9 { 0.0 } else { 0.25 });
            true
        },
        ..Build::default()
    };
    let breath = build.verdict().breaths.remove(0);
    close(breath.tidal_volume_ml, 500.0, 1.0);
    close(breath.peak_flow_l_min, 30.0, 0.01);
    let without = Build::default().verdict().breaths.remove(0);
    assert_eq!((without.tidal_volume_ml, without.peak_flow_l_min), (None, None));
}
