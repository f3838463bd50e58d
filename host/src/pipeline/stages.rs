//! The three stages of a round, each of which first looks for what an earlier, stopped run has left.

use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};

use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use shared::control::Controller;

use super::{Folder, MakeSource, Observer, Outcome, PipelineConfig, PipelineError, Round, Stage};
use crate::collect::{CollectConfig, Collected, collect};
use crate::dataset::Recording;
use crate::evaluate::seeds;
use crate::provenance::git_revision;
use crate::simulator::episode::{Episode, episodes};
use crate::simulator::fit::{Fit, FitConfig, OpenLoop, open_loop, split};
use crate::simulator::model::Simulator;
use crate::train::learned::{Learned, Origin};
use crate::train::{Checkpoint, Progress, TrainConfig, Trained, Training};
use crate::watch::Watch;

/// Least number of complete breaths worth a fit.
const BREATHS_NEEDED: usize = 8;

/// A run under way.
pub(super) struct Run<'a> {
    config: &'a PipelineConfig,
    source: MakeSource<'a>,
    folder: Option<&'a Folder>,
    observer: Observer<'a>,
    stop: &'a AtomicBool,
    recording: Option<Recording>,
    simulators: Vec<Simulator>,
    learned: Option<Learned>,
    rounds: Vec<Round>,
    complete: bool,
}

/// What the fit of a round leaves beside the simulators.
#[derive(Clone, Debug, Serialize, Deserialize)]
struct Fitted {
    curve: Vec<f64>,
    open_loop: Vec<OpenLoop>,
}

/// A training's checkpoint with its curve.
#[derive(Clone, Debug, Serialize, Deserialize)]
struct Pause {
    checkpoint: Checkpoint,
    curve: Vec<Progress>,
}

impl<'a> Run<'a> {
    pub(super) fn new(
        config: &'a PipelineConfig,
        source: MakeSource<'a>,
        folder: Option<&'a Folder>,
        observer: Observer<'a>,
        stop: &'a AtomicBool,
    ) -> Self {
        Self {
            config,
            source,
            folder,
            observer,
            stop,
            recording: None,
            simulators: Vec::new(),
            learned: None,
            rounds: Vec::new(),
            complete: true,
        }
    }

    /// One round; false when it was stopped.
    pub(super) fn round(&mut self, round: usize) -> Result<bool, PipelineError> {
        let (breaths, aborts) = self.collect(round)?;
        if self.stopped() {
            return Ok(false);
        }
        let Some(fitted) = self.fit(round)? else { return Ok(false) };
        let (trained, train_curve) = self.train(round)?;
        self.rounds.push(Round {
            breaths,
            aborts,
            fit_curve: fitted.curve,
            open_loop: fitted.open_loop,
            train_curve,
            validation: trained.validation,
            base: trained.base,
            improved: trained.improved,
        });
        Ok(!self.stopped())
    }

    fn stopped(&mut self) -> bool {
        let stopped = self.stop.load(Ordering::Relaxed);
        self.complete &= !stopped;
        stopped
    }

    /// What there is at the end.
    pub(super) fn outcome(self) -> Result<Outcome, PipelineError> {
        match (self.recording, self.learned) {
            (Some(recording), Some(learned)) => Ok(Outcome {
                recording,
                simulators: self.simulators,
                learned,
                rounds: self.rounds,
                hold_out: self.config.hold_out,
                complete: self.complete,
            }),
            _ => Err(PipelineError::Stopped),
        }
    }

    /// Records the round's breaths, or takes those already recorded; complete and aborted breaths.
    fn collect(&mut self, round: usize) -> Result<(usize, usize), PipelineError> {
        let file = self.folder.map(|folder| folder.file(round, "recording.parquet"));
        let recording = match &file {
            Some(file) if file.exists() => Recording::load(file)?,
            _ => {
                let collected = self.record(round)?;
                if let (Some(file), false) = (&file, self.stopped()) {
                    collected.recording.save(file)?;
                }
                collected.recording
            }
        };
        let breaths = recording.inspirations().len();
        let aborts = recording.breaths().len() - breaths;
        match &mut self.recording {
            Some(all) => all.append(&recording)?,
            None => self.recording = Some(recording),
        }
        Ok((breaths, aborts))
    }

    fn record(&self, round: usize) -> Result<Collected, PipelineError> {
        let seed = seeds::collection(self.config.seed, round as u64);
        let mut source = (self.source)(seed)?;
        let controller = match &self.learned {
            Some(learned) => Controller::Residual(learned.controller.clone()),
            None => self.config.base()?,
        };
        let config = CollectConfig { seed, ..self.config.collect.clone() };
        let progress = |done, total| (self.observer)(round, Stage::Collect, done as usize, total as usize);
        Ok(collect(source.as_mut(), &controller, &config, &Watch::new(&progress, self.stop))?)
    }

