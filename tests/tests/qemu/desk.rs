//! A board on the desk, which simulates the bench itself.

use plant::bench::family::Family;
use shared::link::refusal::Refusal;
use ventilator::collect::Collected;

use super::*;

/// A run of some breaths with exploration.
fn breaths() -> CollectConfig {
    CollectConfig { breaths: 3, seed: (1 << 51) + 3, ..CollectConfig::default() }
}

fn recorded(source: &mut dyn Source) -> Collected {
    collect(source, &controller(), &breaths(), &Progress::silent()).unwrap()
}

fn controller() -> Controller {
    Controller::Pid(Pid::new(KNOWN_GOOD, 1000).unwrap())
}

/// Faults, each from a time on.
fn faults(faults: &[(f64, &str)]) -> String {
    let fault =
        |(from_s, what): &(f64, &str)| format!("[[faults]]\nfrom_s = {from_s}\nwhat = {{ {what} }}\n");
    faults.iter().map(fault).collect::<Vec<_>>().concat()
}

/// Benches that differ in every part: lungs, machines, a blower, patients, faults of every signal, members of the families.
fn benches() -> Vec<BenchConfig> {
    const PARTS: &str = "[patient]
        effort_cmh2o = 6
        effort_variability_percent = 20
        double_efforts_percent = 10
        cough_cmh2o = 20
        coughs_per_hour = 600
        effort_wanes_percent = 30
        resistance_growth_percent_per_hour = 900
        [valve]
        curve_exponent = 2.2
        [circuit]
        leak_changes = [{ at_s = 4, leak_l_per_s_at_30_cmh2o = 0.1 }]\n";
    let delayed = faults(&[
        (3.0, "sensor = { signal = \"converter\", distortion = { dead_time_ms = 30 } }"),
        (4.0, "sensor = { signal = \"outlet\", distortion = { hum = { amplitude = 0.3, hz = 50 } } }"),
    ]);
    let swinging = faults(&[
        (5.0, "supply_swings = { least = 0.8, hz = 2 }"),
        (2.0, "sensor = { signal = \"pressures\", distortion = { lag_ms = 8 } }"),
    ]);
    let faulty =
        [delayed, swinging].map(|faults| BenchConfig::from_toml(&format!("{PARTS}{faults}")).unwrap());
    let mut benches = vec![lung()];
    benches.extend(faulty);
    benches.extend(Family::names().into_iter().map(|name| Family::find(name).unwrap().draw(40, 1)));
    benches
}

/// Number and values of the first tick in which two traces differ in any bit.
fn first_difference(one: &[f32], other: &[f32]) -> Option<(usize, f32, f32)> {
    assert_eq!(one.len(), other.len());
    let mut pairs = one.iter().zip(other).enumerate();
    pairs.find_map(|(tick, (one, other))| (one.to_bits() != other.to_bits()).then_some((tick, *one, *other)))
}

#[test]
fn golden_traces_of_any_bench_are_the_hosts_bit_for_bit() {
    for bench in benches() {
        let settings = breaths().settings;
        let mut here = BenchSource::new(&bench, controller(), &settings, 1000, breaths().seed).unwrap();
        let here = recorded(&mut here);
        let (_board, device) = on_the_desk(config("desk"), &bench);
        let there = recorded(&mut PortSource::new(device, breaths().seed).unwrap());
        let (here, there) = (here.recording, there.recording);
        assert!(here.pressure.len() > 2_500, "{}", bench.name);
        let name = &bench.name;
        assert_eq!(first_difference(&here.pressure, &there.pressure), None, "{name}: pressure");
        assert_eq!(first_difference(&here.u_in, &there.u_in), None, "{name}: command");
    }
}

/// The chip has neither room nor time for every description: what it takes, it runs without missing a tick.
#[test]
fn a_bench_that_is_too_much_for_the_chip_is_refused_and_the_last_one_stays() {
    let (_board, mut device) = on_the_desk(config("desk"), &lung());
    let noise = (0.0, "sensor = { signal = \"converter\", distortion = { noise = 0.1 } }");
    let delay = (0.0, "sensor = { signal = \"flow\", distortion = { dead_time_ms = 251 } }");
    let three_faults = faults(&[noise; MOST_FAULTS + 1]);
    for description in [&three_faults, &faults(&[delay]), "sub_steps = 5"] {
        let bench = BenchConfig::from_toml(description).unwrap();
        let refused = device.set_bench(&bench.to_bytes());
        assert!(
            matches!(refused, Err(DeviceError::Refused(Refusal::BadBench))),
            "{description}: {refused:?}"
        );
    }
    device.set_bench(&BenchConfig::from_toml(&faults(&[noise; MOST_FAULTS])).unwrap().to_bytes()).unwrap();
}
