//! One environment: episodes of breaths on one plant after the other.

use std::sync::Arc;

use judge::evaluate::{InspirationRecord, Score};
use shared::breath::{Breath, Phase};
use shared::control::Observation;
use shared::safety::alarms::Fault;
use shared::settings::Settings;
use ventilator::{BenchSource, SourceError, Tick};

use crate::action::Commanded;
use crate::observation::Memory;
use crate::{Choice, Draw, EnvironmentError, Task};

/// Episodes of a task, one after the other.
#[derive(Debug)]
pub struct Environment {
    task: Arc<Task>,
    seed: u64,
    /// Number of the next episode.
    next: u32,
    /// Number of episodes from one of this environment to its next one.
    stride: u32,
    memory: Memory,
    running: Option<Running>,
    ended: Episode,
    /// Inspiration with which the last episode ended.
    last: InspirationRecord,
}

/// A running episode.
#[derive(Debug)]
struct Running {
    source: BenchSource<Commanded>,
    draw: Draw,
    breath: Breath,
    /// Breaths that have begun.
    breaths: u32,
    /// Steps that have begun.
    steps: u32,
    /// Last command, percent.
    command: f32,
    record: InspirationRecord,
    scores: Vec<Score>,
}

/// The result of a step.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Step {
    /// Reward.
    pub reward: f64,
    /// Whether the episode has ended: after its last breath, or because the ventilator broke it off.
    pub ended: bool,
}

/// How an episode ended.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Episode {
    /// Number of the episode.
    pub number: u32,
    /// Name of its plant.
    pub plant: String,
    /// PIP, cmH2O.
    pub pip: f32,
    /// Scores of its complete breaths.
    pub scores: Vec<Score>,
    /// The fault with which the ventilator broke it off.
    pub fault: Option<Fault>,
}

/// What a tick has led to.
enum Next {
    /// Another tick of the inspiration.
    Tick,
    /// The inspiration is complete.
    Complete,
    /// The ventilator broke the breath off.
    Fault(Fault),
}

impl Environment {
    /// An environment before its first episode.
    pub fn new(task: Arc<Task>, seed: u64) -> Self {
        Self::of_several(task, seed, 0, 1)
    }

    /// The environment with the number `index` of `count`, which share the episodes of a seed.
    pub(crate) fn of_several(task: Arc<Task>, seed: u64, index: u32, count: u32) -> Self {
        let (memory, ended, last) = (Memory::default(), Episode::default(), InspirationRecord::default());
        Self { task, seed, next: index, stride: count, memory, running: None, ended, last }
    }

    /// The task.
    pub fn task(&self) -> &Task {
        &self.task
    }

    /// Whether an episode is running.
    pub fn is_running(&self) -> bool {
        self.running.is_some()
    }

    /// Starts again with the first episode of a seed at the next reset.
    pub(crate) fn reseed(&mut self, seed: u64, index: u32) {
        (self.seed, self.next) = (seed, index);
    }

    /// Starts again with the first episode of a seed.
    pub fn seed(&mut self, seed: u64) {
        self.reseed(seed, 0);
    }

    /// Starts the next episode.
    ///
    /// # Errors
    /// A bench or settings that are refused.
    pub fn reset(&mut self) -> Result<(), EnvironmentError> {
        self.reset_to(Choice::default())
    }

    /// Starts an episode of which the caller chooses something.
    ///
    /// # Errors
    /// A bench or settings that are refused.
    pub fn reset_to(&mut self, choice: Choice) -> Result<(), EnvironmentError> {
        let number = choice.number.unwrap_or(self.next);
        let Task { config, waveforms, law, .. } = &*self.task;
        let draw = config.plants.draw(waveforms, self.seed, number, choice, config.breathing)?;
        let source =
            BenchSource::new(&draw.bench, law.clone(), &draw.settings, config.period_us, draw.noise)?;
        let source = source.with_monitors(self.task.monitors);
        self.next = number.wrapping_add(self.stride);
        self.ended =
            Episode { number, plant: draw.bench.name.clone(), pip: draw.settings.pip, ..Episode::default() };
        // The memory of the last record serves again: freeing and asking for it would cost more than a step.
        let record =
            std::mem::take(self.running.as_mut().map_or(&mut self.last, |running| &mut running.record));
        let breath = Breath::new(&draw.settings, config.period_us)?;
        let scores = Vec::new();
        let mut running =
            Running { source, draw, breath, breaths: 0, steps: 0, command: 0.0, record, scores };
        running.begin_breath(&self.task, &mut self.memory)?;
        self.running = Some(running);
        Ok(())
    }

    /// The plant, settings and noise of the running episode.
    pub fn draw(&self) -> Option<&Draw> {
        self.running.as_ref().map(|running| &running.draw)
    }

    /// The last episode; its scores and fault are known once it has ended.
    pub fn episode(&self) -> &Episode {
        &self.ended
    }

    /// True airway pressure and target, cmH2O, and command, percent, of the running or the last inspiration, tick by tick.
    pub fn inspiration(&self) -> [Vec<f64>; 3] {
        self.running.as_ref().map_or(&self.last, |running| &running.record).curves()
    }

