//! Speed of the virtual bench relative to real time, in closed loop at R 20 C 20.

use std::hint::black_box;
use std::time::Duration;

use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use plant::bench::{Bench, BenchConfig};

/// Duration of a breath, ms.
const BREATH_MS: u32 = 3_000;
/// Duration of its inspiration, ms.
const INSPIRATION_MS: u32 = 1_000;
const PIP_CMH2O: f32 = 25.0;
const PEEP_CMH2O: f32 = 5.0;
/// Command in expiration, percent.
const BIAS_PERCENT: f32 = 5.0;

/// A minimal controller that moves the bench like a real one: a PI with a limited integral.
#[derive(Default)]
struct Pi {
    integral: f32,
}

impl Pi {
    fn command(&mut self, error: f32) -> f32 {
        self.integral = (self.integral + 0.05 * error).clamp(0.0, 100.0);
        (2.0 * error + self.integral).clamp(0.0, 100.0)
    }
}

fn breath(bench: &mut Bench) -> f32 {
    let mut pi = Pi::default();
    let mut pressure = PEEP_CMH2O;
    for ms in 0..BREATH_MS {
        let inspiration = ms < INSPIRATION_MS;
        let u_in = if inspiration { pi.command(PIP_CMH2O - pressure) } else { BIAS_PERCENT };
        pressure = bench.step(u_in, !inspiration);
    }
    pressure
}

/// Throughput is in simulated ms: 1 Melem/s is a thousand times real time.
fn closed_loop(criterion: &mut Criterion) {
    let mut bench = Bench::new(&BenchConfig::paper(20.0, 20.0), PEEP_CMH2O, 1).expect("the preset is valid");
    let mut group = criterion.benchmark_group("bench");
    group.throughput(Throughput::Elements(u64::from(BREATH_MS)));
    group.measurement_time(Duration::from_secs(3)).sample_size(30);
    group.bench_function("closed loop R20C20, simulated ms", |b| {
        b.iter(|| black_box(breath(&mut bench)));
    });
    group.finish();
}

criterion_group!(benches, closed_loop);
criterion_main!(benches);
