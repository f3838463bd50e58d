//! Control steps (1 ms each) per second through simulator and controller: forward pass only, and with gradient, on a learned
//! simulator of default shape; with gradient on the physical simulators of a family. Uses all cores; criterion's throughput counts
//! control steps.
//!
//! Run with `cargo bench -p host --bench rollout`.

use criterion::{BenchmarkId, Criterion, Throughput, criterion_group, criterion_main};
use learn::controller::{
    FamilyConfig, FamilyModels, FamilyTraining, PlantModels, Stepwise, TrainConfig, Training,
};
use learn::pipeline::family::FamilyRun;
use learn::simulator::model::{Architecture, Model, Simulator};
use learn::simulator::state_space::StateSpaceConfig;
use learn::simulator::unit::UnitConfig;
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::SeedableRng;
use shared::breath::DEFAULT_PERIOD_US;
use shared::control::features::FeatureSpec;
use shared::control::pid::PidGains;
use shared::control::residual::ResidualSpec;

/// Number of control steps of the paper's inspiration.
const TICKS: u64 = 1000;

fn spec(gains: PidGains) -> ResidualSpec {
    ResidualSpec {
        period_us: DEFAULT_PERIOD_US,
        gains,
        lambda: 1.0,
        authority: 100.0,
        features: FeatureSpec::default(),
    }
}

fn training(batch: usize) -> Training {
    let architecture = Architecture::StateSpace(StateSpaceConfig::for_period(DEFAULT_PERIOD_US, 1));
    let simulator = Simulator {
        architecture,
        parameters: architecture.initialise(&mut ChaCha8Rng::seed_from_u64(1)),
        noise: 0.1,
        start_pressure: 5.0,
        plant: "random".into(),
    };
    // Enough iterations that the learning rate's schedule does not end within the measurement.
    let config = TrainConfig { batch, iterations: usize::MAX, ..TrainConfig::default() };
    match Training::new(
        spec(PidGains { p: 1.0, i: 15.0, d: 0.0 }),
        &[PlantModels { trained_on: std::slice::from_ref(&simulator), held_out: &simulator }],
        config,
        None,
    ) {
        Ok(training) => training,
        Err(error) => panic!("{error}"),
    }
}

/// Training for a family of units whose numbers differ by up to a fifth.
fn family(batch: usize) -> FamilyTraining {
    let units = UnitConfig::for_period(DEFAULT_PERIOD_US, 64);
    let mut parameters = units.initialise();
    for (n, parameter) in parameters.iter_mut().enumerate() {
        *parameter += 0.2 * (n as f32).sin();
    }
    let model = Model::new(Architecture::Unit(units), &parameters);
    let models = FamilyModels { trained_on: model.clone(), held_out: model };
    let config = FamilyConfig { batch, iterations: usize::MAX, ..FamilyConfig::default() };
    match FamilyTraining::new(spec(FamilyRun::default().gains), models, config, None) {
        Ok(mut training) => {
            training.prepare();
            training
        }
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
    let mut training = family(64);
    group.throughput(Throughput::Elements(TICKS * 64));
    group.bench_function("family gradient/64", |b| b.iter(|| training.step()));
    group.finish();
}

criterion_group!(benches, rollout);
criterion_main!(benches);
