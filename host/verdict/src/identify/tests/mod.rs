//! Lungs of the virtual bench, whose parameters are known, and the measured tables if available.

mod simulated;

use proptest::prelude::*;

use self::simulated::Simulated;
use super::estimate::Fits;
use super::*;
use data::import::{measured, measured_recording};
use data::provenance::Provenance;
use data::recording::{EXPIRATION, Extra, INSPIRATION, Row};
use plant::bench::{Bench, BenchConfig};

/// Long enough to breathe out completely at the highest R C, so that no volume remains in the lung.
const TICKS: u32 = 8_000;
const INSPIRATION_TICKS: u32 = 1_000;

/// Breaths with a constant command on a bench, with flow sensors at the ventilator that have an `offset` in L/s.
fn record(config: &BenchConfig, breaths: u32, command: f32, offset: f32) -> Recording {
    let mut recording =
        Recording::with_extras(Provenance::new(1_000, "test"), &[Extra::FlowIn, Extra::FlowOut]);
    let mut bench = Bench::new(config, 5.0, 1).unwrap();
    for (breath, tick) in (0..breaths).flat_map(|breath| (0..TICKS).map(move |tick| (breath, tick))) {
        let inspires = tick < INSPIRATION_TICKS;
        // Falling commands: a constant flow could not separate R from R2.
        let u_in =
            if inspires { command * (1.0 - 0.7 * tick as f32 / INSPIRATION_TICKS as f32) } else { 0.0 };
        let pressure = bench.step(u_in, !inspires);
        let truth = bench.truth();
        recording.push(Row {
            breath,
            tick,
            phase: if inspires { INSPIRATION } else { EXPIRATION },
            pressure,
            u_in,
            flow_in: Some(truth.flow_valve as f32 + offset),
            flow_out: Some((truth.flow_expiratory + truth.flow_leak + truth.flow_relief) as f32),
            ..Row::default()
        });
    }
    recording
}

fn lung(resistance: f64, compliance: f64) -> BenchConfig {
    let mut config = BenchConfig::paper(resistance, compliance);
    // Without its inflection the lung follows the equation of motion.
    config.lung.first.upper_inflection_cmh2o = 200.0;
    config
}

fn identified(config: &BenchConfig, offset: f32) -> Identified {
    identify(&record(config, 4, 35.0, offset)).unwrap().remove(0)
}

/// Whether the compliance of circuit and lung, and the drop at the flow of the inspirations, are those of this lung; R and
/// R2 individually are less certain.
fn is_right(found: &BehindCircuit, resistance: f64, compliance: f64) -> bool {
    let sum = found.compliance.value + found.circuit_compliance;
    let q = found.inspiratory_flow;
    let drop = found.resistance.value * q + found.turbulence.value * q * q;
    let expected = resistance * q * (1.0 + 0.1 * q);
    (sum / (compliance + 1.5) - 1.0).abs() < 0.08 && (drop - expected).abs() < 0.1 * expected + 0.15
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(12))]

    #[test]
    fn lungs_of_the_bench_are_found_through_noise_circuit_and_drift(
        resistance in 5.0..50.0, compliance in 10.0..50.0, offset in -0.03_f32..0.03
    ) {
        let found = identified(&lung(resistance, compliance), offset).behind_circuit;
        prop_assert!(is_right(&found, resistance, compliance), "{found:?}");
        // Behind a low resistance, lung and circuit cannot be distinguished.
        if resistance > 15.0 {
            prop_assert!((found.circuit_compliance - 1.5).abs() < 0.7, "{found:?}");
        }
    }
}

#[test]
fn drift_of_the_flow_sensors_is_found_and_taken_out() {
    let (without, with) = (identified(&lung(20.0, 20.0), 0.0), identified(&lung(20.0, 20.0), 0.05));
    assert!((with.offset.value - without.offset.value - 0.05).abs() < 0.001, "{:?}", with.offset);
    assert!((with.compliance.value / without.compliance.value - 1.0).abs() < 1e-3, "{with:?}");
    let [with, without] = [with, without].map(|lung| lung.uncorrected_compliance.unwrap());
    assert!(with > 1.05 * without, "{with} {without}");
}

