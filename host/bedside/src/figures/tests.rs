//! Tests of the figures: on breaths whose figures are known, and on the virtual bench.

use super::*;
use proptest::prelude::*;

const PERIOD_US: u32 = 1000;
/// 20 breaths a minute of 1 s inspiration.
const TICKS: u32 = 3000;
const INSPIRATION: u32 = 1000;

fn settings() -> Settings {
    Settings { pip: 20.0, peep: 5.0, rate: 20.0, ..Settings::default() }
}

/// A sample of a breath with a linear rise of 100 ms to 21 cmH2O.
fn sample(breath: u32, tick: u32) -> Sample {
    let inspires = tick < INSPIRATION;
    let pressure = if inspires { 5.0 + 16.0 * (tick as f32 / 100.0).min(1.0) } else { 5.0 };
    Sample {
        breath,
        tick,
        phase: if inspires { Phase::Inspiration } else { Phase::Expiration },
        target: if inspires { 20.0 } else { 5.0 },
        pressure,
        u_in: if inspires { 30.0 } else { 5.0 },
        u_out: !inspires,
        explore: 0.0,
        learned: 0.0,
        flow: None,
    }
}

/// Feeds breaths of these lengths, ticks; returns all figures.
fn run(meter: &mut BreathMeter, first_tick: u64, lengths: &[u32]) -> Vec<BreathFigures> {
    let settings = settings();
    let samples = lengths
        .iter()
        .zip(0..)
        .flat_map(|(length, breath)| (0..*length).map(move |tick| sample(breath, tick)));
    (first_tick..)
        .zip(samples)
        .filter_map(|(tick, sample)| meter.take(tick, &sample, Some(&settings)).1)
        .collect()
}

fn close(found: Option<f32>, expected: f32, tolerance: f32) {
    let found = found.expect("the figure is known");
    assert!((found - expected).abs() <= tolerance, "{found} is not {expected}");
}

#[test]
fn the_figures_of_a_known_breath() {
    let mut meter = BreathMeter::new(PERIOD_US);
    let figures = run(&mut meter, 700, &[TICKS; 3]);
    assert_eq!(figures.len(), 2, "the last one has not ended");
    let figures = figures[1];
    assert_eq!((figures.number, figures.triggered, figures.estimated), (1, false, true));
    close(figures.pip, 21.0, 1e-3);
    close(figures.plateau, 21.0, 1e-3);
    close(figures.peep, 5.0, 1e-3);
    close(figures.rate, 20.0, 1e-3);
    close(figures.rate_set, 20.0, 0.0);
    close(figures.ie, 2.0, 1e-3);
    close(figures.overshoot, 1.0, 1e-3);
    // From 10 to 90 % of 15 cmH2O at 160 cmH2O/s.
    close(figures.rise_ms, 75.0, 0.5);
    // 15 cmH2O falling to 0 in 94 ms, then 1 cmH2O.
    close(figures.error, 1.61, 0.02);
    // 0.303 L/s at 30 %, less than 8 % of it lost to back-pressure, and to the lag.
    close(figures.tidal_volume, 270.0, 20.0);
    close(figures.minute_volume, figures.tidal_volume.unwrap() * 0.02, 0.05);
    assert_eq!(figures.leak, None);
}

#[test]
fn an_inspiration_without_an_end_is_given_up_and_the_next_breath_has_figures() {
    let mut meter = BreathMeter::new(PERIOD_US);
    for tick in 0..70_000 {
        meter.take(tick, &Sample { tick: tick as u32, ..sample(0, 500) }, None);
    }
    assert!(meter.breath.is_none(), "it would fill the memory");
    assert_eq!(run(&mut meter, 70_000, &[TICKS; 3]).len(), 2);
}

