//! Stability margins of a closed loop, measured by sine injection on the bench.
//!
//! A bench is held at an operating point ([`operating_point`]) under the real control law. An [`injection`] adds a sine to its
//! command, and [`response`] correlates the commands just before and just after the sine with it: their ratio is the loop gain,
//! whatever the law does. [`tuning::stability`] reads the margins from it. [`residual_gain`] bounds what the residual of a learned controller
//! can do to its PID's loop, [`iteration`] certifies learning from breath to breath.
//!
//! The valve's backlash makes the loop gain depend on the amplitude: a sine smaller than the backlash moves nothing, a large one
//! does not notice it. Every loop is therefore measured with two amplitudes.
#![forbid(unsafe_code)]

pub mod connected;
pub mod injection;
pub mod iteration;
mod measured_point;
pub mod operating_point;
pub mod residual_gain;
pub mod response;
#[cfg(test)]
mod tests;

use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use shared::breath::{PAPER_PIPS, period_s};
use shared::control::residual::Residual;
use shared::control::{ControlLaw, Controller};
use shared::settings::Settings;

pub use measured_point::MeasuredPoint;
use operating_point::{HELD_AT_S, OperatingPoint};
use plant::bench::{BenchConfig, BenchError};
use progress::{Progress, Stage, Task};
use residual_gain::ResidualGain;
use response::{Loop, Sweep};
use tuning::stability::{Margins, RequiredMargins};

/// Measuring stability margins: operating points.
pub const MARGINS: Stage = Stage("measure loops");

/// Time in which a loop comes to rest, s: six time constants of the slowest lung of the adult family.
const SETTLE_S: f64 = 20.0;
/// Standard deviation of the pressure reading at rest above which a loop oscillates by itself, cmH2O.
const OSCILLATES_CMH2O: f64 = 1.0;
/// Factor on the amplitude of the second measurement.
const LARGER: f64 = 2.0;

/// The loops of a plant.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct PlantMargins {
    /// Name of the plant.
    pub plant: String,
    /// The loop at every operating point.
    pub points: Vec<MeasuredPoint>,
    /// The worst margins of all points; none if a loop oscillates by itself.
    pub worst: Option<Margins>,
    /// The same for the PID underneath a learned controller.
    pub pid: Option<PidMargins>,
}

/// The loops of the PID underneath a learned controller, and what its residual can do to them.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct PidMargins {
    /// Its loop at every operating point.
    pub points: Vec<MeasuredPoint>,
    /// The worst margins of all operating points; none if a loop oscillates by itself.
    pub worst: Option<Margins>,
    /// The residual's largest incremental gain.
    pub residual: ResidualGain,
}

/// The margins of several plants together.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Overall {
    /// Share of the plants that keep the required margins.
    pub share_robust: f64,
    /// The worst margins of all plants; none if a loop oscillates by itself.
    pub worst: Option<Margins>,
    /// The residual's largest gain on all plants.
    pub residual: Option<ResidualGain>,
}

impl Overall {
    /// That of these plants.
    pub fn of(plants: &[PlantMargins], required: &RequiredMargins) -> Self {
        let robust = plants.iter().filter(|plant| plant.worst.is_some_and(|worst| worst.keeps(required)));
        let worst: Option<Vec<Margins>> = plants.iter().map(|plant| plant.worst).collect();
        let gains = plants.iter().filter_map(|plant| plant.pid.as_ref().map(|pid| pid.residual));
        Self {
            share_robust: robust.count() as f64 / plants.len().max(1) as f64,
            worst: worst.and_then(|all| all.into_iter().reduce(|one, other| one.worst(&other))),
            residual: gains.reduce(|one, other| one.worst(&other)),
        }
    }
}

/// What is measured.
#[derive(Clone, Debug, PartialEq)]
pub struct Question {
    /// Settings of the plateaus on each plant, in the plants' order; without them, those of the paper's six waveforms on every plant.
    pub prescriptions: Option<Vec<Settings>>,
    /// Control period, microseconds.
    pub period_us: u32,
    /// The measurement.
    pub sweep: Sweep,
    /// Seed of the sensor noise.
    pub seed: u64,
}