#[test]
fn a_circuit_that_is_not_taken_out_makes_a_high_resistance_small() {
    let found = identified(&lung(50.0, 10.0), 0.0);
    assert!(found.behind_circuit.residual < 0.8 * found.residual, "{found:?}");
    let q = found.behind_circuit.inspiratory_flow;
    let drop = found.resistance.value * q + found.turbulence.value * q * q;
    assert!(is_right(&found.behind_circuit, 50.0, 10.0) && drop < 0.85 * 50.0 * q, "{found:?}");
}

#[test]
fn breaths_that_are_cut_off_and_the_last_are_left_out() {
    let mut recording = record(&lung(20.0, 20.0), 4, 35.0, 0.0);
    let whole = lungs(&recording).unwrap();
    assert_eq!(whole[0].breaths.iter().map(|(rows, _)| rows.start).collect::<Vec<_>>(), [0, 8_000, 16_000]);
    // A missing tick in the second breath.
    recording.tick[9_000..16_000].iter_mut().for_each(|tick| *tick += 1);
    assert_eq!(lungs(&recording).unwrap()[0].breaths.len(), 2);
}

#[test]
fn a_change_of_group_is_another_lung() {
    let mut recording = record(&lung(20.0, 20.0), 4, 35.0, 0.0);
    recording.provenance.groups = vec!["a".into(), "b".into()];
    recording.group = Some((0..recording.len()).map(|row| u32::from(row >= 16_000)).collect());
    let found = identify(&recording).unwrap();
    assert_eq!(
        found.iter().map(|lung| (lung.id.to_string(), lung.breaths)).collect::<Vec<_>>(),
        [("a".to_owned(), 1), ("b".to_owned(), 1)]
    );
    let one = &found[0].resistance;
    assert!(
        one.low < one.value && one.value < one.high,
        "a single breath has an interval of its own: {one:?}"
    );
}

#[test]
fn without_flow_or_breaths_it_is_said_what_is_missing() {
    let mut recording = record(&lung(20.0, 20.0), 1, 35.0, 0.0);
    assert!(matches!(identify(&recording), Err(IdentifyError::NoBreath(0))));
    recording.flow_in = None;
    assert!(matches!(identify(&recording), Err(IdentifyError::NoFlow)));
}

#[test]
fn a_bench_made_from_an_identified_bench_is_that_bench() {
    let original = lung(20.0, 20.0);
    let recording = record(&original, 4, 35.0, 0.02);
    let found = identify(&recording).unwrap().remove(0);
    let bench = bench::bench(&found, &recording).unwrap();
    assert!((bench.lung.first.compliance_ml_per_cmh2o / 20.0 - 1.0).abs() < 0.06, "{bench:?}");
    assert!((bench.sensor.quantum_cmh2o - original.sensor.quantum_cmh2o).abs() < 0.005, "{bench:?}");
    assert!((bench.sensor.noise_sd_cmh2o - original.sensor.noise_sd_cmh2o).abs() < 0.03, "{bench:?}");
    let text = bench::to_toml(&bench, &found);
    assert_eq!(BenchConfig::from_toml(&text).unwrap(), bench);
    // The same commands give the same pressures on both.
    let ours = record(&BenchConfig { unit: original.unit, ..bench }, 2, 35.0, 0.0);
    let error: f32 = ours.pressure.iter().zip(&recording.pressure).map(|(a, b)| (a - b).abs()).sum::<f32>()
        / ours.len() as f32;
    assert!(error < 0.5, "{error}");
}

#[test]
fn measured_lungs_have_their_nominal_compliance_once_the_drift_is_corrected() {
    let Some(paths) = measured() else { return };
    let folder = tempfile::tempdir().unwrap();
    let recording = measured_recording(&[paths[0].clone(), paths[2].clone()], folder.path());
    let found = identify(&recording).unwrap();
    assert_eq!(found.len(), 16);
    for lung in &found {
        let row = lung.id.run.as_ref().and_then(|run| run.run.as_ref()).unwrap();
        let row: usize = row.parse().unwrap();
        let nominal = lung.id.nominal_compliance.unwrap();
        println!("{} nominal {nominal} {lung:?}", lung.id);
        if row <= 7 {
            assert!((lung.compliance.value / nominal - 1.0).abs() < 0.1, "{lung:?}");
            assert!(
                lung.compliance.low < lung.compliance.value && lung.compliance.value < lung.compliance.high
            );
        }
        // Resistors of 50 cmH2O/(L/s) are parabolic only behind the circuit.
        if lung.id.nominal_resistance.is_some_and(|r| r > 40.0) {
            let behind = lung.behind_circuit.turbulence.value;
            assert!(behind > 0.0 && lung.turbulence.value < behind, "{lung:?}");
            assert!(lung.behind_circuit.residual < 0.85 * lung.residual, "{lung:?}");
        }
        bench::bench(lung, &recording).unwrap();
    }
    // Compliances without drift correction.
    for (row, uncorrected) in [(1, 57.0), (2, 56.0), (4, 22.0), (5, 20.0), (7, 11.0)] {
        let lung = found.iter().find(|lung| lung.id.to_string() == format!("CT_AIR:{row}")).unwrap();
        assert!((lung.uncorrected_compliance.unwrap() / uncorrected - 1.0).abs() < 0.03, "{lung:?}");
    }
}

