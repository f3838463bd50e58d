//! probe
use learn::controller::{
    FamilyConfig, FamilyModels, FamilyTraining, PlantModels, Stepwise, TrainConfig, Training,
};
use learn::simulator::episode::Episode;
use learn::simulator::fit::{Fit, FitConfig};
use learn::simulator::hybrid::HybridConfig;
use learn::simulator::model::{Architecture, Model, Simulator};
use learn::simulator::open_loop::predict;
use learn::simulator::state_space::StateSpaceConfig;
use learn::simulator::stitched::StitchedConfig;
use learn::simulator::unit::UnitConfig;
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::SeedableRng;
use shared::checksum::crc32;
use shared::control::features::FeatureSpec;
use shared::control::pid::PidGains;
use shared::control::residual::ResidualSpec;
use std::time::Instant;

fn crc(p: &[f32]) -> u32 {
    crc32(&p.iter().flat_map(|x| x.to_le_bytes()).collect::<Vec<u8>>())
}

fn spec(period_us: u32) -> ResidualSpec {
    ResidualSpec {
        period_us,
        gains: PidGains { p: 1.0, i: 15.0, d: 0.0 },
        lambda: 1.0,
        authority: 100.0,
        features: FeatureSpec::for_period(period_us),
    }
}
fn episodes(a: &Architecture, ticks: usize, n: usize) -> Vec<Episode> {
    let t = a.timing();
    let width = t.width();
    (0..n)
        .map(|k| Episode {
            pressure: (0..ticks)
                .map(|i| {
                    5.0 + 20.0 * (1.0 - (-(i as f32) * t.period_us as f32 * 1e-6 / 0.1).exp())
                        + (k as f32 + i as f32).sin()
                })
                .collect(),
            truth: None,
            commands: (0..t.blocks(ticks) * width)
                .map(|i| 0.6 + 0.4 * ((i + 7 * k) as f32 * 0.05).sin())
                .collect(),
            rest: vec![0.1; width],
            start: 5.0,
            plateau: 20.0,
            plateau_command: 0.8,
            pip: 25.0,
            peep: 5.0,
            group: Some((k % 2) as u32),
            ventilator: Some((k % 2) as u32),
            rows: 0..ticks,
            lung: None,
        })
        .collect()
}
fn family(iterations: usize, batch: usize) -> FamilyTraining {
    let units = UnitConfig::for_period(1000, 40);
    let mut parameters = units.initialise();
    for (n, p) in parameters.iter_mut().enumerate() {
        *p += 0.2 * (n as f32).sin();
    }
    let model = Model::new(Architecture::Unit(units), &parameters);
    let models = FamilyModels { trained_on: model.clone(), held_out: model };
    let config = FamilyConfig { iterations, batch, validate_every: iterations, ..FamilyConfig::default() };
    FamilyTraining::new(spec(1000), models, config, None).unwrap()
}
fn unit_fit(batch: usize) -> (Architecture, Vec<Episode>, FitConfig) {
    let a = Architecture::Unit(UnitConfig::for_period(1000, 2));
    (a, episodes(&a, 1000, batch), FitConfig { epochs: 100_000, batch, ..FitConfig::default() })
}
fn main() {
    rayon::ThreadPoolBuilder::new().num_threads(1).build_global().unwrap();
    let mode = std::env::args().nth(1).unwrap();
    let count: usize = std::env::args().nth(2).map_or(1, |c| c.parse().unwrap());
    match mode.as_str() {
        "bits" => {
            let all = [
                Architecture::StateSpace(StateSpaceConfig::for_period(1000, 1)),
                Architecture::Hybrid(HybridConfig {
                    ventilators: 2,
                    groups: 2,
                    ..HybridConfig::for_period(1000, 1)
                }),
                Architecture::Stitched(StitchedConfig::for_period(30_000)),
                Architecture::Unit(UnitConfig::for_period(1000, 2)),
            ];
            for a in all {
                let ticks = if a.timing().period_us == 1000 { 300 } else { 33 };
                let episodes = episodes(&a, ticks, 40);
                let refs: Vec<&Episode> = episodes.iter().collect();
                let mut fit = Fit::new(a, &refs, FitConfig { epochs: 10, ..FitConfig::default() }, None);
                while fit.epoch().is_some() {}
                let fitted: Simulator = fit.simulator("x");
                println!(
                    "fit {:08x} predict {:08x}",
                    crc(&fitted.parameters),
                    crc(&predict(&fitted, &refs).concat())
                );
                println!(
                    "onnx {:08x} {:08x}",
                    crc32(&learn::onnx::simulator(&fitted, None).unwrap()),
                    crc32(&learn::onnx::simulator(&fitted, Some(0)).unwrap_or_default())
                );
                let mut fit =
                    Fit::new(a, &refs, FitConfig { epochs: 3, seed: 9, ..FitConfig::default() }, None);
                while fit.epoch().is_some() {}
                let two = [fitted.clone(), fit.simulator("y")];
                let config =
                    TrainConfig { batch: 16, iterations: 20, validate_every: 10, ..TrainConfig::default() };
                let mut training = Training::new(
                    spec(a.timing().period_us),
                    &[PlantModels { trained_on: &two, held_out: &fitted }],
                    config,
                    None,
                )
                .unwrap();
                while training.advance().is_some() {}
                println!("train {:08x}", crc(training.parameters()));
            }
            let mut f = family(12, 48);
            while f.advance().is_some() {}
            println!("family {:08x}", crc(&f.checkpoint().parameters));
        }
        "family" => {
            let mut f = family(1_000_000, 16);
            f.prepare();
            f.step();
            let start = Instant::now();
            for _ in 0..count {
                f.step();
            }
            println!("family {:.1} us a step", start.elapsed().as_secs_f64() * 1e6 / count as f64);
        }
        "fit" => {
            let (a, e, c) = unit_fit(16);
            let refs: Vec<&Episode> = e.iter().collect();
            let mut fit = Fit::new(a, &refs, c, None);
            fit.epoch();
            let start = Instant::now();
            for _ in 0..count {
                fit.epoch();
            }
            println!("fit {:.1} us an epoch", start.elapsed().as_secs_f64() * 1e6 / count as f64);
        }
        "state" => {
            let a = Architecture::StateSpace(StateSpaceConfig::for_period(1000, 1));
            let s = Simulator {
                architecture: a,
                parameters: a.initialise(&mut ChaCha8Rng::seed_from_u64(1)),
                noise: 0.1,
                start_pressure: 5.0,
                plant: "r".into(),
            };
            let config = TrainConfig { batch: 16, iterations: usize::MAX, ..TrainConfig::default() };
            let mut t = Training::new(
                spec(1000),
                &[PlantModels { trained_on: std::slice::from_ref(&s), held_out: &s }],
                config,
                None,
            )
            .unwrap();
            t.step();
            let start = Instant::now();
            for _ in 0..count {
                t.step();
            }
            println!("state {:.1} us a step", start.elapsed().as_secs_f64() * 1e6 / count as f64);
            let start = Instant::now();
            for _ in 0..count {
                t.rehearse();
            }
            println!("state forward {:.1} us", start.elapsed().as_secs_f64() * 1e6 / count as f64);
        }
        _ => {}
    }
}
