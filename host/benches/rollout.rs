//! Control steps (1 ms each) per second through learned simulator and controller, both of default shape: forward pass
//! only, and with gradient. Uses all cores; criterion's throughput counts control steps.
//!
//! Run with `cargo bench -p host -- rollout`.

use criterion::{BenchmarkId, Criterion, Throughput, criterion_group, criterion_main};
use learn::controller::{PlantModels, Stepwise, TrainConfig, Training};
use learn::simulator::model::{Architecture, Simulator};
use learn::simulator::state_space::StateSpaceConfig;
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::SeedableRng;
use shared::breath::DEFAULT_PERIOD_US;
use shared::control::features::FeatureSpec;
use shared::control::pid::PidGains;
use shared::control::residual::ResidualSpec;

/// Number of control steps of the paper's inspiration.
const TICKS: u64 = 1000;

fn training(batch: usize) -> Training {
    let architecture = Architecture::StateSpace(StateSpaceConfig::for_period(DEFAULT_PERIOD_US, 1));
    let simulator = Simulator {
        architecture,
        parameters: architecture.initialise(&mut ChaCha8Rng::seed_from_u64(1)),
        noise: 0.1,
        start_pressure: 5.0,
        plant: "random".into(),
    };
    let spec = ResidualSpec {
        period_us: DEFAULT_PERIOD_US,
        gains: PidGains { p: 1.0, i: 15.0, d: 0.0 },
        lambda: 1.0,
        authority: 100.0,
        features: FeatureSpec::default(),
    };
    // Enough iterations that the learning rate's schedule does not end within the measurement.
    let config = TrainConfig { batch, iterations: usize::MAX, ..TrainConfig::default() };
    match Training::new(
        spec,
        &[PlantModels { trained_on: std::slice::from_ref(&simulator), held_out: &simulator }],
        config,
        None,
    ) {
        Ok(training) => training,
        Err(error) => panic!("{error}"),
    }
}

fn rollout(criterion: &mut Criterion) {
    let mut group = criterion.benchmark_group("rollout");
    group.sample_size(20);
    for batch in [6, 64, 256] {
        let mut training = training(batch);
        group.throughput(Throughput::Elements(TICKS * batch as u64));
        group.bench_function(BenchmarkId::new("forward", batch), |b| b.iter(|| training.rehearse()));
        group.bench_function(BenchmarkId::new("gradient", batch), |b| b.iter(|| training.step()));
    }
    group.finish();
}

criterion_group!(benches, rollout);
criterion_main!(benches);
