//! Training that saves a checkpoint after every validation and continues from it, and training on existing simulators.

use serde::{Deserialize, Serialize};
use shared::checksum::crc32;
use shared::control::residual::{Residual, ResidualSpec};

use super::{Folder, PipelineConfig, PipelineError};
use crate::controller::learned::{Learned, Origin};
use crate::controller::{
    Checkpoint, ControllerArchitecture, CurvePoint, PlantModels, Stepwise, TrainConfig, Trainable, Trained,
    Training,
};
use crate::simulator::model::Simulator;
use data::provenance::git_revision;
use progress::{Progress, Stage};
use ventilator::seeds;

/// Training a controller: gradient steps.
pub const TRAIN: Stage = Stage("train controller");

/// A checkpoint with the training curve up to it.
#[derive(Clone, Debug, Serialize, Deserialize)]
struct Pause {
    checkpoint: Checkpoint,
    curve: Vec<CurvePoint>,
}

/// Trains for the configured number of gradient steps or until stopped; continues from the checkpoint of a round in the
/// folder and saves checkpoints there.
///
/// # Errors
/// A checkpoint that cannot be read or written.
pub fn train<T: Stepwise>(
    mut training: T,
    iterations: usize,
    round: Option<(&Folder, usize)>,
    progress: &Progress<'_>,
) -> Result<(Trained<T::Controller>, Vec<CurvePoint>), PipelineError> {
    let name = "training.json";
    let mut curve = Vec::new();
    if let Some((folder, round)) = round
        && let Some(pause) = folder.load::<Pause>(round, name)?
    {
        training.resume(pause.checkpoint);
        curve = pause.curve;
    }
    let task = progress.task(TRAIN, iterations);
    task.reach(training.iteration());
    while !task.stopped() {
        let Some(point) = training.advance() else { break };
        curve.push(point);
        task.reach(point.iteration);
        if let Some((folder, round)) = round {
            let pause = Pause { checkpoint: training.checkpoint().clone(), curve: curve.clone() };
            folder.save(round, name, &pause)?;
        }
    }
    Ok((training.finish()?, curve))
}

/// Results of a training on given simulators.
#[derive(Clone, Debug)]
pub struct TrainedOnce<C = Residual> {
    /// The controller.
    pub learned: Learned<C>,
    /// Whether the residual beats its PID on the held-out simulator.
    pub improved: bool,
    /// Training curve.
    pub curve: Vec<CurvePoint>,
    /// Whether the training was completed.
    pub complete: bool,
}

/// The settings that must match to continue a stopped training.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
struct Claim {
    seed: u64,
    residual: ResidualSpec,
    #[serde(default, skip_serializing_if = "ControllerArchitecture::is_ours")]
    controller: ControllerArchitecture,
    train: TrainConfig,
    /// Checksums of the simulators.
    simulators: Vec<u32>,
}

/// Trains a controller of the architecture `C` on existing simulators; the last of several is held out and judges the
/// controller.
///
/// # Errors
/// No simulator, one that is unsuitable for this controller, a configuration for another architecture, or a folder with another
/// seed, configuration or simulators.
pub fn train_on_simulators<C: Trainable>(
    config: &PipelineConfig,
    simulators: &[Simulator],
    folder: &Folder,
    progress: &Progress<'_>,
) -> Result<TrainedOnce<C>, PipelineError> {
    let spec = config.specification::<C>()?;
    for (number, simulator) in simulators.iter().enumerate() {
        suits(simulator, config.period_us)
            .map_err(|reason| PipelineError::Simulator { number: number + 1, reason })?;
    }
    let Some((held_out, rest)) = simulators.split_last() else { return Err(PipelineError::NoSimulator) };
    // A single simulator is also used for validation, under noise not used in training.
    let trained_on = if rest.is_empty() { simulators } else { rest };
    let train = TrainConfig { seed: seeds::training(config.seed, 0), ..config.train.clone() };
    folder.claim(&Claim {
        seed: config.seed,
        residual: config.residual(),
        controller: config.controller,
        train: train.clone(),
        simulators: simulators.iter().map(checksum).collect(),
    })?;
    let plant = PlantModels { trained_on, held_out };
    let training = Training::<C>::of(spec, &[plant], train, None)?;
    let (trained, curve) = self::train(training, config.train.iterations, Some((folder, 0)), progress)?;
    let complete = curve.last().map_or(0, |point| point.iteration) >= config.train.iterations;
    let improved = trained.improved;
    Ok(TrainedOnce {
        learned: learned(trained, held_out.plant.clone(), config.seed),
        improved,
        curve,
        complete,
    })
}

