//! Ablations on one lung: the contribution of each part. Each variant differs from the lung's pipeline in one respect.

use serde::{Deserialize, Serialize};
use shared::control::Controller;
use shared::control::features::{CLOCK, FEATURES, FeatureSpec, LEAKY, PAST_COMMANDS, PAST_ERRORS};
use shared::control::pid::{Pid, PidGains};
use shared::explore::Exploration;

use super::study::{Piece, Study, piece};
use super::{Reproduction, lungs};
use learn::controller::authors::AuthorsController;
use learn::controller::{ControllerArchitecture, Trainable};
use learn::pipeline::{Outcome, PAPER_PERIOD_US, PipelineConfig, run_on_benches};
use learn::simulator::fit::FitConfig;
use learn::simulator::model::Architecture;
use learn::simulator::stitched::StitchedConfig;
use plant::bench::BenchConfig;
use progress::Progress;
use score::evaluate::{Plan, evaluate, evaluate_law};
use study::Result;

/// The result of a variant.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Ablation {
    /// The group of variants.
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

/// Units of the fleet to train on, and the number of the held-out unit.
const UNITS: (std::ops::RangeInclusive<u32>, u32) = (1..=4, 7);

/// A variant to run.
struct Variant {
    group: &'static str,
    name: String,
    config: PipelineConfig,
    /// Benches to train on.
    benches: Vec<BenchConfig>,
    /// The bench used for scoring.
    judge: BenchConfig,
}

/// Training and scoring of every variant on the lung in the middle of the list.
pub(super) fn pieces<'a>(study: &'a Study<'_>) -> Result<Vec<Piece<'a>>> {
    let gains = lungs::tuned(study)?.lungs[study.middle()].pid.gains;
    let of = |variant: Variant| {
        let place = variant.place();
        piece(move || study.keep(&place, || ablation(study, &variant, &place)))
    };
    Ok(different(study, gains).into_iter().map(of).collect())
}

/// The variants over a PID with these gains, without repetition: groups share the unchanged variant.
fn different(study: &Study<'_>, gains: PidGains) -> Vec<Variant> {
    let mut different: Vec<Variant> = Vec::new();
    for variant in variants(study, gains) {
        if !different.iter().any(|other| other.is(&variant)) {
            different.push(variant);
        }
    }
    different
}

/// Number of different variants, whatever the gains.
pub(super) fn count(study: &Study<'_>) -> usize {
    different(study, PidGains::default()).len()
}

/// The kept results, if the folder contains every variant.
pub(super) fn kept(study: &Study<'_>) -> Result<Option<Vec<Ablation>>> {
    let variants = variants(study, PidGains::default());
    let of = |variant: &Variant| {
        let same = variants.iter().find(|other| other.is(variant)).unwrap_or(variant);
        let found: Option<Ablation> = study.kept(&same.place())?;
        Ok(found.map(|found| variant.named(&found)))
    };
    variants.iter().map(of).collect()
}

impl Variant {
    /// The variant's path in the study's folder.
    fn place(&self) -> String {
        format!("ablations/{}-{}", self.group, self.name).replace(' ', "-")
    }

    /// Whether another one is the same but for its name.
    fn is(&self, other: &Self) -> bool {
        (&self.config, &self.benches, &self.judge) == (&other.config, &other.benches, &other.judge)
    }

    /// The result of an equal variant, under this variant's name.
    fn named(&self, found: &Ablation) -> Ablation {
        Ablation { group: self.group.to_owned(), variant: self.name.clone(), ..found.clone() }
    }
}

fn ablation(study: &Study<'_>, variant: &Variant, folder: &str) -> Result<Ablation> {
    let Variant { config, benches, .. } = variant;
    match config.controller {
        ControllerArchitecture::Ours => {
            scored(study, variant, &lungs::train(study, benches, config, folder)?)
        }
        ControllerArchitecture::Authors { .. } => {
            let outcome = lungs::train_by(study, folder, |run, progress| {
                run_on_benches::<AuthorsController>(config, benches, Some(run), progress)
            })?;
            scored(study, variant, &outcome)
        }
    }
}