#[test]
fn an_effort_ends_a_breath_early_and_the_next_one_is_triggered() {
    let figures = run(&mut BreathMeter::new(PERIOD_US), 0, &[TICKS, 2500, TICKS, TICKS]);
    let triggered: Vec<bool> = figures.iter().map(|figures| figures.triggered).collect();
    assert_eq!(triggered, [false, false, true]);
    close(figures[1].rate, 24.0, 1e-3);
}

#[test]
fn a_breath_with_a_gap_has_no_figures_and_the_next_one_has() {
    let mut meter = BreathMeter::new(PERIOD_US);
    assert_eq!(run(&mut meter, 0, &[1500]).len(), 0);
    let numbers: Vec<u32> =
        run(&mut meter, 1600, &[TICKS, TICKS]).iter().map(|figures| figures.number).collect();
    assert_eq!(numbers, [0], "the breath before the gap is not judged");
}

#[test]
fn a_breath_that_was_stopped_in_its_inspiration_has_no_figures() {
    let mut meter = BreathMeter::new(PERIOD_US);
    assert_eq!(run(&mut meter, 0, &[500, TICKS]).len(), 0);
}

/// A lung of this compliance, mL/cmH2O, and resistance, cmH2O/(L/s), behind the nominal valve.
fn breathe(compliance: f32, resistance: f32, breaths: u32) -> (Vec<BreathFigures>, Vec<Point>) {
    let (mut meter, mut points, mut figures) = (BreathMeter::new(PERIOD_US), Vec::new(), Vec::new());
    let (mut volume, mut flow) = (0.0_f32, 0.0_f32);
    for tick in 0..u64::from(breaths * TICKS) {
        let mut sample = sample((tick / u64::from(TICKS)) as u32, (tick % u64::from(TICKS)) as u32);
        let inspires = sample.phase == Phase::Inspiration;
        sample.pressure = if inspires { 5.0 + volume / compliance + resistance * flow } else { 5.0 };
        let (point, ended) = meter.take(tick, &sample, Some(&settings()));
        flow = if inspires { point.flow } else { -volume / compliance / resistance };
        volume += flow;
        points.push(point);
        figures.extend(ended);
    }
    (figures, points)
}

#[test]
fn resistance_and_compliance_are_those_of_the_lung() {
    let (figures, points) = breathe(20.0, 20.0, 4);
    let last = figures.last().unwrap();
    close(last.compliance, 20.0, 0.5);
    close(last.resistance, 20.0, 0.5);
    let end = points.last().unwrap();
    assert!(end.volume.abs() < 10.0, "{} mL are left of what went in", end.volume);
    assert!(points[(TICKS + INSPIRATION + 50) as usize].flow < -0.2, "it flows out");
}

/// Breaths of a lung of 20 cmH2O/(L/s) and 20 mL/cmH2O with this leak, L/s at 1 cmH2O, through a flow sensor that gives some readings.
fn sense(meter: &mut BreathMeter, leak: f32, read: fn(u64) -> bool) -> (Vec<BreathFigures>, Vec<Point>) {
    let (mut points, mut figures, mut volume) = (Vec::new(), Vec::new(), 0.0_f32);
    for tick in 0..u64::from(4 * TICKS) {
        let sample = sample((tick / u64::from(TICKS)) as u32, (tick % u64::from(TICKS)) as u32);
        let flow = (sample.pressure - 5.0 - volume / 20.0) / 20.0;
        volume += flow;
        let flow = read(tick).then_some(flow + leak * sample.pressure.sqrt());
        let (point, ended) = meter.take(tick, &Sample { flow, ..sample }, Some(&settings()));
        points.push(point);
        figures.extend(ended);
    }
    (figures, points)
}