    /// Writes the observation, [`Task::observations`] values; after the end of an episode, its last one.
    ///
    /// # Panics
    /// If `observation` has another length.
    pub fn observe(&self, observation: &mut [f32]) {
        observation.copy_from_slice(&self.memory.seen()[..self.task.observations()]);
    }

    /// Runs one action, from -1 to 1: the ticks for which it is held, or those left of the inspiration. After the last tick of an
    /// inspiration the expiration runs too, unless it is the episode's last.
    ///
    /// # Errors
    /// An action that is not finite, no running episode, or a bench that fails.
    pub fn step(&mut self, action: f32) -> Result<Step, EnvironmentError> {
        if !action.is_finite() {
            return Err(EnvironmentError::Action(action));
        }
        let running = self.running.as_mut().ok_or(EnvironmentError::Ended)?;
        if let Some(mut breathing) = running.source.breathing() {
            breathing.set_controller(self.task.law.with(action));
        }
        running.steps += 1;
        let (mut reward, mut ticks) = (0.0, 0);
        for _ in 0..self.task.config.hold {
            let (of_tick, next) = running.tick(&self.task, &mut self.memory)?;
            reward += of_tick;
            ticks += 1;
            match next {
                Next::Tick => {}
                Next::Complete if running.breaths < self.task.config.breaths => {
                    match running.exhale() {
                        Ok(()) => running.begin_breath(&self.task, &mut self.memory)?,
                        Err(SourceError::Fault { fault, .. }) => {
                            return Ok(self.broken_off(fault, reward, ticks));
                        }
                        Err(error) => return Err(error.into()),
                    }
                    break;
                }
                Next::Complete => {
                    self.end(None);
                    return Ok(Step { reward: reward / f64::from(ticks), ended: true });
                }
                Next::Fault(fault) => return Ok(self.broken_off(fault, reward, ticks)),
            }
        }
        Ok(Step { reward: reward / f64::from(ticks), ended: false })
    }

    /// Ends an episode that the ventilator broke off. The steps that are left count as errors, so that breaking off never pays.
    fn broken_off(&mut self, fault: Fault, reward: f64, ticks: u32) -> Step {
        let missing = self.running.as_ref().map_or(0.0, |running| {
            let left = self.task.steps().saturating_sub(running.steps);
            f64::from(left) * self.task.config.reward.of_missing(&running.draw.settings)
        });
        self.end(Some(fault));
        Step { reward: reward / f64::from(ticks) + missing, ended: true }
    }

    fn end(&mut self, fault: Option<Fault>) {
        self.ended.fault = fault;
        if let Some(running) = self.running.take() {
            (self.ended.scores, self.last) = (running.scores, running.record);
        }
    }
}

impl Running {
    /// Begins the next breath and observes its first tick.
    fn begin_breath(&mut self, task: &Task, memory: &mut Memory) -> Result<(), EnvironmentError> {
        self.source.begin(&self.draw.settings)?;
        self.breaths += 1;
        self.record.clear();
        task.observer.start_breath(memory, self.command);
        self.observe(task, memory, 0);
        Ok(())
    }

    /// Observes the tick that comes next, or the end of the inspiration.
    fn observe(&mut self, task: &Task, memory: &mut Memory, tick: u32) {
        let Some(breathing) = self.source.breathing() else { return };
        let pressure = breathing.reading().pressure;
        let Settings { pip, peep, .. } = self.draw.settings;
        let seen = Observation { pressure, target: self.breath.target(tick), pip, peep, tick };
        task.observer.see(memory, &seen);
    }

    /// Runs one tick of the inspiration; returns its reward.
    fn tick(&mut self, task: &Task, memory: &mut Memory) -> Result<(f64, Next), EnvironmentError> {
        let Self { source, command, record, .. } = self;
        let mut breathing = source.breathing().ok_or(EnvironmentError::Ended)?;
        let (mut reward, pip) = (0.0, self.draw.settings.pip);
        let ran = breathing.tick(&mut |tick: &Tick| {
            reward = task.config.reward.of(tick, pip, *command);
            *command = tick.sample.u_in;
            record.add(tick);
        });
        match ran {
            Ok(_) => {}
            Err(SourceError::Fault { fault, .. }) => return Ok((reward, Next::Fault(fault))),
            Err(error) => return Err(error.into()),
        }
        let tick = breathing.state().tick();
        task.observer.applied(memory, self.command);
        if tick > 0 && self.breath.phase(tick) == Phase::Inspiration {
            self.observe(task, memory, tick);
            return Ok((reward, Next::Tick));
        }
        // The target of an inspiration ends with it; what is seen last still has one.
        self.observe(task, memory, self.breath.inspiration_ticks() - 1);
        self.scores.push(self.record.score(&self.draw.settings, task.config.period_us));
        Ok((reward, Next::Complete))
    }

    /// Runs the expiration.
    fn exhale(&mut self) -> Result<(), SourceError> {
        let Self { source, command, .. } = self;
        let Some(mut breathing) = source.breathing() else { return Ok(()) };
        while !(breathing.tick(&mut |tick: &Tick| *command = tick.sample.u_in)? && breathing.is_at_start()) {}
        Ok(())
    }
}
