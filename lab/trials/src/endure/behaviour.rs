//! What patients do: they breathe, sigh, strain and cough, and their lungs change slowly.

use rand::RngExt;
use rand_chacha::ChaCha8Rng;

use super::chance::{log_uniform, uniform};
use super::ramp::Ramp;
use super::ward::Kind;
use plant::bench::{BenchConfig, FaultConfig, Faulty, LeakChange, Repeats, Strain};

/// Share of the patients with each of the rarer behaviours.
const SOME: f64 = 0.33;
/// Time between two sighs, and between two strains, s.
const APART_S: (f64, f64) = (120.0, 1800.0);
/// Beginning and duration of a slow change of the lung, s, and its factors on resistance and compliance.
const CHANGE_BEGINS_S: (f64, f64) = (60.0, 1800.0);
const CHANGE_LASTS_S: (f64, f64) = (300.0, 3600.0);
const RESISTANCE: (f64, f64) = (0.75, 1.5);
const COMPLIANCE: (f64, f64) = (0.75, 1.33);
/// A tight circuit's leak, L/s at 30 cmH2O.
pub(super) const TIGHT: f64 = 0.005;
/// The largest leak of adults and of newborns, L/s at 30 cmH2O.
const LEAK: (f64, f64) = (0.5, 0.1);
/// Time between two changes of the leak, s.
const LEAK_LASTS_S: (f64, f64) = (300.0, 1800.0);

/// Draws what a patient does whose breaths are set to a rate.
pub(super) fn behave(rng: &mut ChaCha8Rng, kind: &Kind, bench: &mut BenchConfig, rate: f64) {
    // All are always drawn, so that one patient's draws do not shift the next ones.
    breathe(rng, kind, bench, rate);
    cough(rng, kind, bench);
    let size = kind.uniform(rng, (5.0, 30.0), (3.0, 12.0));
    let sigh = Strain { cmh2o: -size, duration_s: kind.uniform(rng, (1.0, 2.5), (0.4, 1.0)) };
    let size = kind.uniform(rng, (10.0, 80.0), (5.0, 40.0));
    let strain = Strain { cmh2o: size, duration_s: kind.uniform(rng, (0.3, 2.0), (0.2, 1.0)) };
    for strain in [sigh, strain] {
        let fault = repeated(rng, strain);
        bench.faults.extend(rng.random_bool(SOME).then_some(fault));
    }
    change_lung(rng, bench);
}

/// Efforts of half of the patients, close to the set rate in a third of them.
fn breathe(rng: &mut ChaCha8Rng, kind: &Kind, bench: &mut BenchConfig, rate: f64) {
    let patient = &mut bench.patient;
    let breathes = rng.random_bool(0.5);
    let effort = kind.uniform(rng, (0.0, 20.0), (0.0, 10.0));
    let [close, own] = [rate * uniform(rng, (0.95, 1.05)), kind.uniform(rng, (8.0, 35.0), (30.0, 70.0))];
    let effort_rate = if rng.random_bool(SOME) { close.min(80.0) } else { own };
    patient.effort_cmh2o = if breathes { effort } else { 0.0 };
    patient.effort_rate_per_min = effort_rate;
    patient.effort_duration_s = kind.uniform(rng, (0.5, 1.2), (0.2, 0.5)).min(0.6 * 60.0 / effort_rate);
    patient.effort_variability_percent = uniform(rng, (0.0, 30.0));
    patient.double_efforts_percent = uniform(rng, (0.0, 10.0));
    let wanes = uniform(rng, (30.0, 100.0));
    patient.effort_wanes_percent = if rng.random_bool(SOME) { wanes } else { 0.0 };
    patient.effort_wanes_every_s = log_uniform(rng, (60.0, 1800.0));
}

fn cough(rng: &mut ChaCha8Rng, kind: &Kind, bench: &mut BenchConfig) {
    let patient = &mut bench.patient;
    patient.cough_cmh2o = kind.uniform(rng, (20.0, 60.0), (10.0, 30.0));
    let coughs = uniform(rng, (0.0, 20.0));
    patient.coughs_per_hour = if rng.random() { coughs } else { 0.0 };
    // Without random coughs, `cough_cmh2o` would be a single one.
    patient.cough_at_s = 1e6;
}

fn repeated(rng: &mut ChaCha8Rng, strain: Strain) -> FaultConfig {
    let every_s = log_uniform(rng, APART_S);
    let repeats = Some(Repeats { for_s: strain.duration_s, every_s });
    FaultConfig { from_s: uniform(rng, (0.0, every_s)), to_s: None, repeats, what: Faulty::Strain(strain) }
}

/// Secretions, and slow changes of resistance and compliance.
fn change_lung(rng: &mut ChaCha8Rng, bench: &mut BenchConfig) {
    let growth = uniform(rng, (0.0, 20.0));
    bench.patient.resistance_growth_percent_per_hour = if rng.random_bool(SOME) { growth } else { 0.0 };
    let ramp = Ramp { from_s: uniform(rng, CHANGE_BEGINS_S), lasts_s: log_uniform(rng, CHANGE_LASTS_S) };
    let [resistance, compliance] = [RESISTANCE, COMPLIANCE].map(|range| log_uniform(rng, range));
    if rng.random_bool(SOME) {
        // The resistance follows the compliance, so that one list of steps is enough.
        let of = |compliance_part: f64| {
            let power = resistance.ln() / compliance.ln();
            Faulty::Lung { resistance: compliance_part.powf(power), compliance: compliance_part }
        };
        bench.faults.extend(ramp.together(compliance, of));
    }
}

/// Draws the leak and its changes.
pub(super) fn leaks(rng: &mut ChaCha8Rng, kind: &Kind, bench: &mut BenchConfig, hours: f64) {
    let leak = |rng: &mut ChaCha8Rng| {
        if rng.random() { TIGHT } else { kind.uniform(rng, (0.0, LEAK.0), (0.0, LEAK.1)) }
    };
    let circuit = &mut bench.circuit;
    circuit.leak_l_per_s_at_30_cmh2o = leak(rng);
    let mut at_s = uniform(rng, LEAK_LASTS_S);
    while at_s < hours * 3600.0 {
        circuit.leak_changes.push(LeakChange { at_s, leak_l_per_s_at_30_cmh2o: leak(rng) });
        at_s += uniform(rng, LEAK_LASTS_S);
    }
}
