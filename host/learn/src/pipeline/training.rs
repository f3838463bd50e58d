//! Training that saves a checkpoint after every validation and continues from it, and training on existing simulators.

use serde::{Deserialize, Serialize};
use shared::checksum::crc32;
use shared::control::residual::{Residual, ResidualSpec};

use super::{PipelineConfig, PipelineError, of_round};
use crate::controller::learned::{Learned, Origin};
use crate::controller::{
    Checkpoint, ControllerArchitecture, CurvePoint, PlantModels, Stepwise, TrainConfig, Trainable, Trained,
    Training,
};
use crate::simulator::model::Simulator;
use data::provenance::git_revision;
use data::workspace::Workspace;
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

/// Results of a training.
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

/// Trains for the configured number of gradient steps or until stopped, for this plant and from this seed; continues from the
/// checkpoint in the folder and saves checkpoints there.
///
/// # Errors
/// A checkpoint that cannot be read or written.
pub fn train<T: Stepwise>(
    mut training: T,
    plant: String,
    seed: u64,
    folder: Option<&Workspace>,
    progress: &Progress<'_>,
) -> Result<TrainedOnce<T::Controller>, PipelineError> {
    let name = "training.json";
    let mut curve = Vec::new();
    if let Some(folder) = folder
        && let Some(pause) = folder.load::<Pause>(name)?
    {
        training.resume(pause.checkpoint);
        curve = pause.curve;
    }
    let (iterations, _) = training.schedule();
    let task = progress.task(TRAIN, iterations);
    task.reach(training.iteration());
    while !task.stopped() {
        let Some(point) = training.advance() else { break };
        curve.push(point);
        task.reach(point.iteration);
        if let Some(folder) = folder {
            let pause = Pause { checkpoint: training.checkpoint().clone(), curve: curve.clone() };
            folder.save(name, &pause)?;
        }
    }
    let Trained { controller, validation, base, improved } = training.finish()?;
    let origin = Origin { plant, seed, git_revision: git_revision(), validation, base };
    let complete = training.iteration() >= iterations;
    Ok(TrainedOnce { learned: Learned { controller, origin }, improved, curve, complete })
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
    folder: &Workspace,
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
        simulators: simulators
            .iter()
            .map(|one| checksum(one.parameters.iter().chain([&one.noise, &one.start_pressure])))
            .collect(),
    })?;
    let plant = PlantModels { trained_on, held_out };
    let training = Training::<C>::of(spec, &[plant], train, None)?;
    let plant = held_out.plant.clone();
    self::train(training, plant, config.seed, Some(&of_round(folder, 0)), progress)
}

/// Checksum of these numbers.
pub fn checksum<'a>(numbers: impl IntoIterator<Item = &'a f32>) -> u32 {
    crc32(&numbers.into_iter().flat_map(|number| number.to_le_bytes()).collect::<Vec<u8>>())
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
    use data::workspace::WorkspaceError;
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
        train_on_simulators(config, simulators, &Workspace::new(folder), progress)
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
            let other = matches!(refused, PipelineError::Workspace(WorkspaceError::OtherRun { .. }));
            assert!(other, "{refused}");
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
