//! Makes a case that breaks a promise as small as it can be.

use shared::breath::paper_settings;
use shared::device::KNOWN_GOOD;
use shared::safety::monitors::Monitors;

use super::case::{Case, Law};
use super::generator::rounded;
use super::promise::{Promise, broken};
use plant::bench::{BenchConfig, PatientConfig, UnitConfig};
use ventilator::SourceError;

/// Most attempts; each takes some runs.
const ATTEMPTS: u32 = 60;

/// The smallest case found that still breaks a promise.
///
/// # Errors
/// A case that cannot be run.
pub fn shrink(case: &Case, promise: Promise) -> Result<Case, SourceError> {
    let mut smallest = case.clone();
    let mut attempts = 0;
    let breaks = |case: &Case| -> Result<bool, SourceError> {
        let valid = case.validate().is_ok();
        Ok(valid && broken(case, Monitors::ALL)?.iter().any(|broken| broken.promise == promise))
    };
    loop {
        let mut smaller = None;
        for candidate in simpler(&smallest) {
            if attempts >= ATTEMPTS {
                return Ok(smallest);
            }
            attempts += 1;
            if candidate != smallest && breaks(&candidate)? {
                smaller = Some(candidate);
                break;
            }
        }
        match smaller {
            Some(case) => smallest = case,
            None => return Ok(smallest),
        }
    }
}

/// Cases that are simpler in one respect, the largest steps first.
fn simpler(case: &Case) -> Vec<Case> {
    let mut found = Vec::new();
    for place in 0..case.bench.faults.len() {
        let mut faults = case.bench.faults.clone();
        faults.remove(place);
        found.push(case.with_faults(faults));
    }
    found.push(Case { stalls: None, ..case.clone() });
    found.push(Case { host: None, ..case.clone() });
    let with_bench = |change: &dyn Fn(&mut BenchConfig)| {
        let mut simpler = case.clone();
        change(&mut simpler.bench);
        simpler
    };
    found.push(with_bench(&|bench| bench.patient = PatientConfig::default()));
    found.push(with_bench(&|bench| {
        let lung = &bench.lung.first;
        let (resistance, compliance) = (lung.resistance_cmh2o_per_l_s, lung.compliance_ml_per_cmh2o);
        let faults = bench.faults.clone();
        let patient = bench.patient;
        *bench = BenchConfig { faults, patient, ..BenchConfig::paper(resistance, compliance) };
    }));
    found.push(with_bench(&|bench| bench.unit = UnitConfig::default()));
    found.push(with_bench(&|bench| {
        let lung = &mut bench.lung.first;
        lung.resistance_cmh2o_per_l_s = 20.0;
        lung.compliance_ml_per_cmh2o = 20.0;
    }));
    let known_good = Law::Pid([KNOWN_GOOD.p, KNOWN_GOOD.i, KNOWN_GOOD.d]);
    found.push(Case { controller: known_good, ..case.clone() });
    let limit = case.settings.pressure_limit;
    let mut usual = paper_settings(case.settings.pip.clamp(10.0, 35.0).round());
    usual.pressure_limit = limit.max(usual.pip + 5.0).round();
    found.push(Case { settings: usual, ..case.clone() });
    for place in 0..case.bench.faults.len() {
        found.push(with_bench(&|bench| bench.faults[place].repeats = None));
        found.push(with_bench(&|bench| bench.faults[place].to_s = None));
        found.push(with_bench(&|bench| bench.faults[place].from_s = bench.faults[place].from_s.round()));
    }
    found.push(Case { seed: 1, ..case.clone() });
    found.push(Case { seconds: rounded(case.seconds).round(), ..case.clone() });
    found
}
