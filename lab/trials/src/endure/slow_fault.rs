//! A slow fault, which one patient in ten has: a sensor that goes wrong, a part that fails little by little, a lung that stiffens.

use rand::RngExt;
use rand_chacha::ChaCha8Rng;

use super::chance::{log_uniform, uniform};
use super::ramp::{Ramp, lasting};
use plant::bench::{BenchConfig, Distortion, Failure, FaultConfig, Faulty, LeakChange, Signal};

/// Share of the patients with one.
const SHARE: f64 = 0.1;
/// Beginning, and duration until it has its full size, s.
const BEGINS_S: (f64, f64) = (300.0, 2400.0);
const LASTS_S: (f64, f64) = (120.0, 3600.0);
/// Drift in all of a pressure sensor, cmH2O, and of a flow sensor, as a share of the machine's largest flow.
const PRESSURE_DRIFT: (f64, f64) = (0.5, 10.0);
const FLOW_DRIFT: (f64, f64) = (0.005, 0.1);
/// Gain of a wrong sensor, and time constant of one with water in its line, ms.
const GAIN: (f64, f64) = (0.6, 1.6);
const LAG_MS: (f64, f64) = (10.0, 200.0);
/// The largest leak, as a share of the machine's largest flow at 30 cmH2O, and the most that a bench can have, L/s.
const LEAK: (f64, f64) = (0.1, 0.6);
const MOST_LEAK: f64 = 1.0;
/// Factor on the resistances by a narrow tube, and what is left of the expiratory flow, of the supply and of the compliance.
const NARROWED: (f64, f64) = (1.5, 20.0);
const FILTER_LEFT: (f64, f64) = (0.1, 0.7);
const SUPPLY_LEFT: (f64, f64) = (0.2, 0.8);
const COMPLIANCE_LEFT: (f64, f64) = (0.3, 0.8);

/// Draws the slow fault of a patient, if it has one.
pub(super) fn add(rng: &mut ChaCha8Rng, bench: &mut BenchConfig) {
    let ramp = Ramp { from_s: uniform(rng, BEGINS_S), lasts_s: log_uniform(rng, LASTS_S) };
    if !rng.random_bool(SHARE) {
        return;
    }
    let part = |failure: fn(f64) -> Failure| move |size: f64| Faulty::Part(failure(size));
    let faults = match rng.random_range(0..10) {
        0..5 => sensor(rng, bench, ramp),
        5 => {
            let largest = log_uniform(rng, LEAK) * bench.full_flow_l_per_s();
            leak(bench, ramp, largest.min(MOST_LEAK));
            Vec::new()
        }
        6 => ramp.replaced(log_uniform(rng, NARROWED), part(Failure::TubeNarrowed)),
        7 => ramp.replaced(log_uniform(rng, FILTER_LEFT), part(Failure::FilterNarrowed)),
        8 => ramp.replaced(log_uniform(rng, SUPPLY_LEFT), part(Failure::SupplyFalls)),
        _ => {
            let stiffer = |compliance: f64| Faulty::Lung { resistance: 1.0, compliance };
            ramp.together(log_uniform(rng, COMPLIANCE_LEFT), stiffer)
        }
    };
    bench.faults.extend(faults);
}

/// A sensor that drifts, gains or loses, or lags.
fn sensor(rng: &mut ChaCha8Rng, bench: &BenchConfig, ramp: Ramp) -> Vec<FaultConfig> {
    let signal = [Signal::Airway, Signal::Outlet, Signal::Flow][rng.random_range(0..3)];
    let wrong = |distortion: Distortion| Faulty::Sensor { signal, distortion };
    match rng.random_range(0..3) {
        0 => {
            let sign = if rng.random() { 1.0 } else { -1.0 };
            let size = if signal == Signal::Flow {
                log_uniform(rng, FLOW_DRIFT) * bench.full_flow_l_per_s()
            } else {
                log_uniform(rng, PRESSURE_DRIFT)
            };
            let end_s = ramp.from_s + ramp.lasts_s;
            let drifts = wrong(Distortion::DriftPerS(sign * size / ramp.lasts_s));
            let drifts = FaultConfig { to_s: Some(end_s), ..lasting(ramp.from_s, drifts) };
            vec![drifts, lasting(end_s, wrong(Distortion::Offset(sign * size)))]
        }
        1 => ramp.together(log_uniform(rng, GAIN), |gain| wrong(Distortion::Gain(gain))),
        _ => vec![lasting(ramp.from_s, wrong(Distortion::LagMs(log_uniform(rng, LAG_MS))))],
    }
}

/// A leak that grows in place of the changes that were drawn.
fn leak(bench: &mut BenchConfig, ramp: Ramp, largest: f64) {
    let circuit = &mut bench.circuit;
    let before = circuit.leak_changes.iter().rev().find(|change| change.at_s < ramp.from_s);
    let before = before.map_or(circuit.leak_l_per_s_at_30_cmh2o, |change| change.leak_l_per_s_at_30_cmh2o);
    circuit.leak_changes.retain(|change| change.at_s < ramp.from_s);
    circuit.leak_changes.extend(ramp.steps().map(|(at_s, share)| LeakChange {
        at_s,
        leak_l_per_s_at_30_cmh2o: before + share * (largest - before).max(0.0),
    }));
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand_chacha::rand_core::SeedableRng;

    fn benches() -> Vec<BenchConfig> {
        let drawn = |seed| {
            let mut bench = BenchConfig::paper(20.0, 20.0);
            add(&mut ChaCha8Rng::seed_from_u64(seed), &mut bench);
            bench
        };
        (0..2000).map(drawn).collect()
    }

    #[test]
    fn one_patient_in_ten_has_a_fault_and_all_kinds_occur() {
        let sound = BenchConfig::paper(20.0, 20.0);
        let faulty: Vec<_> = benches().into_iter().filter(|bench| *bench != sound).collect();
        assert!((150..=250).contains(&faulty.len()), "{}", faulty.len());
        let count = |holds: &dyn Fn(&Faulty) -> bool| {
            faulty.iter().filter(|bench| bench.faults.iter().any(|fault| holds(&fault.what))).count()
        };
        let of_signal = |wanted: Signal| {
            count(&move |what: &Faulty| matches!(what, Faulty::Sensor { signal, .. } if *signal == wanted))
        };
        for signal in [Signal::Airway, Signal::Outlet, Signal::Flow] {
            assert!(of_signal(signal) > 20, "{signal:?}");
        }
        assert!(count(&|what| matches!(what, Faulty::Lung { .. })) > 8);
        assert!(count(&|what| matches!(what, Faulty::Part(Failure::TubeNarrowed(_)))) > 8);
        assert!(faulty.iter().filter(|bench| !bench.circuit.leak_changes.is_empty()).count() > 8);
    }

    #[test]
    fn every_fault_grows_within_its_time_on_a_valid_bench() {
        for bench in benches() {
            bench.validate().unwrap();
            let ends_s = bench.faults.iter().map(|fault| fault.from_s).fold(0.0, f64::max);
            assert!(ends_s <= BEGINS_S.1 + LASTS_S.1);
            let leaks = bench.circuit.leak_changes.windows(2);
            assert!(
                leaks
                    .into_iter()
                    .all(|pair| { pair[1].leak_l_per_s_at_30_cmh2o > pair[0].leak_l_per_s_at_30_cmh2o })
            );
        }
    }
}
