//! The three stages of a round; each first looks for the results of an earlier, stopped run.

use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::{
    MakeSource, Outcome, PipelineConfig, PipelineError, Round, Studied, TrainedOnce, of_round, training,
};
use crate::controller::learned::Learned;
use crate::controller::{PlantModels, TrainConfig, Trainable, Training};
use crate::simulator::episode::{Episode, episodes, split};
use crate::simulator::fit::{FIT, Fit, FitConfig};
use crate::simulator::model::Simulator;
use crate::simulator::open_loop::{OpenLoop, open_loop};
use data::recording::Recording;
use data::workspace::Workspace;
use progress::{Progress, Task};
use ventilator::collect::{COLLECT, CollectConfig, CollectError, Collected, collect};
use ventilator::seeds;

/// Minimum number of complete breaths for a fit.
const BREATHS_NEEDED: usize = 8;

/// A run in progress.
pub(super) struct Run<'a, C: Trainable> {
    config: &'a PipelineConfig,
    sources: &'a [MakeSource<'a, C::Law>],
    folder: Option<&'a Workspace>,
    progress: Progress<'a>,
    recordings: Vec<Recording>,
    /// Simulators of each plant, the held-out one last.
    simulators: Vec<Vec<Simulator>>,
    learned: Option<Learned<C>>,
    rounds: Vec<Round>,
    complete: bool,
}

/// Results of a round's fit besides the simulators.
#[derive(Clone, Debug, Serialize, Deserialize)]
struct Fitted {
    curve: Vec<f64>,
    open_loop: Vec<OpenLoop>,
}

