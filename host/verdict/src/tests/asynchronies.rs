//! Asynchronies: found where they are, over drawn lungs, noise, rates and sample rates, and nowhere else.

use super::patient::{Case, Effort};
use super::*;
use data::import::{measured, measured_recording};
use plant::bench::{BenchConfig, FlowSensorConfig, PatientConfig};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use shared::breath::paper_settings;
use shared::control::pid::KNOWN_GOOD;
use shared::settings::Settings;

/// Drawn cases of each kind, and breaths of each.
const CASES: u64 = 60;
const BREATHS: usize = 12;

/// Starts, efforts, and the breaths that have events.
#[derive(Default)]
struct Script {
    starts: Vec<f64>,
    efforts: Vec<Effort>,
    events: Vec<u32>,
}

fn found(recording: &Recording) -> Asynchronies {
    judge(recording, Judged::True, &Limits::default()).unwrap().asynchronies.expect("there is flow")
}

/// Plays scripts of drawn cases: share of the events that are found, and of the other breaths (of all four kinds) that
/// have something wrongly found.
fn rates(kind: Asynchrony, script: impl Fn(&mut Case, &mut ChaCha8Rng) -> Script) -> (f64, f64) {
    let (mut events, mut hits, mut others, mut wrong) = (0, 0, 0, 0);
    for seed in 0..CASES {
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        let mut case = Case::draw(&mut random);
        let script = script(&mut case, &mut random);
        let found = found(&case.record(&script.starts, &script.efforts, seed));
        events += script.events.len();
        others += found.checked - script.events.len();
        for count in &found.kinds {
            let right =
                count.breaths.iter().filter(|b| count.kind == kind && script.events.contains(b)).count();
            hits += right;
            wrong += count.breaths.len() - right;
            if count.breaths.len() > right {
                println!("{kind:?} case {seed} {case:?}: {count:?}, events {:?}", script.events);
            }
        }
    }
    let rates = (hits as f64 / events.max(1) as f64, wrong as f64 / others as f64);
    println!("{kind:?}: {hits} of {events} found, {wrong} of {others} others wrong");
    rates
}

/// Starts by the clock.
fn clocked(case: &Case) -> Vec<f64> {
    (0..BREATHS).map(|n| 1.0 + n as f64 * case.interval_s).collect()
}

#[test]
fn passive_lungs_have_none() {
    let script = |case: &mut Case, _: &mut ChaCha8Rng| Script { starts: clocked(case), ..Script::default() };
    assert!(rates(Asynchrony::MissedEffort, script).1 <= 0.0);
}

#[test]
fn a_change_of_the_rate_is_none() {
    let script = |case: &mut Case, random: &mut ChaCha8Rng| {
        let (mut at, faster) = (1.0, random.random_range(0.45..0.8));
        let interval = |n: usize| if (4..9).contains(&n) { faster } else { 1.0 } * case.interval_s;
        let mut next = |n: usize| {
            at += interval(n);
            at
        };
        let starts = (0..BREATHS).map(&mut next).collect();
        Script { starts, ..Script::default() }
    };
    assert!(rates(Asynchrony::AutoTrigger, script).1 <= 0.0);
}

#[test]
fn patients_who_start_their_breaths_have_none() {
    let script = |case: &mut Case, random: &mut ChaCha8Rng| {
        let (mut script, mut at) = (Script::default(), 1.0);
        for _ in 0..BREATHS {
            let peak = random.random_range(5.0..10.0);
            script.starts.push(at);
            // A trigger needs some muscle pressure, cmH2O; the effort lasts as long as the inspiration or longer.
            let (trigger, longer) = (random.random_range(1.0..2.0), random.random_range(1.0..1.2));
            let part = f64::asin(trigger / peak) / std::f64::consts::FRAC_PI_2;
            let for_s = longer * case.inspiration_s / (1.0 - part);
            script.efforts.push(Effort { at_s: at - part * for_s, for_s, peak });
            at += case.interval_s * random.random_range(0.65..1.3);
        }
        script
    };
    assert!(rates(Asynchrony::AutoTrigger, script).1 <= 0.02);
}

