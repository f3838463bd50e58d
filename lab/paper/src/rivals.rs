//! Controllers that were tuned or trained for a whole family of plants, on the paper's lungs and on the unseen plants: the family's
//! best PID, the rivals, and the shipped learned controller `adult`. Some of them learn from breath to breath, so
//! each is scored in its first breath from rest and again later.

use serde::{Deserialize, Serialize};
use shared::control::Controller;
use thiserror::Error;

use super::study::{Piece, Study, piece};
use super::unseen;
use laws::rivals::Rival;
use laws::rivals::machine::Machine;
use learn::controller::shipped;
use plant::bench::BenchConfig;
use plant::bench::family::Family;
use score::evaluate::{Plan, Score, evaluate_law};
use study::{Result, StudyError};
use trials::robust::rivals::family_pid;
use ventilator::SourceError;
use ventilator::law::AnyLaw;

/// The family, and the name of the controller trained for it.
const FAMILY: &str = "adult";

/// Scores of a controller on a plant.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Contender {
    /// Name of the controller.
    pub controller: String,
    /// The first breath from rest.
    pub first: Score,
    /// Breaths after those of learning.
    pub later: Score,
}

/// The controllers on a plant.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Contest {
    /// Description of the plant.
    pub plant: String,
    /// The controllers, in the same order on every plant.
    pub contenders: Vec<Contender>,
}

/// The contests on all plants.
pub(super) fn pieces<'a>(study: &'a Study<'_>) -> Result<Vec<Piece<'a>>> {
    let laws = laws(study)?;
    let of = |bench: BenchConfig| {
        let laws = laws.clone();
        piece(move || study.keep(&place(&bench), || contest(study, &bench, &laws)))
    };
    Ok(plants(study).map(of).collect())
}

/// The kept contests: on the lungs of the study, then on the unseen plants; `None` if one is missing.
pub(super) fn kept(study: &Study<'_>) -> Result<Option<Vec<Contest>>> {
    plants(study).map(|bench| study.kept(&place(&bench))).collect()
}

fn plants(study: &Study<'_>) -> impl Iterator<Item = BenchConfig> {
    study.lungs().iter().cloned().chain(unseen::plants().into_iter().map(|(bench, _)| bench))
}

fn place(bench: &BenchConfig) -> String {
    format!("rivals/{}", bench.name)
}

/// The controllers by name.
fn laws(study: &Study<'_>) -> Result<Vec<(&'static str, AnyLaw)>> {
    let (family, period_us) = (Family::find(FAMILY)?, study.plan().period_us);
    let pid = AnyLaw::new(
        study.pid(family_pid(&family, &family.listed(), &study.progress).map_err(StudyError::other)?)?,
    );
    let mut laws = vec![("family's PID", pid)];
    for rival in Rival::ALL {
        let law = rival.law(&rival.tuned(), Machine::of(&family.nominal()), period_us);
        laws.push((rival.name(), law.map_err(StudyError::other)?));
    }
    laws.push((FAMILY, AnyLaw::new(shipped()?)));
    Ok(laws)
}

/// The program has no controller with the family's name.
#[derive(Debug, Error)]
#[error("no controller {FAMILY} comes with this program")]
struct NotShipped;

/// The shipped learned controller of the family.
pub(super) fn shipped() -> Result<Controller> {
    let residual = shipped::residual(FAMILY).ok_or_else(|| StudyError::other(NotShipped))?;
    Ok(Controller::Residual(residual))
}

fn contest(study: &Study<'_>, bench: &BenchConfig, laws: &[(&'static str, AnyLaw)]) -> Result<Contest> {
    let (first, later) = plans(study);
    let subject = place(bench);
    let contender = |(name, law): &(&str, AnyLaw)| {
        let score = |plan: &Plan| match evaluate_law(bench, law, plan, &study.progress.of(&subject)) {
            Err(SourceError::Stopped) => Err(StudyError::Stopped),
            evaluated => Ok(evaluated?.mean),
        };
        Ok(Contender { controller: (*name).to_owned(), first: score(&first)?, later: score(&later)? })
    };
    let contenders = laws.iter().map(contender).collect::<Result<_>>()?;
    Ok(Contest { plant: bench.name.clone(), contenders })
}

/// The first breath, and those after learning, under one sequence of the study's noise.
fn plans(study: &Study<'_>) -> (Plan, Plan) {
    let mut plan = study.plan();
    plan.seeds.truncate(1);
    let first = Plan { warm_up: 0, breaths: 1, ..plan.clone() };
    (first, Plan { warm_up: study.reproduction.budget.breaths_of_learning, ..plan })
}
