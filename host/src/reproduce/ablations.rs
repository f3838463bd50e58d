//! Ablations on one lung: what each part of the system is worth. Each variant differs from the lung's pipeline in one thing.

use serde::{Deserialize, Serialize};
use shared::control::Controller;
use shared::control::features::FeatureSpec;
use shared::control::pid::{Pid, PidGains};
use shared::explore::Exploration;

use super::study::Study;
use super::{ReproduceError, Reproduction, lungs};
use crate::bench::BenchConfig;
use crate::evaluate::{Plan, evaluate};
use crate::pipeline::PipelineConfig;
use crate::simulator::fit::FitConfig;
use crate::simulator::model::Architecture;
use crate::simulator::stitched::StitchedConfig;

/// Control period at which the authors' simulator steps, microseconds.
const AUTHORS_PERIOD_US: u32 = 30_000;

/// A variant and what became of it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Ablation {
    /// What is varied.
    pub group: String,
    /// The variant.
    pub variant: String,
    /// Score on the true bench, cmH2O.
    pub score: f64,
    /// Score of the PID underneath at the same control period, cmH2O.
    pub pid: f64,
    /// Open-loop distance of the simulator that was kept, cmH2O.
    pub open_loop: f64,
    /// Breaths recorded.
    pub breaths: usize,
}

/// A variant to run.
struct Variant {
    group: &'static str,
    name: String,
    config: PipelineConfig,
}

/// Trains and scores every variant on the lung in the middle of the list.
pub(super) fn ablations(study: &Study<'_>) -> Result<Vec<Ablation>, ReproduceError> {
    let index = study.lungs().len() / 2;
    let gains = lungs::tuned(study)?.lungs[index].pid.gains;
    let bench = &study.lungs()[index];
    let run = |variant: Variant| {
        let name = format!("ablations/{}-{}", variant.group, variant.name).replace(' ', "-");
        study.keep(&name, || ablation(study, bench, &variant, &name))
    };
    variants(study.reproduction, gains).into_iter().map(run).collect()
}

/// What the folder holds, if it holds every variant.
pub(super) fn kept(study: &Study<'_>) -> Result<Option<Vec<Ablation>>, ReproduceError> {
    let variants = variants(study.reproduction, PidGains::default()).into_iter();
    variants.map(|v| study.kept(&format!("ablations/{}-{}", v.group, v.name).replace(' ', "-"))).collect()
}

fn ablation(
    study: &Study<'_>,
    bench: &BenchConfig,
    variant: &Variant,
    folder: &str,
) -> Result<Ablation, ReproduceError> {
    let config = &variant.config;
    let outcome = lungs::train(study, std::slice::from_ref(bench), config, folder)?;
    let plan = Plan { period_us: config.period_us, ..study.plan() };
    let score = |controller: &Controller| evaluate(bench, controller, &plan).map(|e| e.mean.score);
    let last = outcome.rounds.last().and_then(|round| round.open_loop.first());
    Ok(Ablation {
        group: variant.group.to_owned(),
        variant: variant.name.clone(),
        score: score(&Controller::Residual(outcome.learned.controller))?,
        pid: score(&Controller::Pid(Pid::new(config.gains, config.period_us)?))?,
        open_loop: last.map_or(f64::NAN, |distance| distance.truth.unwrap_or(distance.measured)),
        breaths: outcome.rounds.iter().map(|round| round.breaths).sum(),
    })
}

fn variants(reproduction: &Reproduction, gains: PidGains) -> Vec<Variant> {
    let Reproduction { seed, budget, .. } = reproduction;
    let base = PipelineConfig { gains, seed: *seed, rounds: 1, ..budget.lung.clone() };
    let mut all = Vec::new();
    let mut add = |group, name: String, change: &dyn Fn(&mut PipelineConfig)| {
        let mut config = base.clone();
        change(&mut config);
        all.push(Variant { group, name, config });
    };
    for lambda in [0.0, 0.1, 0.3, 1.0] {
        add("lambda", lambda.to_string(), &|config| config.lambda = lambda);
    }
    add("lambda", "network alone".into(), &|config| {
        (config.collector, config.gains) = (Some(config.gains), PidGains::default());
    });
    let explorations = [
        ("none", None),
        ("triangular", Some(0.0)),
        ("boundary", Some(1.0)),
        ("both", Some(Exploration::default().boundary_probability)),
    ];
    for (name, boundary) in explorations {
        add("exploration", name.into(), &|config| {
            config.collect.exploration = boundary
                .map(|boundary_probability| Exploration { boundary_probability, ..Exploration::default() });
        });
    }
    for breaths in [16, 32, 64, 128, 256] {
        add("breaths", breaths.to_string(), &|config| config.collect.breaths = breaths);
    }
    for rounds in 1..=3 {
        add("rounds", rounds.to_string(), &|config| config.rounds = rounds);
    }
    let histories: [(&str, [u8; 8], [u8; 6]); 3] = [
        ("8 ms", [0, 1, 2, 3, 4, 5, 6, 8], [1, 2, 3, 4, 6, 8]),
        ("32 ms", [0, 1, 2, 4, 8, 16, 24, 32], [1, 2, 4, 8, 16, 32]),
        ("64 ms", [0, 1, 2, 4, 8, 16, 32, 64], [1, 2, 4, 8, 16, 64]),
    ];
    for (name, error_taps, command_taps) in histories {
        add("history", name.into(), &|config| {
            config.features = Some(FeatureSpec { error_taps, command_taps, ..FeatureSpec::default() });
        });
    }
    for (name, architecture) in [
        ("ours at 30 ms", None),
        ("authors at 30 ms", Some(Architecture::Stitched(StitchedConfig::for_period(AUTHORS_PERIOD_US)))),
    ] {
        add("simulator", name.into(), &|config| {
            let slow = PipelineConfig::for_period(AUTHORS_PERIOD_US);
            config.period_us = slow.period_us;
            config.architecture = architecture.unwrap_or(slow.architecture);
            if architecture.is_some() {
                config.fit = FitConfig::authors();
            }
        });
    }
    all
}