#[test]
fn missed_efforts_are_found() {
    let script = |case: &mut Case, random: &mut ChaCha8Rng| {
        let mut script = Script { starts: clocked(case), ..Script::default() };
        for n in (2..BREATHS as u32).step_by(3) {
            let start = script.starts[n as usize] + case.inspiration_s;
            let room = case.interval_s - case.inspiration_s - 1.0;
            if room < 0.5 {
                continue;
            }
            let for_s = random.random_range(0.3..0.6);
            let at_s = start + 0.4 + random.random_range(0.0..1.0) * (room - 0.2 - 0.5 * for_s).max(0.0);
            script.efforts.push(Effort { at_s, for_s, peak: random.random_range(5.0..12.0) });
            script.events.push(n);
        }
        script
    };
    let (sensitivity, wrong) = rates(Asynchrony::MissedEffort, script);
    assert!(sensitivity >= 0.85 && wrong <= 0.01, "{sensitivity} {wrong}");
}

#[test]
fn double_triggers_are_found() {
    let script = |case: &mut Case, random: &mut ChaCha8Rng| {
        let (mut script, mut at, mut breath) = (Script::default(), 1.0, 0);
        for n in 0..BREATHS {
            let double = n % 4 == 2;
            script.starts.push(at);
            let second_s = case.inspiration_s * if double { random.random_range(1.15..1.45) } else { 0.0 };
            let for_s = 0.12 + second_s + case.inspiration_s;
            script.efforts.push(Effort { at_s: at - 0.12, for_s, peak: random.random_range(4.0..10.0) });
            breath += 1;
            if double {
                at += second_s;
                script.starts.push(at);
                script.events.push(breath);
                breath += 1;
            }
            at += case.interval_s * random.random_range(0.9..1.1);
        }
        script
    };
    let (sensitivity, wrong) = rates(Asynchrony::DoubleTrigger, script);
    assert!(sensitivity >= 0.95 && wrong <= 0.01, "{sensitivity} {wrong}");
}

#[test]
fn delayed_cycling_is_found() {
    let script = |case: &mut Case, random: &mut ChaCha8Rng| {
        let mut script = Script { starts: clocked(case), ..Script::default() };
        for n in (2..BREATHS as u32).step_by(3) {
            let for_s = (0.5 * case.inspiration_s).min(0.5);
            let at_s = script.starts[n as usize] + case.inspiration_s - for_s;
            script.efforts.push(Effort { at_s, for_s, peak: -random.random_range(6.0..15.0) });
        }
        // A lung that still fills takes up an effort without a rise of the pressure.
        let clean = Case { noise: (0.0, 0.0), ..*case }.record(&script.starts, &script.efforts, 0);
        let pip = case.peep + case.drive;
        let risen =
            |rows: &Range<usize>| clean.pressure[rows.clone()].iter().any(|p| f64::from(*p) > pip + 1.5);
        let breaths = clean.breaths();
        script.events = (0..BREATHS as u32).filter(|n| risen(&breaths[*n as usize])).collect();
        script
    };
    let (sensitivity, wrong) = rates(Asynchrony::DelayedCycling, script);
    // Smaller rises than 1.5 cmH2O count as wrong here.
    assert!(sensitivity >= 0.8 && wrong <= 0.03, "{sensitivity} {wrong}");
}

/// Every third to eighth breath is early, without an effort or, if `all_efforts`, with one that lasts for `lasts` inspirations.
fn early_breaths(case: &Case, random: &mut ChaCha8Rng, all_efforts: bool, lasts: f64) -> Script {
    let (mut script, mut at, every) = (Script::default(), 1.0, random.random_range(3..=8));
    for n in 0..3 * every {
        script.starts.push(at);
        if n % every == every - 1 && !all_efforts {
            script.events.push(n);
        } else {
            let for_s = 0.12 + lasts * case.inspiration_s;
            script.efforts.push(Effort { at_s: at - 0.12, for_s, peak: random.random_range(3.0..10.0) });
        }
        let next_is_early = n % every == every - 2;
        let share =
            if next_is_early { random.random_range(0.4..0.75) } else { random.random_range(0.95..1.1) };
        at += case.inspiration_s + share * (case.interval_s - case.inspiration_s);
    }
    script
}