    /// Fits the ensemble to everything recorded; none when stopped.
    fn fit(&mut self, round: usize) -> Result<Option<Fitted>, PipelineError> {
        if let Some(fitted) = self.fitted(round)? {
            return Ok(Some(fitted));
        }
        let Some(recording) = &self.recording else { return Ok(None) };
        let episodes = episodes(recording, self.config.timing());
        if episodes.len() < BREATHS_NEEDED {
            let (found, needed) = (episodes.len(), BREATHS_NEEDED);
            return Err(PipelineError::TooFewBreaths { found, needed });
        }
        let (train, held_out) = split(&episodes, self.config.hold_out);
        let plant = recording.provenance.plant.clone();
        let done = AtomicUsize::new(0);
        let members: Vec<Option<(Simulator, Vec<f64>)>> = (0..=self.config.ensemble.max(1))
            .into_par_iter()
            .map(|member| self.fit_member(round, member, &train, &plant, &done))
            .collect();
        let Some(members) = members.into_iter().collect::<Option<Vec<_>>>() else {
            self.stopped();
            return Ok(None);
        };
        let fitted = Fitted {
            curve: members[0].1.clone(),
            open_loop: members.iter().map(|(simulator, _)| open_loop(simulator, &held_out)).collect(),
        };
        self.simulators = members.into_iter().map(|(simulator, _)| simulator).collect();
        if let Some(folder) = self.folder {
            for (member, simulator) in self.simulators.iter().enumerate() {
                simulator.save(&folder.file(round, &simulator_name(member)))?;
            }
            folder.save(round, "fit.json", &fitted)?;
        }
        Ok(Some(fitted))
    }

    /// The round's simulators, if an earlier run has left them.
    fn fitted(&mut self, round: usize) -> Result<Option<Fitted>, PipelineError> {
        let Some(folder) = self.folder else { return Ok(None) };
        let Some(fitted) = folder.load::<Fitted>(round, "fit.json")? else { return Ok(None) };
        self.simulators = (0..fitted.open_loop.len())
            .map(|member| Simulator::load(&folder.file(round, &simulator_name(member))))
            .collect::<Result<_, _>>()?;
        Ok(Some(fitted))
    }

    /// One member of the ensemble; none when stopped.
    fn fit_member(
        &self,
        round: usize,
        member: usize,
        train: &[&Episode],
        plant: &str,
        done: &AtomicUsize,
    ) -> Option<(Simulator, Vec<f64>)> {
        let warm = self.simulators.get(member);
        let config = self.fit_config(round, member, warm.is_some());
        let total = config.epochs * (self.config.ensemble.max(1) + 1);
        let mut fit = Fit::new(self.config.architecture, train, config, warm);
        let mut curve = Vec::new();
        while let Some(loss) = fit.epoch() {
            curve.push(loss);
            (self.observer)(round, Stage::Fit, done.fetch_add(1, Ordering::Relaxed) + 1, total);
            if self.stop.load(Ordering::Relaxed) {
                return None;
            }
        }
        Some((fit.simulator(plant), curve))
    }

    /// Members differ by their seed alone; a warm start takes fewer, smaller steps.
    fn fit_config(&self, round: usize, member: usize, warm: bool) -> FitConfig {
        let seed = if member == self.config.ensemble.max(1) {
            seeds::held_out_simulator(self.config.seed)
        } else {
            seeds::training(self.config.seed, member as u64)
        };
        let mut config = FitConfig { seed: seed.wrapping_add(round as u64), ..self.config.fit };
        if warm {
            // The recording has grown, so that an epoch takes more steps than it did.
            let share = self.config.refit_share / (round + 1) as f32;
            config.epochs = ((config.epochs as f32 * share) as usize).max(1);
            config.adam.rate *= self.config.refit_share;
        }
        config
    }

    /// Trains the controller on all members but the last.
    fn train(&mut self, round: usize) -> Result<(Trained, Vec<Progress>), PipelineError> {
        let mut training = self.training(round)?;
        let mut curve = Vec::new();
        let pause = self.folder.map(|folder| folder.load::<Pause>(round, "training.json")).transpose()?;
        if let Some(pause) = pause.flatten() {
            training.resume(pause.checkpoint);
            curve = pause.curve;
        }
        while !self.stopped() {
            let Some(progress) = training.advance() else { break };
            curve.push(progress);
            (self.observer)(round, Stage::Train, progress.iteration, self.config.train.iterations);
            if let Some(folder) = self.folder {
                let pause = Pause { checkpoint: training.checkpoint(), curve: curve.clone() };
                folder.save(round, "training.json", &pause)?;
            }
        }
        let trained = training.finish()?;
        let learned = self.learned(&trained);
        if let Some(folder) = self.folder {
            learned.save(&folder.file(round, "controller.safetensors"))?;
        }
        self.learned = Some(learned);
        Ok((trained, curve))
    }

    fn training(&self, round: usize) -> Result<Training, PipelineError> {
        let warm: Option<Vec<f32>> = self
            .learned
            .as_ref()
            .map(|learned| learned.controller.network().parameters().copied().collect())
            .filter(|weights: &Vec<f32>| weights.iter().any(|w| w.abs() > 0.0));
        let mut config = TrainConfig {
            seed: seeds::training(self.config.seed, 1000 + round as u64),
            ..self.config.train.clone()
        };
        if warm.is_some() {
            config.adam.rate *= 0.5;
        }
        let (held_out, trained_on) = match self.simulators.split_last() {
            Some((last, rest)) if !rest.is_empty() => (last, rest),
            _ => return Err(PipelineError::Stopped),
        };
        Ok(Training::new(self.config.residual(), trained_on, held_out, config, warm.as_deref())?)
    }

    fn learned(&self, trained: &Trained) -> Learned {
        let plant = self.recording.as_ref().map_or_else(String::new, |r| r.provenance.plant.clone());
        Learned {
            controller: trained.controller.clone(),
            origin: Origin {
                plant,
                seed: self.config.seed,
                git_revision: git_revision(),
                validation: trained.validation,
                base: trained.base,
            },
        }
    }
}

fn simulator_name(member: usize) -> String {
    format!("simulator-{member}.safetensors")
}
