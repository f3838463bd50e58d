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

#[test]
fn before_an_estimate_the_expiratory_flow_is_unknown() {
    let mut meter = BreathMeter::new(PERIOD_US);
    let (point, _) = meter.take(0, &sample(0, 2000), None);
    assert!(point.flow.is_nan() && point.volume.is_nan() && point.learned.is_nan());
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