/// The scores of a variant's controller and of the PID underneath it.
fn scored<C: Trainable>(study: &Study<'_>, variant: &Variant, outcome: &Outcome<C>) -> Result<Ablation> {
    let config = &variant.config;
    let plan = Plan { period_us: config.period_us, ..study.plan() };
    let pid = Controller::Pid(Pid::new(config.gains, config.period_us)?);
    let law = outcome.learned.controller.law();
    let last = outcome.rounds.last().and_then(|round| round.open_loop.first());
    Ok(Ablation {
        group: variant.group.to_owned(),
        variant: variant.name.clone(),
        score: evaluate_law(&variant.judge, &law, &plan, &Progress::silent())?.mean.score,
        pid: evaluate(&variant.judge, &pid, &plan)?.mean.score,
        open_loop: last.map_or(f64::NAN, |distance| distance.truth.unwrap_or(distance.measured)),
        breaths: outcome.rounds.iter().map(|round| round.breaths).sum(),
    })
}

fn variants(study: &Study<'_>, gains: PidGains) -> Vec<Variant> {
    let Reproduction { seed, budget, .. } = study.reproduction;
    let bench = &study.lungs()[study.middle()];
    let config = PipelineConfig { gains, seed: *seed, ..budget.ablation.clone() };
    let base = Variant {
        group: "",
        name: String::new(),
        config,
        benches: vec![bench.clone()],
        judge: bench.clone(),
    };
    let groups = [residuals, recordings, inputs, architectures, units, simulators];
    groups.iter().flat_map(|group| group(&base)).collect()
}

impl Variant {
    /// A copy with one change.
    fn but(&self, group: &'static str, name: &str, change: impl FnOnce(&mut PipelineConfig)) -> Self {
        let mut config = self.config.clone();
        change(&mut config);
        let (benches, judge) = (self.benches.clone(), self.judge.clone());
        Self { group, name: name.to_owned(), config, benches, judge }
    }
}

/// Variants of the residual's scale and authority.
fn residuals(base: &Variant) -> Vec<Variant> {
    let mut all: Vec<_> = [0.0, 0.1, 0.3, 1.0]
        .iter()
        .map(|lambda| base.but("lambda", &lambda.to_string(), |config| config.lambda = *lambda))
        .collect();
    all.push(base.but("lambda", "network alone", |config| {
        (config.collector, config.gains) = (Some(config.gains), PidGains::default());
    }));
    all
}

/// Variants of the kind and number of recorded breaths.
fn recordings(base: &Variant) -> Vec<Variant> {
    let mut all = Vec::new();
    let explorations = [
        ("none", None),
        ("triangular", Some(0.0)),
        ("boundary", Some(1.0)),
        ("both", Some(Exploration::default().boundary_probability)),
    ];
    for (name, boundary) in explorations {
        all.push(base.but("exploration", name, |config| {
            config.collect.exploration = boundary
                .map(|boundary_probability| Exploration { boundary_probability, ..Exploration::default() });
        }));
    }
    for breaths in [16, 32, 64, 128, 256] {
        all.push(base.but("breaths", &breaths.to_string(), |config| config.collect.breaths = breaths));
    }
    for rounds in 1..=3 {
        all.push(base.but("rounds", &rounds.to_string(), |config| config.rounds = rounds));
    }
    all
}

