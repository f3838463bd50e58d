//! Drawn cases as a whole.

use super::case::{Case, Law};
use super::generator::Generator;
use super::promise::{Promise, broken};
use super::shrink::shrink;
use shared::breath::paper_settings;
use shared::safety::alarms::Fault;
use shared::safety::monitors::Monitors;
use shared::safety::responses::Response;
use shared::settings::Settings;

fn case(fault: &str) -> Case {
    let limit = Settings { pressure_limit: 40.0, ..paper_settings(25.0) };
    let bare = Case {
        seed: 1,
        seconds: 75.0,
        controller: Law::Pid([3.0, 30.0, 0.0]),
        stalls: None,
        settings: limit,
        host: None,
        bench: plant::bench::BenchConfig::default(),
    };
    let faults = format!("{}\n{fault}", bare.to_toml());
    Case::from_toml(&faults).unwrap()
}

fn breaks(case: &Case) -> Vec<Promise> {
    broken(case, Monitors::ALL).unwrap().into_iter().map(|broken| broken.promise).collect()
}

#[test]
fn a_drawn_case_comes_back_from_its_text_and_has_the_same_bits_every_time() {
    let (one, other) = (Generator::new(5).unwrap(), Generator::new(5).unwrap());
    for number in 0..300 {
        let case = one.draw(number);
        case.validate().unwrap_or_else(|error| panic!("case {number}: {error}\n{}", case.to_toml()));
        assert_eq!(case, other.draw(number));
        assert_eq!(Case::from_toml(&case.to_toml()).unwrap(), case, "{}", case.to_toml());
        let faults =
            case.bench.faults.len() + usize::from(case.stalls.is_some()) + usize::from(case.host.is_some());
        assert!((1..=3).contains(&faults), "{}", case.to_toml());
    }
    assert_ne!(one.draw(0), Generator::new(6).unwrap().draw(0));
}

#[test]
fn every_kind_of_fault_is_drawn() {
    let generator = Generator::new(2).unwrap();
    let classes: String = (0..4000).map(|number| generator.draw(number).class() + "\n").collect();
    for kind in [
        "offset up",
        "offset down",
        "gain too low",
        "gain too high",
        "reversed",
        ": lag",
        "dead time",
        "drift up",
        "drift down",
        "noise",
        "hum",
        "quantum",
        "saturation",
        "freeze",
        "constant with noise",
        "spikes",
        "missing",
        "airway sensor",
        "outlet sensor",
        "flow sensor",
        "both pressure sensors",
        "converter",
        "tube occluded",
        "tube narrowed",
        "filter clogged",
        "filter narrowed",
        "disconnected",
        "leak",
        "leak in inspirations",
        "leak in expirations",
        "inspiratory valve stuck",
        "valve loose",
        "both valves stuck",
        "expiratory valve closed",
        "PEEP valve stuck",
        "supply lost",
        "supply falls",
        "supply swings",
        "lung: narrower",
        "lung: wider",
        "stiffer",
        "softer",
        "strain",
        "sigh",
        "missed ticks",
        "settings that change",
        "now and then",
    ] {
        assert!(classes.contains(kind), "{kind}");
    }
}

#[test]
fn some_alarm_limits_of_the_volumes_are_drawn() {
    let generator = Generator::new(2).unwrap();
    let settings: Vec<Settings> = (0..300).map(|number| generator.draw(number).settings).collect();
    let share = |limit: fn(&Settings) -> f32| settings.iter().filter(|each| limit(each) > 0.0).count() / 30;
    let limits: [fn(&Settings) -> f32; 3] =
        [|each| each.tidal_volume_low, |each| each.tidal_volume_high, |each| each.minute_volume_high];
    assert!(limits.into_iter().all(|limit| (2..=4).contains(&share(limit))));
    assert!(settings.iter().all(|each| each.minute_volume_low == 0.0));
}

