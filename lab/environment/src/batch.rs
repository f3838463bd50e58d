//! Environments that step together, on one thread or several.

use std::sync::Arc;

use rayon::prelude::*;
use rayon::{ThreadPool, ThreadPoolBuilder};

use crate::{Environment, EnvironmentError, Episode, Task};

/// Most environments in a batch.
const ENVIRONMENTS_MAX: usize = 1 << 20;
/// Most threads.
const THREADS_MAX: usize = 1024;

/// Environments that step together. One whose episode has ended starts its next one at the next step, whose action it ignores.
#[derive(Debug)]
pub struct Batch {
    environments: Vec<Environment>,
    /// Whether there was a reset.
    started: bool,
    /// None for a single thread, the caller's.
    pool: Option<ThreadPool>,
}

/// Where a step writes, one entry or row for each environment.
#[derive(Debug)]
pub struct Outcomes<'a> {
    /// Observations, row by row.
    pub observations: &'a mut [f32],
    /// Rewards.
    pub rewards: &'a mut [f64],
    /// Whether the episode ended with this step.
    pub ended: &'a mut [bool],
}

impl Batch {
    /// Environments before their first episodes. Environment `i` of `n` runs the episodes `i`, `i + n`, `i + 2 n` ... of the seed.
    ///
    /// # Errors
    /// No environment, too many of them, or threads that cannot be started.
    pub fn new(task: &Arc<Task>, seed: u64, count: usize, threads: usize) -> Result<Self, EnvironmentError> {
        for (name, value, most) in [("num_envs", count, ENVIRONMENTS_MAX), ("threads", threads, THREADS_MAX)]
        {
            if !(1..=most).contains(&value) {
                return Err(EnvironmentError::out_of_bounds(name, value as f64, 1.0, most as f64));
            }
        }
        let build = |threads| {
            let pool = ThreadPoolBuilder::new().num_threads(threads).build();
            pool.map_err(|error| EnvironmentError::Threads { threads, reason: error.to_string() })
        };
        let environment = |index| Environment::of_several(task.clone(), seed, index as u32, count as u32);
        Ok(Self {
            environments: (0..count).map(environment).collect(),
            started: false,
            pool: (threads > 1).then(|| build(threads)).transpose()?,
        })
    }

    /// Number of environments.
    pub fn len(&self) -> usize {
        self.environments.len()
    }

    /// Never: a batch has environments.
    pub fn is_empty(&self) -> bool {
        false
    }

    /// The task.
    pub fn task(&self) -> &Task {
        self.environments[0].task()
    }

    /// The environments.
    pub fn environments(&self) -> &[Environment] {
        &self.environments
    }

    /// The last episode of an environment; its scores and fault are known once it has ended.
    pub fn episode(&self, index: usize) -> &Episode {
        self.environments[index].episode()
    }

    /// Starts an episode in every environment: the first ones of a seed, or the next ones.
    ///
    /// # Errors
    /// A slice of the wrong length, or a bench that is refused.
    pub fn reset(&mut self, seed: Option<u64>, outcomes: &mut Outcomes<'_>) -> Result<(), EnvironmentError> {
        self.each(outcomes, |index, environment, row| {
            if let Some(seed) = seed {
                environment.reseed(seed, index as u32);
            }
            start(environment, row)
        })?;
        self.started = true;
        Ok(())
    }

    /// Runs one action, from -1 to 1, in every environment. The result does not depend on the number of threads.
    ///
    /// # Errors
    /// A slice of the wrong length or an action that is not finite, with which nothing moves; or a bench that fails.
    pub fn step(&mut self, actions: &[f32], outcomes: &mut Outcomes<'_>) -> Result<(), EnvironmentError> {
        check("actions", actions.len(), self.len())?;
        if let Some(action) = actions.iter().find(|action| !action.is_finite()) {
            return Err(EnvironmentError::Action(*action));
        }
        if !self.started {
            return Err(EnvironmentError::Ended);
        }
        self.each(outcomes, |index, environment, row| {
            if !environment.is_running() {
                return start(environment, row);
            }
            let step = environment.step(actions[index])?;
            row.observation.copy_from_slice(environment.observation());
            (*row.reward, *row.ended) = (step.reward, step.ended);
            Ok(())
        })
    }

    /// Does the work in every environment; returns the error of the first one that fails.
    fn each(
        &mut self,
        outcomes: &mut Outcomes<'_>,
        work: impl Fn(usize, &mut Environment, &mut Row<'_>) -> Result<(), EnvironmentError> + Sync,
    ) -> Result<(), EnvironmentError> {
        let (count, width) = (self.len(), self.task().observations());
        check("observations", outcomes.observations.len(), count * width)?;
        check("rewards", outcomes.rewards.len(), count)?;
        check("ends", outcomes.ended.len(), count)?;
        let Outcomes { observations, rewards, ended } = outcomes;
        let Some(pool) = &self.pool else {
            let rows = observations.chunks_mut(width).zip(rewards.iter_mut()).zip(ended.iter_mut());
            let mut jobs = self.environments.iter_mut().zip(rows).enumerate();
            return jobs.try_for_each(|(index, (environment, ((observation, reward), ended)))| {
                work(index, environment, &mut Row { observation, reward, ended })
            });
        };
        let rows = observations.par_chunks_mut(width).zip(rewards.par_iter_mut()).zip(ended.par_iter_mut());
        let jobs = self.environments.par_iter_mut().zip(rows).enumerate();
        let failed = jobs.map(|(index, (environment, ((observation, reward), ended)))| {
            work(index, environment, &mut Row { observation, reward, ended })
        });
        pool.install(|| failed.find_map_first(Result::err).map_or(Ok(()), Err))
    }
}

/// Where one environment writes.
struct Row<'a> {
    observation: &'a mut [f32],
    reward: &'a mut f64,
    ended: &'a mut bool,
}

/// Starts the next episode.
fn start(environment: &mut Environment, row: &mut Row<'_>) -> Result<(), EnvironmentError> {
    environment.reset()?;
    row.observation.copy_from_slice(environment.observation());
    (*row.reward, *row.ended) = (0.0, false);
    Ok(())
}

fn check(array: &'static str, given: usize, needed: usize) -> Result<(), EnvironmentError> {
    if given == needed { Ok(()) } else { Err(EnvironmentError::Length { array, given, needed }) }
}