/// Variants of the network's inputs.
fn inputs(base: &Variant) -> Vec<Variant> {
    let mut all = Vec::new();
    let histories: [(&str, [u8; 7], [u8; 6]); 3] = [
        ("8 ms", [0, 1, 2, 3, 4, 6, 8], [1, 2, 3, 4, 6, 8]),
        ("32 ms", [0, 2, 4, 8, 16, 24, 32], [1, 2, 4, 8, 16, 32]),
        ("64 ms", [0, 2, 4, 8, 16, 32, 64], [1, 2, 4, 8, 16, 64]),
    ];
    for (name, error_taps, command_taps) in histories {
        all.push(base.but("history", name, |config| {
            config.features = Some(FeatureSpec { error_taps, command_taps, ..FeatureSpec::default() });
        }));
    }
    let without: [(&str, Vec<usize>); 5] = [
        ("all", Vec::new()),
        ("no past commands", PAST_COMMANDS.collect()),
        ("no leaky averages", LEAKY.collect()),
        ("no time", CLOCK.collect()),
        // Like the authors' controller, which sees only the last errors.
        ("past errors alone", (PAST_ERRORS.end..FEATURES).collect()),
    ];
    for (name, blind_to) in without {
        all.push(base.but("features", name, |config| config.train.blind_to = blind_to));
    }
    all
}

/// Our controller and the authors', as a residual over the same PID.
fn architectures(base: &Variant) -> Vec<Variant> {
    vec![
        base.but("architecture", "ours", |_| ()),
        base.but("architecture", "authors", |config| {
            config.controller = ControllerArchitecture::authors(config.period_us);
        }),
    ]
}

/// Training on one unit of the fleet or on several (domain randomisation), scored on a unit not used in training.
fn units(base: &Variant) -> Vec<Variant> {
    let unit = |number: u32| {
        let mut bench =
            BenchConfig { name: format!("{}, unit {number}", base.judge.name), ..base.judge.clone() };
        bench.unit.number = number;
        bench
    };
    let (trained_on, judge) = UNITS;
    let several: Vec<_> = trained_on.map(unit).collect();
    // All variants record the same total number of breaths.
    let share = base.config.collect.breaths / several.len();
    let one =
        Variant { benches: vec![several[0].clone()], judge: unit(judge), ..base.but("units", "one", |_| ()) };
    let many = Variant {
        benches: several,
        judge: unit(judge),
        ..base.but("units", "four", |config| config.collect.breaths = share)
    };
    vec![one, many]
}

/// Our simulator and the authors', at the authors' control period.
fn simulators(base: &Variant) -> Vec<Variant> {
    let slow = PipelineConfig::for_period(PAPER_PERIOD_US);
    let theirs = StitchedConfig::for_period(PAPER_PERIOD_US);
    let at_their_period = |config: &mut PipelineConfig| {
        (config.period_us, config.architecture) = (slow.period_us, slow.architecture);
    };
    vec![
        base.but("simulator", "ours at 30 ms", at_their_period),
        base.but("simulator", "authors at 30 ms", |config| {
            at_their_period(config);
            (config.architecture, config.fit) = (Architecture::Stitched(theirs), FitConfig::authors());
        }),
    ]
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeSet;

    fn base() -> Variant {
        let bench = BenchConfig::paper(20.0, 20.0);
        let config = PipelineConfig { rounds: 1, ..PipelineConfig::default() };
        Variant { group: "", name: String::new(), config, benches: vec![bench.clone()], judge: bench }
    }

    #[test]
    fn every_variant_has_a_place_of_its_own() {
        let groups = [residuals, recordings, inputs, architectures, units, simulators];
        let all: Vec<Variant> = groups.iter().flat_map(|group| group(&base())).collect();
        let places: BTreeSet<String> = all.iter().map(Variant::place).collect();
        assert_eq!(places.len(), all.len());
    }

    #[test]
    fn groups_meet_where_nothing_is_varied_and_nowhere_else() {
        let like_base = |group: fn(&Variant) -> Vec<Variant>| {
            let same: Vec<String> =
                group(&base()).into_iter().filter(|v| v.is(&base())).map(|v| v.name).collect();
            same
        };
        assert_eq!(like_base(residuals), ["1"]);
        assert_eq!(like_base(recordings), ["both", "1"]);
        assert_eq!(like_base(inputs), ["all"]);
        assert_eq!(like_base(architectures), ["ours"]);
        assert!(like_base(units).is_empty() && like_base(simulators).is_empty());
    }
}