/// A recording whose flow arrives this many ticks late.
fn with_late_flow(mut recording: Recording, ticks: usize) -> Recording {
    for flow in [&mut recording.flow_in, &mut recording.flow_out].into_iter().flatten() {
        flow.rotate_right(ticks);
    }
    recording
}

fn remarks(recording: &Recording) -> String {
    identify(recording).unwrap().remove(0).remarks.join("\n")
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(12))]

    #[test]
    fn a_sound_recording_has_no_remark_and_one_whose_late_flow_makes_it_wrong_has(
        resistance in 5.0..50.0, compliance in 10.0..50.0, offset in -0.03_f32..0.03, late in 15_usize..60
    ) {
        let sound = record(&lung(resistance, compliance), 4, 35.0, offset);
        prop_assert_eq!(remarks(&sound), "");
        let found = identify(&with_late_flow(sound, late)).unwrap().remove(0);
        let right = is_right(&found.behind_circuit, resistance, compliance);
        prop_assert!(right || !found.remarks.is_empty(), "{} {} {} {:?}", resistance, compliance, late, found);
    }

    #[test]
    fn a_leak_is_named_with_the_compliance_behind_it(
        resistance in 5.0..40.0, compliance in 15.0..50.0, leak in 0.002_f32..0.01
    ) {
        let mut recording = record(&lung(resistance, compliance), 4, 35.0, 0.0);
        let pressures = recording.pressure.clone();
        // The flow sensors see what escapes at the mask; the lung does not.
        let inflow = recording.flow_in.as_mut().unwrap();
        inflow.iter_mut().zip(&pressures).for_each(|(flow, pressure)| *flow += leak * pressure.max(0.0));
        let found = identify(&recording).unwrap().remove(0);
        let text = found.remarks.join("\n");
        let named = text.split("with it C is ").nth(1).and_then(|rest| rest.split(' ').next());
        // A leak that hardly changes the compliance is worth no remark.
        let named = named.map_or(found.behind_circuit.compliance.value, |named| named.parse().unwrap());
        prop_assert!((named / compliance - 1.0).abs() < 0.1, "{} {} {} {:?}", resistance, compliance, leak, found);
        let (truth, named) = (1e3 * f64::from(leak), found.leak);
        let near = (named.value / truth - 1.0).abs() < 0.15;
        prop_assert!(near || (named.low <= truth && truth <= named.high), "{} {:?}", leak, named);
    }
}

#[test]
fn a_late_flow_is_named_with_its_delay() {
    let sound = record(&lung(20.0, 20.0), 4, 35.0, 0.0);
    for late in [20, 32, 48] {
        let found = identify(&with_late_flow(sound.clone(), late)).unwrap().remove(0);
        assert!(found.remarks.concat().contains("ms late"), "{found:?}");
        // The bench's pressure sensor lags by a few milliseconds itself.
        assert!((found.flow_delay_ms.value - late as f64).abs() <= 8.0, "{late}: {:?}", found.flow_delay_ms);
        assert!(is_right(&found.behind_circuit, 20.0, 20.0), "{late}: {found:?}");
    }
}

#[test]
fn a_resistance_that_falls_with_the_flow_is_none() {
    let mut recording = record(&lung(20.0, 20.0), 4, 35.0, 0.0);
    for flow in [&mut recording.flow_in, &mut recording.flow_out].into_iter().flatten() {
        for q in flow.iter_mut() {
            *q = 2.0 * *q * q.abs();
        }
    }
    assert!(remarks(&recording).contains("R2 is negative"), "{}", remarks(&recording));
}

