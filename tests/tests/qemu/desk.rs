//! A board on the desk, which simulates the bench itself.

use plant::bench::family::Family;
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

/// Benches that differ in every part: lungs, machines, a blower, patients, faults of every signal, members of the families.
fn benches() -> Vec<BenchConfig> {
    let faulty = "[patient]
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
        leak_changes = [{ at_s = 4, leak_l_per_s_at_30_cmh2o = 0.1 }]
        [[faults]]
        from_s = 3
        what = { sensor = { signal = \"converter\", distortion = { dead_time_ms = 30 } } }
        [[faults]]
        from_s = 4
        what = { sensor = { signal = \"outlet\", distortion = { hum = { amplitude = 0.3, hz = 50 } } } }
        [[faults]]
        from_s = 5
        to_s = 7
        what = { supply_swings = { least = 0.8, hz = 2 } }
        [[faults]]
        from_s = 2
        what = { sensor = { signal = \"airway\", distortion = { lag_ms = 8 } } }";
    let mut benches = vec![lung(), BenchConfig::from_toml(faulty).unwrap()];
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
