//! Every controller on every unit.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};
use shared::breath::DEFAULT_PERIOD_US;
use shared::control::Controller;
use shared::control::pid::{Pid, PidGains};
use shared::control::residual::Residual;

use super::controllers::Controllers;
use super::flash::id_of;
use super::{FarmConfig, FarmRun, Rivals, UnitName, Worker};
use crate::error::{Result, StudyError};
use learn::controller::learned::{Learned, Origin};
use learn::pipeline::commission::CommissionRun;
use progress::Progress;
use score::evaluate::{Plan, at_pips, evaluate_source};
use ventilator::collect::CollectConfig;

/// Scores of controllers on units.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Matrix {
    /// The units, in the order of the farm.
    pub units: Vec<UnitName>,
    /// A row for each controller.
    pub rows: Vec<MatrixRow>,
}

/// Scores of a controller on all units.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct MatrixRow {
    /// Name of the controller.
    pub controller: String,
    /// The unit that it was commissioned for, if it was.
    pub commissioned_for: Option<UnitName>,
    /// Its weights; none if it is a PID.
    pub weights_id: Option<String>,
    /// Mean absolute error on each unit, cmH2O; none where it could not be run.
    pub scores: Vec<Option<f64>>,
}

impl Matrix {
    /// The row of a controller.
    pub fn row(&self, controller: &str) -> Option<&MatrixRow> {
        self.rows.iter().find(|row| row.controller == controller)
    }

    /// Mean error of a controller over the units on which every controller was run, cmH2O; none if there is no such unit.
    pub fn mean(&self, row: &MatrixRow) -> Option<f64> {
        let whole = |place: &usize| self.rows.iter().all(|row| row.scores[*place].is_some());
        let scores: Vec<f64> =
            (0..self.units.len()).filter(whole).filter_map(|place| row.scores[place]).collect();
        (!scores.is_empty()).then(|| scores.iter().sum::<f64>() / scores.len() as f64)
    }

    /// The learned controller with the smallest error on a unit, by its place in the farm, and that error, cmH2O.
    pub fn best(&self, place: usize) -> Option<(&MatrixRow, f64)> {
        let scored = |row: &'_ &MatrixRow| row.weights_id.is_some();
        let rows = self.rows.iter().filter(scored).filter_map(|row| Some((row, row.scores[place]?)));
        rows.min_by(|(_, one), (_, two)| one.total_cmp(two))
    }

    /// Score of each unit's own controller, cmH2O.
    pub fn own(&self) -> Vec<Option<f64>> {
        let own = |(place, unit): (usize, &UnitName)| {
            let row = self.rows.iter().find(|row| row.commissioned_for.as_ref() == Some(unit))?;
            row.scores[place]
        };
        self.units.iter().enumerate().map(own).collect()
    }
}

/// A controller of the matrix.
struct Candidate {
    name: String,
    commissioned_for: Option<UnitName>,
    controller: Controller,
    /// Its weights image, not signed yet, and their id, if it is a learned one.
    weights: Option<(Vec<u8>, String)>,
    /// Name under which its scores are kept: that of its gains or weights.
    key: String,
}

/// The matrix, and the image that each unit gets, not signed yet: of the learned controller with the smallest error on it.
pub(super) struct Crosswise {
    pub matrix: Matrix,
    pub images: Vec<Option<Vec<u8>>>,
}