#[test]
fn what_no_cause_explains_is_named_by_its_residual() {
    let mut recording = record(&lung(20.0, 20.0), 4, 35.0, 0.0);
    // The test lung is shaken while it rests: a pressure that no flow makes.
    let rests = |row: usize| row as u32 % TICKS > TICKS / 2;
    // Whole cycles, so that neither the mean nor the offset moves.
    let shake = |row: usize| 1.5 * (row as f32 * std::f32::consts::TAU * 2.0 / (TICKS / 2) as f32).sin();
    let pressures = recording.pressure.iter_mut().enumerate();
    pressures.filter(|(row, _)| rests(*row)).for_each(|(row, pressure)| *pressure += shake(row));
    assert!(remarks(&recording).contains("far above the pressure's noise"), "{}", remarks(&recording));
}

#[test]
fn a_sample_period_beside_a_short_time_constant_is_named() {
    let fine = record(&lung(5.0, 10.0), 4, 35.0, 0.0);
    let mut coarse =
        Recording::with_extras(Provenance::new(40_000, "test"), &[Extra::FlowIn, Extra::FlowOut]);
    for row in (0..fine.len()).step_by(40) {
        coarse.push(Row { tick: fine.tick[row] / 40, ..fine.row(row).unwrap() });
    }
    assert!(remarks(&coarse).contains("the sample period of 40 ms is long"), "{}", remarks(&coarse));
}

#[test]
fn a_breath_unlike_all_others_is_left_out_and_counted() {
    let mut recording = record(&lung(20.0, 20.0), 8, 35.0, 0.0);
    let rows = recording.breaths()[3].clone();
    for flow in [&mut recording.flow_in, &mut recording.flow_out].into_iter().flatten() {
        flow[rows.clone()].iter_mut().for_each(|flow| *flow *= 2.0);
    }
    let found = identify(&recording).unwrap().remove(0);
    assert!((found.compliance.value / 21.5 - 1.0).abs() < 0.05, "{found:?}");
    assert_eq!((found.breaths, found.breaths_left_out), (6, 1));
    assert!(found.remarks.join("").contains("1 of 7 breaths left out"), "{:?}", found.remarks);
}

#[test]
fn one_long_breath_is_not_the_measure_of_the_others() {
    let mut recording = record(&lung(20.0, 20.0), 6, 35.0, 0.0);
    // The third breath swallows the fourth.
    recording.breath[24_000..32_000].iter_mut().for_each(|breath| *breath = 2);
    recording.tick[24_000..32_000].iter_mut().for_each(|tick| *tick += 8_000);
    assert!(identify(&recording).unwrap()[0].breaths >= 3);
}

/// Shares of the draws whose intervals contain the true R, C, leak and delay of the flow.
fn coverage(draws: impl Iterator<Item = Simulated>) -> [f64; 4] {
    let (mut hits, mut count) = ([0.0; 4], 0.0);
    for truth in draws {
        let found = identify(&truth.record()).unwrap().remove(0);
        let pairs = [
            (found.resistance, truth.resistance),
            (found.compliance, truth.compliance),
            (found.leak, truth.leak),
            (found.flow_delay_ms, 1e3 * truth.late_s),
        ];
        for (hits, (estimate, value)) in hits.iter_mut().zip(pairs) {
            *hits += f64::from(u8::from(estimate.low <= value && value <= estimate.high));
        }
        count += 1.0;
    }
    hits.map(|hits| hits / count)
}

#[test]
fn intervals_contain_the_truth_in_nine_of_ten_recordings_with_flaws() {
    let found = coverage((0..300).map(simulated::flawed));
    println!("R, C, leak, delay: {found:?}");
    assert!(found.iter().all(|share| *share >= 0.9), "{found:?}");
}

#[test]
fn intervals_contain_the_truth_in_nine_of_ten_sound_recordings() {
    let found = coverage((0..100).map(simulated::sound));
    println!("R, C, leak, delay: {found:?}");
    assert!(found.iter().all(|share| *share >= 0.9), "{found:?}");
}

#[test]
fn intervals_of_few_samples_are_wide_enough() {
    let coarse = |seed| Simulated { period_s: 0.04, ..simulated::sound(seed) };
    let found = coverage((0..100).map(coarse));
    assert!(found.iter().all(|share| *share >= 0.9), "{found:?}");
}

/// The cycles of a recording's only lung.
fn cycles(recording: &Recording) -> Vec<Cycle> {
    lungs(recording).unwrap().remove(0).breaths.into_iter().map(|(_, cycle)| cycle).collect()
}

