//! The bench as a whole.

mod behaviour;
mod description;
mod living;
mod physics;
mod records;
mod sensors;

use super::{Bench, BenchConfig, Truth};

const PEEP: f32 = 5.0;
/// Command that keeps a small flow through the circuit in expiration, percent.
pub(super) const BIAS: f32 = 5.0;

fn bench(config: &BenchConfig) -> Bench {
    Bench::new(config, PEEP, 1).unwrap()
}

/// Every lung of both presets.
fn all_lungs() -> Vec<BenchConfig> {
    [BenchConfig::paper_lungs(), BenchConfig::iso_lungs()].concat()
}

/// A bench whose sensor shows the true pressure and whose circuit and patient add nothing.
fn plain(resistance: f64, compliance: f64) -> BenchConfig {
    let mut config = BenchConfig::paper(resistance, compliance);
    config.lung.first.turbulence_s_per_l = 0.0;
    config.circuit.leak_l_per_s_at_30_cmh2o = 0.0;
    config
}

pub(super) fn run(bench: &mut Bench, u_in: f32, u_out: bool, steps: u32) -> Truth {
    for _ in 0..steps {
        bench.step(u_in, u_out);
    }
    bench.truth()
}

/// Volume in circuit and lung, mL.
fn stored_ml(config: &BenchConfig, truth: &Truth) -> f64 {
    truth.lung_volume_ml + config.circuit.compliance_ml_per_cmh2o * truth.airway_pressure
}