/// Frequency, Hz, and amplitudes, L/s and cmH2O, of a heart's oscillation.
fn heart(random: &mut ChaCha8Rng) -> [f64; 3] {
    [random.random_range(1.0..1.5), random.random_range(0.01..0.03), random.random_range(0.1..0.4)]
}

#[test]
fn early_breaths_without_efforts_are_auto_triggered() {
    let script = |case: &mut Case, random: &mut ChaCha8Rng| early_breaths(case, random, false, 1.0);
    let (sensitivity, wrong) = rates(Asynchrony::AutoTrigger, script);
    assert!(sensitivity >= 0.95 && wrong <= 0.005, "{sensitivity} {wrong}");
}

#[test]
fn beside_a_heartbeat_most_auto_triggers_are_found() {
    let script = |case: &mut Case, random: &mut ChaCha8Rng| {
        case.heart = heart(random);
        early_breaths(case, random, false, 1.0)
    };
    // Strong beats resemble small missed efforts.
    let (sensitivity, wrong) = rates(Asynchrony::AutoTrigger, script);
    assert!(sensitivity >= 0.7 && wrong <= 0.05, "{sensitivity} {wrong}");
}

#[test]
fn early_breaths_with_efforts_are_not_auto_triggered() {
    let mut random = ChaCha8Rng::seed_from_u64(5);
    // Heartbeats bend what a coarse recording shows of a stiff airway.
    for (lasts, beats, most) in
        [(0.25, false, 0.002), (0.5, false, 0.002), (1.0, false, 0.002), (1.0, true, 0.01)]
    {
        let (mut wrong, mut checked) = (0, 0);
        for seed in 0..CASES {
            let mut case = Case::draw(&mut random);
            case.heart = if beats { heart(&mut random) } else { [0.0; 3] };
            let script = early_breaths(&case, &mut random, true, lasts);
            let found = found(&case.record(&script.starts, &script.efforts, seed));
            wrong += found.kinds[Asynchrony::AutoTrigger as usize].events;
            checked += found.checked;
        }
        println!("{lasts} {beats}: {wrong} of {checked} auto-triggered");
        assert!(wrong as f64 <= most * checked as f64, "{lasts} {beats}: {wrong} of {checked}");
    }
}

/// Breaths on a bench with drawn regular efforts, which start breaths or, without a trigger, are missed; and when they begin, s,
/// and how long they last.
fn efforts_on_the_bench(
    lung: &BenchConfig,
    random: &mut ChaCha8Rng,
    triggers: bool,
) -> (Recording, f64, f64) {
    let (effort_rate_per_min, effort_duration_s) =
        (random.random_range(12.0..22.0), random.random_range(0.8..1.2));
    let effort_cmh2o = random.random_range(5.0..10.0);
    let patient =
        PatientConfig { effort_cmh2o, effort_rate_per_min, effort_duration_s, ..PatientConfig::default() };
    let flow_sensor =
        FlowSensorConfig { noise_sd_l_per_s: random.random_range(0.002..0.01), ..lung.flow_sensor };
    let bench = BenchConfig { patient, flow_sensor, ..lung.clone() };
    let settings = Settings { pip: 18.0, rate: 10.0, inspiratory_time: 1.0, ..Settings::default() };
    let off = Settings { trigger_pressure: 0.0, trigger_flow: 0.0, ..settings };
    let settings = if triggers { settings } else { off };
    let recording = bench::recorded(&bench, &settings, KNOWN_GOOD, 10, random.random(), false);
    (recording, 60.0 / effort_rate_per_min, effort_duration_s)
}