#[test]
fn a_flow_sensor_measures_the_lung_and_a_known_leak_is_no_part_of_it() {
    let mut meter = BreathMeter::new(PERIOD_US);
    meter.leak(Some(0.02));
    let (figures, points) = sense(&mut meter, 0.02, |_| true);
    let last = figures.last().unwrap();
    assert!(!last.estimated);
    close(last.resistance, 20.0, 0.2);
    close(last.compliance, 20.0, 0.2);
    // 16 cmH2O into 20 mL/cmH2O, in two and a half time constants of 0.4 s but for the rise.
    close(last.tidal_volume, 287.0, 3.0);
    close(last.minute_volume, last.tidal_volume.unwrap() * 0.02, 0.05);
    // The root of the pressure is 4.55 for a third of the breath, and 2.24 then.
    close(last.leak, 0.02 * 60.0 * 3.0, 0.03);
    let [inspiration, end] = [TICKS + INSPIRATION - 1, 2 * TICKS - 1].map(|tick| points[tick as usize]);
    assert!((inspiration.volume - last.tidal_volume.unwrap()).abs() < 1.0, "the curve shows the figure");
    assert!(end.volume.abs() < 10.0, "{} mL are left of what went in", end.volume);
    assert!(
        (end.flow - 0.02 * 5.0_f32.sqrt()).abs() < 0.01,
        "the reading itself, with the leak: {}",
        end.flow
    );
}

#[test]
fn a_leak_that_is_not_known_is_neither_shown_nor_taken_off() {
    let mut meter = BreathMeter::new(PERIOD_US);
    let (figures, points) = sense(&mut meter, 0.02, |_| true);
    assert_eq!(figures.last().unwrap().leak, None);
    assert!(points[2 * TICKS as usize - 1].volume > 100.0, "the gas of the leak stays");
}

#[test]
fn a_breath_with_many_missing_readings_has_no_volume() {
    let mut meter = BreathMeter::new(PERIOD_US);
    let (figures, points) = sense(&mut meter, 0.0, |tick| tick % 5 != 4);
    let last = figures.last().unwrap();
    assert_eq!((last.tidal_volume, last.minute_volume, last.estimated), (None, None, false));
    assert!(points[4].flow.is_nan() && points[5].flow.is_finite());
    let (figures, _) = sense(&mut BreathMeter::new(PERIOD_US), 0.0, |tick| tick % 20 != 4);
    assert!(figures.last().unwrap().tidal_volume.is_some(), "few are missing");
}

#[test]
fn a_breath_that_begins_without_a_reading_is_estimated() {
    let (figures, _) = sense(&mut BreathMeter::new(PERIOD_US), 0.0, |tick| !tick.is_multiple_of(6000));
    let estimated: Vec<bool> = figures.iter().map(|figures| figures.estimated).collect();
    assert_eq!(estimated, [true, false, true]);
}

#[test]
fn the_learned_part_is_the_devices() {
    let sample = Sample { learned: 7.5, ..sample(0, 3) };
    assert!((BreathMeter::new(PERIOD_US).take(0, &sample, None).0.learned - 7.5).abs() < 1e-6);
}

#[test]
fn before_an_estimate_the_expiratory_flow_is_unknown() {
    let mut meter = BreathMeter::new(PERIOD_US);
    let (point, _) = meter.take(0, &sample(0, 2000), None);
    assert!(point.flow.is_nan() && point.volume.is_nan());
}

proptest! {
    #[test]
    fn no_readings_cause_a_panic_and_every_sample_passes_unchanged(
        rows in prop::collection::vec((0_u64..4, 0_u32..3, any::<u32>(), 0_u8..3), 1..300),
    ) {
        let (mut meter, mut tick) = (BreathMeter::new(PERIOD_US), 0);
        for (step, place, bits, phase) in rows {
            tick += step;
            let pressure = f32::from_bits(bits);
            let phase = [Phase::Inspiration, Phase::Fall, Phase::Expiration][usize::from(phase)];
            let sample = Sample { pressure, phase, ..sample(0, place) };
            let (point, _) = meter.take(tick, &sample, None);
            prop_assert_eq!(point.pressure.to_bits(), bits);
            prop_assert_eq!(point.phase, phase);
        }
    }
}
