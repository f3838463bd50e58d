//! Lungs and ventilators not used in training: between and beyond the trained lungs, with two compartments, a leak, a
//! slower valve, another unit of the fleet, or a cough.

use serde::{Deserialize, Serialize};
use shared::control::Controller;

use super::study::{Piece, Study, piece};
use super::{Reproduction, generalist};
use plant::bench::{BenchConfig, CompartmentConfig};
use score::baselines::tune_pid;
use score::evaluate::{Evaluation, Plan};
use study::{Result, StudyError};

/// A plant not used in training.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(super) struct Unseen {
    /// Description of the plant.
    pub(super) plant: String,
    /// Whether R and C are within the trained range and everything else is as in training.
    pub(super) inside: bool,
    pub(super) pid: Evaluation,
    pub(super) single_pid: Evaluation,
    pub(super) generalist: Evaluation,
}

/// Scores of the generalist and of the single PID on each plant.
pub(super) fn pieces<'a>(study: &'a Study<'_>) -> Result<Vec<Piece<'a>>> {
    let (learned, single) = generalist::with_rival(study)?;
    let of = |(bench, inside): (BenchConfig, bool)| {
        let (learned, single) = (learned.clone(), single.clone());
        piece(move || study.keep(&place(&bench), || plant(study, &bench, inside, &learned, &single)))
    };
    Ok(plants().into_iter().map(of).collect())
}

/// The kept results, if the folder contains every plant.
pub(super) fn kept(study: &Study<'_>) -> Result<Option<Vec<Unseen>>> {
    plants().iter().map(|(bench, _)| study.kept(&place(bench))).collect()
}

fn place(bench: &BenchConfig) -> String {
    format!("unseen/{}", bench.name)
}

fn plant(
    study: &Study<'_>,
    bench: &BenchConfig,
    inside: bool,
    learned: &Controller,
    single: &Controller,
) -> Result<Unseen> {
    let Reproduction { seed, budget, .. } = study.reproduction;
    let subject = place(bench);
    let progress = study.progress.of(&subject);
    let own = tune_pid(std::slice::from_ref(bench), &budget.search, &Plan::tuning(*seed), &progress)?;
    if !own.complete {
        return Err(StudyError::Stopped);
    }
    Ok(Unseen {
        plant: bench.name.clone(),
        inside,
        pid: study.evaluate(bench, &study.pid(own.over_all.pid.gains)?)?,
        single_pid: study.evaluate(bench, single)?,
        generalist: study.evaluate(bench, learned)?,
    })
}

/// The plants, and whether each is within the trained range.
pub(super) fn plants() -> Vec<(BenchConfig, bool)> {
    let inside = [(10.0, 15.0), (35.0, 30.0), (30.0, 12.0), (12.0, 40.0)];
    let beyond = [(3.0, 20.0), (80.0, 20.0), (20.0, 80.0), (20.0, 6.0)];
    let changed = |name: &str, change: fn(&mut BenchConfig)| {
        let mut bench = BenchConfig { name: format!("R20C20, {name}"), ..BenchConfig::paper(20.0, 20.0) };
        change(&mut bench);
        bench
    };
    let others = [
        changed("two compartments", |bench| {
            let half = bench.lung.first.compliance_ml_per_cmh2o / 2.0;
            bench.lung.first.compliance_ml_per_cmh2o = half;
            bench.lung.second = Some(CompartmentConfig {
                resistance_cmh2o_per_l_s: 50.0,
                compliance_ml_per_cmh2o: half,
                ..CompartmentConfig::default()
            });
        }),
        changed("a leak", |bench| bench.circuit.leak_l_per_s_at_30_cmh2o = 0.1),
        changed("a slower valve", |bench| bench.valve.lag_ms *= 1.5),
        changed("unit 7 of the fleet", |bench| bench.unit.number = 7),
        changed("a cough", |bench| {
            // In the first scored breath.
            (bench.patient.cough_cmh2o, bench.patient.cough_at_s) = (20.0, 3.4);
        }),
    ];
    let paper = |(r, c): (f64, f64)| BenchConfig::paper(r, c);
    let inside = inside.map(|lung| (paper(lung), true));
    inside.into_iter().chain(beyond.map(paper).into_iter().chain(others).map(|b| (b, false))).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_plant_is_one_that_can_be_built_and_has_a_name_of_its_own() {
        let plants = plants();
        for (bench, _) in &plants {
            bench.validate().unwrap();
        }
        let names: std::collections::BTreeSet<&str> = plants.iter().map(|(b, _)| b.name.as_str()).collect();
        assert_eq!(names.len(), plants.len());
        assert_eq!(plants.iter().filter(|(_, inside)| *inside).count(), 4);
    }
}