impl FarmRun<'_> {
    /// Evaluates every controller on every unit.
    pub(super) fn crosswise(
        &self,
        controllers: &Controllers,
        rivals: Option<&Rivals>,
        workers: &mut [Worker<'_>],
        progress: &Progress<'_>,
    ) -> Result<Crosswise> {
        let candidates = self.candidates(controllers, rivals)?;
        self.on_all(workers, |worker| self.score_all(worker, &candidates, progress));
        if progress.stopped() {
            return Err(StudyError::Stopped);
        }
        let scores: Result<Vec<BTreeMap<String, f64>>> = workers
            .iter()
            .map(|worker| Ok(worker.folder.load(&worker.scores()?)?.unwrap_or_default()))
            .collect();
        let scores = scores?;
        let row = |candidate: &Candidate| MatrixRow {
            controller: candidate.name.clone(),
            commissioned_for: candidate.commissioned_for.clone(),
            weights_id: candidate.weights.as_ref().map(|(_, id)| id.clone()),
            scores: scores.iter().map(|unit| unit.get(&candidate.key).copied()).collect(),
        };
        let units = self.farm.units.iter().map(|unit| unit.name.clone()).collect();
        let matrix = Matrix { units, rows: candidates.iter().map(row).collect() };
        let image = |place| {
            let (best, _) = matrix.best(place)?;
            let weights = candidates.iter().filter_map(|candidate| candidate.weights.as_ref());
            weights
                .filter(|(_, id)| Some(id) == best.weights_id.as_ref())
                .map(|(image, _)| image.clone())
                .next()
        };
        let images = (0..matrix.units.len()).map(image).collect();
        Ok(Crosswise { matrix, images })
    }

    /// The PIDs, the controller that training started from, the farm's, and each unit's own.
    fn candidates(&self, controllers: &Controllers, rivals: Option<&Rivals>) -> Result<Vec<Candidate>> {
        let mut candidates = vec![pid("known-good PID", self.config.run.collector)?];
        if let Some(rivals) = rivals {
            candidates.push(pid("best single PID", rivals.pid)?);
        }
        let start = Learned { controller: self.start.1.clone(), origin: Origin::default() };
        candidates.push(learned(self.start.0, None, &start)?);
        candidates.push(learned("farm", None, &controllers.farm)?);
        for (unit, own) in &controllers.each {
            candidates.push(learned(&format!("of unit {unit}"), Some(unit), own)?);
        }
        Ok(candidates)
    }

    /// Evaluates all controllers on a unit that have no score there yet.
    fn score_all(
        &self,
        worker: &Worker<'_>,
        candidates: &[Candidate],
        progress: &Progress<'_>,
    ) -> Result<()> {
        let file = worker.scores()?;
        let known = || worker.folder.load::<BTreeMap<String, f64>>(&file);
        let count = || known().ok().flatten().map_or(0, |scores| scores.len());
        let progress = progress.of(worker.unit.name.as_str());
        let FarmConfig { run, breaths_of_learning, scored_breaths, .. } = &self.config;
        let mut plan = plan(run, *breaths_of_learning, *scored_breaths);
        plan.seeds.truncate(1);
        self.persist(worker, &progress, &count, |source, _| {
            for candidate in candidates {
                let mut scores = known()?.unwrap_or_default();
                if scores.contains_key(&candidate.key) {
                    continue;
                }
                if let Some((image, _)) = &candidate.weights {
                    source.know(self.signed(image)?);
                }
                let evaluation = evaluate_source(source, &candidate.controller, &plan, &progress);
                scores.insert(candidate.key.clone(), evaluation?.mean.score);
                worker.folder.save_indented(&file, &scores)?;
            }
            Ok(())
        })
    }
}

/// The breaths of an evaluation.
pub(super) fn plan(run: &CommissionRun, warm_up: usize, breaths: usize) -> Plan {
    let CollectConfig { pips, settings, .. } = &run.collect;
    Plan { waveforms: at_pips(pips, settings), warm_up, breaths, ..Plan::evaluation(run.seed) }
}

fn learned(name: &str, unit: Option<&UnitName>, learned: &Learned<Residual>) -> Result<Candidate> {
    let image = learned.image()?;
    let id = id_of(&image)?;
    Ok(Candidate {
        name: name.to_owned(),
        commissioned_for: unit.cloned(),
        controller: Controller::Residual(learned.controller.clone()),
        weights: Some((image, id.clone())),
        key: format!("weights {id}"),
    })
}

fn pid(name: &str, gains: PidGains) -> Result<Candidate> {
    let PidGains { p, i, d } = gains;
    Ok(Candidate {
        name: name.to_owned(),
        commissioned_for: None,
        controller: Controller::Pid(Pid::new(gains, DEFAULT_PERIOD_US)?),
        weights: None,
        key: format!("PID {p},{i},{d}"),
    })
}