#[test]
fn an_interval_holds_what_half_of_the_rows_gives() {
    for seed in 0..40 {
        let truth = Simulated { period_s: 0.02, noise: [0.01, 0.0], ..simulated::sound(seed) };
        let full = cycles(&truth.record());
        let half: Vec<Cycle> = full.iter().map(Cycle::thinned).collect();
        let fits = |cycles: &[Cycle]| Fits::new(&cycles.iter().collect::<Vec<_>>(), &FlowPath::default());
        for place in 1..=2 {
            let [full, half] = [&full, &half].map(|cycles| fits(cycles).coefficient(place).unwrap());
            assert!(full.low <= half.value && half.value <= full.high, "{seed} {place}: {full:?} {half:?}");
        }
    }
}

#[test]
fn an_error_that_every_breath_repeats_is_not_averaged_out() {
    let truth = Simulated { noise: [0.0; 2], breaths: 20, period_s: 0.005, ..simulated::sound(3) };
    let mut recording = truth.record();
    // Not in the form of the equation: no breath differs from the others.
    for row in 0..recording.len() {
        let phase = f64::from(recording.tick[row]) * truth.period_s / 0.3;
        recording.pressure[row] += 0.5 * (std::f64::consts::TAU * phase).sin() as f32;
    }
    let full = cycles(&recording);
    let fits = Fits::new(&full.iter().collect::<Vec<_>>(), &FlowPath::default());
    for (place, value) in [(1, 1.0 / truth.compliance), (2, truth.resistance)] {
        let found = fits.coefficient(place).unwrap();
        assert!(found.low <= value && value <= found.high, "{place}: {found:?} {value}");
    }
}

#[test]
fn breaths_with_an_effort_of_the_patient_are_left_out() {
    let (mut left_out, mut worst) = (0, 0.0_f64);
    for seed in 0..20 {
        let truth = Simulated { efforts: (0.2, 3.0), breaths: 20, ..simulated::sound(seed) };
        let found = identify(&truth.record()).unwrap().remove(0);
        left_out += found.left_out.iter().filter(|left_out| left_out.why.contains("residual")).count();
        worst = worst.max((found.compliance.value / truth.compliance - 1.0).abs());
    }
    assert!(left_out > 20 && worst < 0.05, "{left_out} {worst}");
}

#[test]
fn a_clean_recording_gives_r_and_c_within_a_hundredth() {
    for seed in 0..40 {
        let truth =
            Simulated { noise: [0.02, 0.0], period_s: 0.005, turbulence: 0.0, ..simulated::sound(seed) };
        let found = identify(&truth.record()).unwrap().remove(0);
        let off = |found: Estimate, value: f64| (found.value / value - 1.0).abs();
        let off = (off(found.resistance, truth.resistance), off(found.compliance, truth.compliance));
        assert!(off.0 < 0.01 && off.1 < 0.01, "{off:?} {truth:?} {found:?}");
    }
}

#[test]
fn a_bench_made_from_a_leaking_lung_leaks() {
    let recording = Simulated { leak: 5.0, ..simulated::sound(2) }.record();
    let found = identify(&recording).unwrap().remove(0);
    let leak = bench::bench(&found, &recording).unwrap().circuit.leak_l_per_s_at_30_cmh2o;
    assert!((leak / 0.15 - 1.0).abs() < 0.1, "{leak}");
}

#[test]
fn every_breath_that_is_left_out_has_its_reason() {
    let mut recording = Simulated { breaths: 9, ..simulated::sound(1) }.record();
    let breaths = recording.breaths();
    let rows = breaths[2].clone();
    recording.flow_in.as_mut().unwrap()[rows].iter_mut().for_each(|flow| *flow *= 2.0);
    recording.tick[breaths[4].start + 9..breaths[4].end].iter_mut().for_each(|tick| *tick += 1);
    let found = identify(&recording).unwrap().remove(0);
    let left_out: Vec<_> = found.left_out.iter().map(|left_out| (left_out.breath, left_out.why)).collect();
    assert_eq!(left_out, [(2, "compliance unlike the others"), (4, "rows are missing")]);
    assert_eq!(found.each_breath.iter().map(|one| one.breath).collect::<Vec<_>>(), [0, 1, 3, 5, 6, 7]);
    assert_eq!(found.breaths_left_out, 2);
}