impl<'a, C: Trainable> Run<'a, C> {
    pub(super) fn new(
        config: &'a PipelineConfig,
        sources: &'a [MakeSource<'a, C::Law>],
        folder: Option<&'a Workspace>,
        progress: &Progress<'a>,
    ) -> Self {
        Self {
            config,
            sources,
            folder,
            progress: *progress,
            recordings: Vec::new(),
            simulators: Vec::new(),
            learned: None,
            rounds: Vec::new(),
            complete: true,
        }
    }

    /// Runs one round; false if it was stopped.
    pub(super) fn round(&mut self, round: usize) -> Result<bool, PipelineError> {
        let (breaths, aborts) = self.collect(round)?;
        if self.stopped() {
            return Ok(false);
        }
        let Some(fitted) = self.fit(round)? else { return Ok(false) };
        let TrainedOnce { learned, improved, curve, .. } = self.train(round)?;
        self.rounds.push(Round {
            breaths,
            aborts,
            fit_curve: fitted.curve,
            open_loop: fitted.open_loop,
            train_curve: curve,
            validation: learned.origin.validation,
            base: learned.origin.base,
            improved,
        });
        self.learned = Some(learned);
        Ok(!self.stopped())
    }

    fn stopped(&mut self) -> bool {
        let stopped = self.progress.stopped();
        self.complete &= !stopped;
        stopped
    }

    /// The results at the end of the run.
    pub(super) fn outcome(self) -> Result<Outcome<C>, PipelineError> {
        let learned = self.learned.ok_or(PipelineError::Stopped)?;
        let plants = self.recordings.into_iter().zip(self.simulators);
        Ok(Outcome {
            plants: plants.map(|(recording, simulators)| Studied { recording, simulators }).collect(),
            learned,
            rounds: self.rounds,
            hold_out: self.config.hold_out,
            complete: self.complete,
        })
    }

    /// Records or loads the round's breaths on every plant; returns the numbers of complete and aborted breaths.
    fn collect(&mut self, round: usize) -> Result<(usize, usize), PipelineError> {
        let breaths = self.config.collect.breaths;
        let task = self.progress.round(round).task(COLLECT, breaths * self.sources.len());
        let recordings: Vec<Recording> = (0..self.sources.len())
            .into_par_iter()
            .map(|plant| self.recorded(round, plant, &task))
            .collect::<Result<_, _>>()?;
        let breaths = recordings.iter().map(|recording| recording.inspirations().len()).sum();
        let all: usize = recordings.iter().map(|recording| recording.breaths().len()).sum();
        if self.recordings.is_empty() {
            self.recordings = recordings;
        } else {
            for (earlier, recording) in self.recordings.iter_mut().zip(&recordings) {
                earlier.append(recording)?;
            }
        }
        Ok((breaths, all - breaths))
    }

    /// A plant's recording of the round.
    fn recorded(&self, round: usize, plant: usize, task: &Task<'_>) -> Result<Recording, PipelineError> {
        let file =
            self.folder.map(|folder| of_round(folder, round).path(&format!("recording-{plant}.parquet")));
        if let Some(file) = file.as_ref().filter(|file| file.exists()) {
            task.advance(self.config.collect.breaths);
            return Ok(Recording::load(file)?);
        }
        let collected = match (self.record(round, plant, task), &file) {
            (Err(PipelineError::Collect(CollectError::Interrupted { reason, collected })), Some(file)) => {
                let file = file.with_extension("partial.parquet");
                collected.recording.save(&file)?;
                let (breaths, file) = (collected.breaths, file.display().to_string());
                return Err(PipelineError::Interrupted { reason, breaths, file });
            }
            (outcome, _) => outcome?,
        };
        if let (Some(file), false) = (&file, task.stopped()) {
            collected.recording.save(file)?;
        }
        Ok(collected.recording)
    }

    fn record(&self, round: usize, plant: usize, task: &Task<'_>) -> Result<Collected, PipelineError> {
        let seed = seeds::collection(self.config.seed, of_plant(round as u64, plant));
        let mut source = (self.sources[plant])(seed)?;
        let controller = match &self.learned {
            Some(learned) => learned.controller.law(),
            None => self.config.collector::<C>()?,
        };
        let config = CollectConfig { seed, ..self.config.collect.clone() };
        Ok(collect(source.as_mut(), &controller, &config, &task.part())?)
    }

    /// Fits each plant's ensemble to all of its recordings; `None` if stopped.
    fn fit(&mut self, round: usize) -> Result<Option<Fitted>, PipelineError> {
        if let Some(fitted) = self.fitted(round)? {
            return Ok(Some(fitted));
        }
        let episodes: Vec<Vec<Episode>> =
            self.recordings.iter().map(|recording| episodes(recording, self.config.timing())).collect();
        if let Some(found) = episodes.iter().map(Vec::len).find(|found| *found < BREATHS_NEEDED) {
            return Err(PipelineError::TooFewBreaths { found, needed: BREATHS_NEEDED });
        }
        let parts: Vec<_> = episodes.iter().map(|episodes| split(episodes, self.config.hold_out)).collect();
        let members = self.config.ensemble.max(1) + 1;
        let epochs = self.fit_config(round, 0, 0, !self.simulators.is_empty()).epochs;
        let task = self.progress.round(round).task(FIT, epochs * parts.len() * members);
        let fits: Vec<Option<(Simulator, Vec<f64>)>> = (0..parts.len() * members)
            .into_par_iter()
            .map(|job| {
                let (plant, member) = (job / members, job % members);
                self.fit_member(round, plant, member, &parts[plant].0, &task)
            })
            .collect();
        let Some(fits) = fits.into_iter().collect::<Option<Vec<_>>>() else {
            self.stopped();
            return Ok(None);
        };
        let fitted = Fitted {
            curve: fits[0].1.clone(),
            open_loop: (0..)
                .zip(&fits)
                .map(|(job, (simulator, _))| open_loop(simulator, &parts[job / members].1))
                .collect(),
        };
        let mut simulators = fits.into_iter().map(|(simulator, _)| simulator);
        self.simulators = (0..parts.len()).map(|_| simulators.by_ref().take(members).collect()).collect();
        if let Some(folder) = self.folder.map(|folder| of_round(folder, round)) {
            for (plant, simulators) in self.simulators.iter().enumerate() {
                for (member, simulator) in simulators.iter().enumerate() {
                    simulator.save(&folder.path(&simulator_name(plant, member)))?;
                }
            }
            folder.save("fit.json", &fitted)?;
        }
        Ok(Some(fitted))
    }

    /// The round's simulators, if an earlier run has saved them.
    fn fitted(&mut self, round: usize) -> Result<Option<Fitted>, PipelineError> {
        let Some(folder) = self.folder.map(|folder| of_round(folder, round)) else { return Ok(None) };
        let Some(fitted) = folder.load::<Fitted>("fit.json")? else { return Ok(None) };
        let plants = self.sources.len();
        let of_plant = |plant| {
            let members = 0..fitted.open_loop.len() / plants;
            members
                .map(|member| Simulator::load(&folder.path(&simulator_name(plant, member))))
                .collect::<Result<Vec<_>, _>>()
        };
        self.simulators = (0..plants).map(of_plant).collect::<Result<_, _>>()?;
        Ok(Some(fitted))
    }

    /// Fits one member of a plant's ensemble; `None` if stopped.
    fn fit_member(
        &self,
        round: usize,
        plant: usize,
        member: usize,
        train: &[&Episode],
        task: &Task<'_>,
    ) -> Option<(Simulator, Vec<f64>)> {
        let warm = self.simulators.get(plant).and_then(|members| members.get(member));
        let config = self.fit_config(round, plant, member, warm.is_some());
        let mut fit = Fit::new(self.config.architecture, train, config, warm);
        let mut curve = Vec::new();
        while let Some(loss) = fit.epoch() {
            curve.push(loss);
            task.advance(1);
            if task.stopped() {
                return None;
            }
        }
        Some((fit.simulator(&self.recordings[plant].provenance.plant), curve))
    }

    /// Members differ only by their seed; a warm start uses fewer, smaller steps.
    fn fit_config(&self, round: usize, plant: usize, member: usize, warm: bool) -> FitConfig {
        let seed = if member == self.config.ensemble.max(1) {
            seeds::held_out_simulator(self.config.seed)
        } else {
            seeds::training(self.config.seed, of_plant(member as u64, plant))
        };
        let mut config = FitConfig { seed: seed.wrapping_add(round as u64), ..self.config.fit };
        if warm {
            // The recording has grown, so an epoch has more steps than before.
            let share = self.config.refit_share / (round + 1) as f32;
            config.epochs = ((config.epochs as f32 * share) as usize).max(1);
            config.adam.rate *= self.config.refit_share;
        }
        config
    }

    /// Trains the controller on all members except the last.
    fn train(&mut self, round: usize) -> Result<TrainedOnce<C>, PipelineError> {
        let training = self.training(round)?;
        let folder = self.folder.map(|folder| of_round(folder, round));
        let progress = self.progress.round(round);
        let plants: Vec<&str> = self.recordings.iter().map(|r| r.provenance.plant.as_str()).collect();
        let trained =
            training::train(training, plants.join(" "), self.config.seed, folder.as_ref(), &progress)?;
        self.stopped();
        if let Some(folder) = folder {
            trained.learned.save(&folder.path("controller.safetensors"))?;
        }
        Ok(trained)
    }

    fn training(&self, round: usize) -> Result<Training<C>, PipelineError> {
        let warm: Option<Vec<f32>> = self
            .learned
            .as_ref()
            .map(|learned| learned.controller.parameters())
            .filter(|weights: &Vec<f32>| weights.iter().any(|w| w.abs() > 0.0));
        let mut config = TrainConfig {
            seed: seeds::training(self.config.seed, 1000 + round as u64),
            ..self.config.train.clone()
        };
        if warm.is_some() {
            config.adam.rate *= 0.5;
        }
        let plants: Option<Vec<PlantModels<'_>>> = self
            .simulators
            .iter()
            .map(|simulators| {
                let (held_out, trained_on) = simulators.split_last()?;
                (!trained_on.is_empty()).then_some(PlantModels { trained_on, held_out })
            })
            .collect();
        let plants = plants.ok_or(PipelineError::Stopped)?;
        Ok(Training::of(self.config.specification::<C>()?, &plants, config, warm.as_deref())?)
    }
}

fn simulator_name(plant: usize, member: usize) -> String {
    format!("simulator-{plant}-{member}.safetensors")
}

/// A number that differs between plants; the first plant keeps `number`.
fn of_plant(number: u64, plant: usize) -> u64 {
    number + ((plant as u64) << 32)
}