/// Measures a law on plants, at the operating points of their prescriptions or of the paper's six waveforms, on all threads; with the residual of a learned
/// controller, the PID underneath it too. Plants that are not done when it is stopped are left out.
///
/// # Errors
/// A bench that cannot be built, or a control period that it cannot run.
pub fn measure<C: ControlLaw + Sync>(
    plants: &[BenchConfig],
    law: &C,
    residual: Option<&Residual>,
    question: &Question,
    progress: &Progress<'_>,
) -> Result<Vec<PlantMargins>, BenchError>
where
    C::State: Clone,
{
    let per_plant = if question.prescriptions.is_some() { 1 } else { PAPER_PIPS.len() };
    let task = progress.task(MARGINS, plants.len() * per_plant);
    let on = |(number, plant)| {
        let points = match &question.prescriptions {
            Some(prescriptions) => vec![OperatingPoint::new(plant, &prescriptions[number])?],
            None => OperatingPoint::of_paper(plant)?,
        };
        measure_plant(plant, &points, law, residual, question, &task)
    };
    let plants: Result<Vec<_>, BenchError> = plants.par_iter().enumerate().map(on).collect();
    Ok(plants?.into_iter().flatten().collect())
}

/// Measures a law on one plant at these points; none if it was stopped.
fn measure_plant<C: ControlLaw + Sync>(
    plant: &BenchConfig,
    points: &[OperatingPoint],
    law: &C,
    residual: Option<&Residual>,
    question: &Question,
    task: &Task<'_>,
) -> Result<Option<PlantMargins>, BenchError>
where
    C::State: Clone,
{
    let measured: Result<Vec<_>, BenchError> = points
        .par_iter()
        .map(|point| {
            if task.stopped() {
                return Ok(None);
            }
            let own = measure_point(plant, *point, law, question)?;
            let underneath = |residual: &Residual| {
                measure_point(plant, *point, &Controller::Pid(*residual.pid()), question)
            };
            let pid = residual.map(underneath).transpose()?;
            task.advance(1);
            Ok(Some((own, pid)))
        })
        .collect();
    let Some(measured) = measured?.into_iter().collect::<Option<Vec<_>>>() else { return Ok(None) };
    let (points, pids): (Vec<_>, Vec<_>) = measured.into_iter().unzip();
    let pid = match (residual, pids.into_iter().collect::<Option<Vec<_>>>()) {
        (Some(residual), Some(pids)) => Some(PidMargins {
            worst: worst(&pids),
            residual: ResidualGain::of(residual, plant, &pids, question.seed)?,
            points: pids,
        }),
        _ => None,
    };
    Ok(Some(PlantMargins { plant: plant.name.clone(), worst: worst(&points), points, pid }))
}

/// Measures a law on a plant at one operating point, with both amplitudes.
///
/// # Errors
/// A bench that cannot be built, or a control period that it cannot run.
pub fn measure_point<C: ControlLaw>(
    plant: &BenchConfig,
    point: OperatingPoint,
    law: &C,
    question: &Question,
) -> Result<MeasuredPoint, BenchError>
where
    C::State: Clone,
{
    let period_us = question.period_us;
    let held_tick = (HELD_AT_S / f64::from(period_s(period_us))) as u32;
    let control = Loop { law, seen: point.observation(), period_us, held_tick };
    let (rest, sd) = control.settle(point.bench(plant, period_us, question.seed)?, SETTLE_S);
    let sweep = question.sweep;
    let (response, limited) = control.response(&rest, &sweep);
    let larger = sweep.with_amplitude(LARGER * sweep.amplitude);
    let (doubled, _) = control.response(&rest, &larger);
    let steady = sd <= OSCILLATES_CMH2O;
    Ok(MeasuredPoint {
        point,
        rest_sd_cmh2o: sd,
        margins: Margins::of(&response).filter(|_| steady),
        doubled: Margins::of(&doubled).filter(|_| steady),
        limited,
        response,
    })
}

/// The worst margins of some points; none if one of them has none.
fn worst(points: &[MeasuredPoint]) -> Option<Margins> {
    let margins: Option<Vec<Margins>> = points.iter().map(|point| point.margins).collect();
    margins?.into_iter().reduce(|one, other| one.worst(&other))
}
