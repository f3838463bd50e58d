//! A lung that changes between two breaths: number of breaths until the controller tracks again.

use serde::{Deserialize, Serialize};
use shared::breath::paper_settings;
use shared::control::Controller;

use super::study::Study;
use super::{generalist, rivals};
use plant::bench::{BenchConfig, PatientConfig};
use score::evaluate::{EVALUATE, InspirationRecord};
use study::Result;
use ventilator::{BenchSource, Source};

/// Number of breaths before the change, and from the change on.
const BREATHS: (usize, usize) = (4, 12);
/// Number of breaths at the end that count as settled.
const SETTLED: usize = 4;
/// Share of the settled score by which a breath may exceed it.
const TOLERANCE: f64 = 0.1;
/// PIP of the waveform, cmH2O.
const PIP: f32 = 25.0;

/// A change of the lung and the scores around it.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(super) struct Change {
    /// Description of the change.
    pub(super) what: String,
    /// Score of each breath under the generalist, mean over noise; the change is before the fifth.
    pub(super) generalist: Vec<f64>,
    /// The same under the best single PID.
    pub(super) single_pid: Vec<f64>,
    /// The same under the shipped controller `adult`, which remembers earlier breaths.
    pub(super) adult: Vec<f64>,
}

impl Change {
    /// Number of breaths from the change up to and including the first one within the tolerance of the settled score.
    pub(super) fn breaths_to_reconverge(scores: &[f64]) -> usize {
        let after = &scores[BREATHS.0..];
        let settled = after[after.len() - SETTLED..].iter().sum::<f64>() / SETTLED as f64;
        let within = |score: &f64| *score <= (1.0 + TOLERANCE) * settled;
        1 + after.iter().rposition(|score| !within(score)).map_or(0, |last| last + 1)
    }
}

/// Runs all changes.
pub(super) fn changes(study: &Study<'_>) -> Result<Vec<Change>> {
    study.keep("changes", || {
        let (learned, single) = generalist::with_rival(study)?;
        let adult = rivals::shipped()?;
        let cases = [
            ("R 20 to 50", 2.5, 1.0),
            ("R 20 to 5", 0.25, 1.0),
            ("C 20 to 10", 1.0, 0.5),
            ("C 20 to 50", 1.0, 2.5),
        ];
        let task = study.progress.of("changes").task(EVALUATE, cases.len());
        cases
            .iter()
            .map(|&(what, resistance, compliance)| {
                task.advance(1);
                let bench = changing(resistance, compliance);
                Ok(Change {
                    what: what.to_owned(),
                    generalist: scores(study, &bench, &learned)?,
                    single_pid: scores(study, &bench, &single)?,
                    adult: scores(study, &bench, &adult)?,
                })
            })
            .collect()
    })
}

/// R20C20, with a change of R and C by these factors.
fn changing(resistance_factor: f64, compliance_factor: f64) -> BenchConfig {
    let change_at_breath = BREATHS.0 as u32 + 1;
    let healthy = PatientConfig::default();
    let patient = PatientConfig { change_at_breath, resistance_factor, compliance_factor, ..healthy };
    BenchConfig { patient, ..BenchConfig::paper(20.0, 20.0) }
}

/// Score of each breath, mean over the plan's noise.
fn scores(study: &Study<'_>, bench: &BenchConfig, controller: &Controller) -> Result<Vec<f64>> {
    let plan = study.plan();
    let settings = paper_settings(PIP);
    let mut sums = vec![0.0; BREATHS.0 + BREATHS.1];
    for seed in &plan.seeds {
        let mut source = BenchSource::new(bench, controller.clone(), &settings, plan.period_us, *seed)?;
        for sum in &mut sums {
            let mut record = InspirationRecord::default();
            source.breath(&settings, &mut |tick| record.add(tick))?;
            *sum += record.score(&settings, plan.period_us).score / plan.seeds.len() as f64;
        }
    }
    Ok(sums)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn breaths_count_until_the_score_stays_within_a_tenth_of_where_it_settles() {
        let mut scores = vec![1.0; BREATHS.0 + BREATHS.1];
        assert_eq!(Change::breaths_to_reconverge(&scores), 1, "never away");
        scores[BREATHS.0] = 3.0;
        assert_eq!(Change::breaths_to_reconverge(&scores), 2);
        scores[BREATHS.0 + 3] = 1.2;
        assert_eq!(Change::breaths_to_reconverge(&scores), 5, "a relapse counts");
        scores[BREATHS.0 - 1] = 9.0;
        assert_eq!(Change::breaths_to_reconverge(&scores), 5, "what was before does not");
    }
}