/// Number of efforts that lie within an expiration, the opening of its valve excepted, and of those with their peak in one.
fn within_expirations(recording: &Recording, interval_s: f64, duration_s: f64) -> [usize; 2] {
    let at = |row: usize| row as f64 * 1e-3;
    let breaths = recording.breaths();
    let within = |from_s: f64, to_s: f64| {
        breaths.iter().any(|rows| {
            let expires = rows.clone().find(|row| recording.phase[*row] != INSPIRATION).unwrap_or(rows.end);
            from_s >= at(expires) && to_s <= at(rows.end)
        })
    };
    let count = (at(recording.len()) / interval_s).ceil() as u32;
    let efforts: Vec<f64> = (0..count).map(|n| f64::from(n) * interval_s).collect();
    let count = |within: &dyn Fn(f64) -> bool| efforts.iter().filter(|effort| within(**effort)).count();
    let peak = |effort: f64| within(effort + 0.5 * duration_s, effort + 0.5 * duration_s);
    [count(&|effort| within(effort - 0.25, effort + duration_s + 0.1)), count(&peak)]
}

#[test]
fn efforts_on_the_bench_are_missed_without_a_trigger_and_start_breaths_with_one() {
    let mut random = ChaCha8Rng::seed_from_u64(11);
    let (mut missed, mut expected, mut wrong, mut breaths) = (0, [0; 2], 0, 0);
    for lung in BenchConfig::paper_lungs().iter().cycle().take(45) {
        let (recording, interval_s, duration_s) = efforts_on_the_bench(lung, &mut random, false);
        missed += found(&recording).kinds[Asynchrony::MissedEffort as usize].events;
        let [within, peak] = within_expirations(&recording, interval_s, duration_s);
        expected = [expected[0] + within, expected[1] + peak];
        let found = found(&efforts_on_the_bench(lung, &mut random, true).0);
        wrong += found.kinds[Asynchrony::AutoTrigger as usize].events;
        breaths += found.checked;
    }
    println!(
        "bench: {missed} missed efforts of {expected:?}, {wrong} of {breaths} triggered breaths auto-triggered"
    );
    assert!(missed * 10 >= 9 * expected[0] && missed <= expected[1], "{missed} of {expected:?}");
    assert!(wrong * 100 <= breaths, "{wrong}");
}

#[test]
fn passive_benches_have_none() {
    let mut random = ChaCha8Rng::seed_from_u64(7);
    for lung in BenchConfig::paper_lungs() {
        for seed in 0..2 {
            let pip = random.random_range(10.0..35.0);
            let recording = bench::recorded(&lung, &paper_settings(pip), KNOWN_GOOD, 6, seed, seed == 0);
            let found = found(&recording);
            assert_eq!((found.checked, found.index_percent), (6, 0.0), "{} at {pip}: {found:?}", lung.name);
        }
    }
}

#[test]
fn measured_passive_lungs_have_none() {
    let Some(tables) = measured() else { return };
    let folder = tempfile::tempdir().unwrap();
    let mut checked = 0;
    // Each table has noise of its own, and with it thresholds of its own.
    for tables in tables.iter().map(std::slice::from_ref).chain([&tables[..]]) {
        let found = found(&measured_recording(tables, folder.path()));
        assert!(found.index_percent <= 0.0, "{tables:?} {found:?}");
        checked += found.checked;
    }
    assert!(checked > 300, "{checked}");
}

#[test]
fn without_flow_in_both_directions_asynchronies_are_unknown() {
    assert_eq!(Build::default().verdict().asynchronies, None);
    let edit = |t: f64, row: &mut Row| {
        (row.flow_in, row.flow_out) = (Some(if t < 1.0 { 0.5 } else { 0.0 }), Some(0.0));
        true
    };
    let extras = &[Extra::FlowIn, Extra::FlowOut];
    assert_eq!(Build { extras, edit: &edit, ..Build::default() }.verdict().asynchronies, None);
}