/// A trained controller with its origin.
pub(super) fn learned<C>(trained: Trained<C>, plant: String, seed: u64) -> Learned<C> {
    let Trained { controller, validation, base, .. } = trained;
    Learned { controller, origin: Origin { plant, seed, git_revision: git_revision(), validation, base } }
}

fn checksum(simulator: &Simulator) -> u32 {
    let numbers = simulator.parameters.iter().chain([&simulator.noise, &simulator.start_pressure]);
    crc32(&numbers.flat_map(|number| number.to_le_bytes()).collect::<Vec<u8>>())
}

/// Checks whether a controller of this period can be trained on a simulator; the error is the reason.
fn suits(simulator: &Simulator, period_us: u32) -> Result<(), String> {
    let timing = simulator.architecture.timing();
    if timing.period_us != period_us {
        return Err(format!(
            "was fitted at a control period of {} us, not {period_us}: a controller needs simulators of its own period",
            timing.period_us
        ));
    }
    if simulator.architecture.many_lungs() {
        return Err(
            "is a simulator of many lungs, but a controller is trained on one lung: fit a recording of one lung \
                    with --architecture state-space"
                .to_owned(),
        );
    }
    if timing.channels != 1 {
        return Err(format!("has {} valves to command, but a controller commands only one", timing.channels));
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::{AtomicBool, Ordering};

    use super::*;
    use crate::simulator::first_order;
    use progress::Event;

    fn small() -> PipelineConfig {
        let mut config = PipelineConfig::default();
        config.train.iterations = 12;
        config.train.batch = 8;
        config.train.validate_every = 4;
        config
    }

    fn run(
        config: &PipelineConfig,
        simulators: &[Simulator],
        folder: &std::path::Path,
        progress: &Progress<'_>,
    ) -> Result<TrainedOnce, PipelineError> {
        train_on_simulators(config, simulators, &Folder::new(folder), progress)
    }

    #[test]
    fn a_stopped_training_goes_on_as_if_it_had_not_been_stopped() {
        let folders = tempfile::tempdir().unwrap();
        let simulators = [first_order(1.0), first_order(0.9)];
        let straight = folders.path().join("straight");
        let expected = run(&small(), &simulators, &straight, &Progress::silent()).unwrap();
        assert!(expected.complete);
        let (stop, stopped) = (AtomicBool::new(false), folders.path().join("stopped"));
        let observer = |event: &Event<'_>| {
            stop.fetch_or(event.done >= 4, Ordering::Relaxed);
        };
        let half = run(&small(), &simulators, &stopped, &Progress::new(&observer, &stop)).unwrap();
        assert_eq!((half.complete, half.curve.len()), (false, 1));
        let resumed = run(&small(), &simulators, &stopped, &Progress::silent()).unwrap();
        assert_eq!((resumed.learned, resumed.curve), (expected.learned, expected.curve));
    }

    #[test]
    fn a_folder_of_another_seed_configuration_or_simulator_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        let simulators = [first_order(1.0)];
        let again = |config: &PipelineConfig, simulators: &[Simulator]| {
            run(config, simulators, folder.path(), &Progress::silent())
        };
        again(&small(), &simulators).unwrap();
        let seed = PipelineConfig { seed: 2, ..small() };
        let lambda = PipelineConfig { lambda: 0.5, ..small() };
        let mut longer = small();
        longer.train.iterations = 16;
        for config in [seed, lambda, longer] {
            let refused = again(&config, &simulators).unwrap_err();
            assert!(matches!(refused, PipelineError::OtherRun(_)), "{refused}");
        }
        let refused = again(&small(), &[first_order(0.9)]).unwrap_err().to_string();
        assert!(refused.contains("choose another folder"), "{refused}");
        assert!(again(&small(), &simulators).unwrap().complete);
    }

    #[test]
    fn a_simulator_of_another_period_is_refused_by_its_number() {
        let folder = tempfile::tempdir().unwrap();
        let config = PipelineConfig { period_us: 2000, ..small() };
        let refused = run(&config, &[first_order(1.0)], folder.path(), &Progress::silent()).unwrap_err();
        assert!(refused.to_string().starts_with("simulator 1 was fitted at"), "{refused}");
    }
}