#[test]
fn a_case_without_a_fault_keeps_every_promise() {
    assert_eq!(breaks(&case("")), []);
}

#[test]
fn a_promise_that_is_broken_is_found() {
    let stands = "[[bench.faults]]\nfrom_s = 20\n\
                  what = { sensor = { signal = \"pressures\", distortion = { stands = { at = 25, noise = 0.1 } } } }";
    assert_eq!(breaks(&case(stands)), [], "backup ventilation goes on");
    let blind = Fault::all().fold(Monitors::ALL, Monitors::without).without_response(Response::Backup);
    let found: Vec<_> =
        broken(&case(stands), blind).unwrap().into_iter().map(|broken| broken.promise).collect();
    assert_eq!(found, [Promise::Volume]);
}

#[test]
fn a_case_is_shrunk_to_the_fault_that_matters() {
    // Without any alarm: both sensors say the same too low pressure, and the limit is not seen.
    let faults = "[[bench.faults]]\nfrom_s = 20\nwhat = { sensor = { signal = \"outlet\", distortion = { noise = 0.1 } } }\n\
                  [[bench.faults]]\nfrom_s = 20\nwhat = { sensor = { signal = \"pressures\", distortion = { gain = 0.3 } } }";
    let large = case(faults);
    let promise = *breaks(&large).first().expect("a common cause that nothing tells");
    let small = shrink(&large, promise).unwrap();
    assert_eq!(small.bench.faults.len(), 1, "{}", small.to_toml());
    assert!(breaks(&small).contains(&promise));
}

#[test]
fn what_the_gas_denies_neither_latches_nor_ends_inspirations() {
    let of = |signal: &str, distortion: &str| {
        format!(
            "[[bench.faults]]\nfrom_s = 20\nwhat = {{ sensor = {{ signal = \"{signal}\", distortion = {{ {distortion} }} }} }}"
        )
    };
    for drift in [0.5, 1.2, 2.2] {
        assert_eq!(breaks(&case(&of("pressures", &format!("drift_per_s = {drift}")))), [], "{drift} cmH2O/s");
    }
    assert_eq!(breaks(&case(&of("pressures", "offset = 30"))), []);
}

/// Drawn cases that once broke a promise, each of a kind of its own.
const KEPT: [&str; 7] = [
    include_str!("kept/one-sensor-ends-breaths.toml"),
    include_str!("kept/leak-ends.toml"),
    include_str!("kept/peep-valve-beside-leak.toml"),
    include_str!("kept/gas-denies-one-sensor.toml"),
    include_str!("kept/effort-ends-expiration.toml"),
    include_str!("kept/sensor-stands-beside-efforts.toml"),
    include_str!("kept/peep-valve-near-pip.toml"),
];

#[test]
fn what_once_broke_a_promise_keeps_all() {
    for text in KEPT {
        let found = broken(&Case::from_toml(text).unwrap(), Monitors::ALL).unwrap();
        assert!(found.is_empty(), "{found:?}: {}", text.lines().next().unwrap_or_default());
    }
}

#[test]
fn drawn_cases_keep_their_promises_but_for_a_common_cause() {
    let generator = Generator::new(11).unwrap();
    for number in 0..120 {
        let case = generator.draw(number);
        let found = broken(&case, Monitors::ALL).unwrap();
        assert!(
            found.is_empty() || case.is_of_a_common_cause(),
            "case {number}: {found:?}\n{}",
            case.to_toml()
        );
    }
}

#[test]
fn a_common_cause_is_one_of_all_pressure_sensors() {
    let of = |signal: &str| {
        let noise =
            format!("what = {{ sensor = {{ signal = \"{signal}\", distortion = {{ noise = 0.1 }} }} }}");
        case(&format!("[[bench.faults]]\nfrom_s = 20\n{noise}")).is_of_a_common_cause()
    };
    assert_eq!(
        ["airway", "outlet", "flow", "pressures", "converter"].map(of),
        [false, false, false, true, true]
    );
}
