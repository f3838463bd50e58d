//! One environment: episodes of breaths on one plant after the other.

use std::sync::Arc;

use score::evaluate::{InspirationRecord, Score};
use shared::breath::Breath;
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
    /// Ticks of the running inspiration that are complete.
    ticks: u32,
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
    /// Whether the episode has ended: after its last breath, or because the ventilator aborted it.
    pub ended: bool,
}

/// How an episode ended.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Episode {
    /// Number of the episode.
    pub number: u32,
    /// Name of its plant.
    pub plant: String,
    /// Settings of its breaths.
    pub settings: Settings,
    /// Its steps if nothing aborts it.
    pub steps: u32,
    /// Scores of its complete breaths.
    pub scores: Vec<Score>,
    /// The fault with which the ventilator aborted it.
    pub fault: Option<Fault>,
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
        let Task { config, prescriptions, law, .. } = &*self.task;
        let draw = config.plants.draw(prescriptions, self.seed, number, choice, config.breathing)?;
        let source =
            BenchSource::new(&draw.bench, law.clone(), &draw.settings, config.period_us, draw.noise)?;
        let source = source.with_monitors(self.task.monitors);
        self.next = number.wrapping_add(self.stride);
        let breath = Breath::new(&draw.settings, config.period_us)?;
        let (plant, steps) = (draw.bench.name.clone(), self.task.steps_of(breath.inspiration_ticks()));
        self.ended = Episode { number, plant, settings: draw.settings, steps, ..Episode::default() };
        // The memory of the last record serves again: freeing and asking for it would cost more than a step.
        let record =
            std::mem::take(self.running.as_mut().map_or(&mut self.last, |running| &mut running.record));
        let scores = Vec::new();
        let mut running =
            Running { source, draw, breath, breaths: 0, steps: 0, ticks: 0, command: 0.0, record, scores };
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

    /// The observation, [`Task::observations`] values; after the end of an episode, its last one.
    pub fn observation(&self) -> &[f32] {
        &self.memory.seen()[..self.task.observations()]
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
        let planned = self.task.config.hold.min(running.ticks_left());
        let mut reward = 0.0;
        for complete in 0..planned {
            match running.tick(&self.task, &mut self.memory) {
                Ok(of_tick) => reward += of_tick,
                Err(error) => return self.aborted(error, reward, [planned - complete, planned]),
            }
        }
        if running.ticks_left() == 0 {
            running.scores.push(running.record.score(&running.draw.settings, self.task.config.period_us));
            if running.breaths == self.task.config.breaths {
                self.end(None);
                return Ok(Step { reward: reward / f64::from(planned), ended: true });
            }
            if let Err(error) = running.exhale() {
                return self.aborted(error, reward, [0, planned]);
            }
            running.begin_breath(&self.task, &mut self.memory)?;
        }
        Ok(Step { reward: reward / f64::from(planned), ended: false })
    }

    /// Ends an episode with the fault with which the ventilator aborted it; any other error goes on to the caller. The `missing` of
    /// the `planned` ticks of the running step, and all steps that are left, count as the worst ticks, so that an abort never pays.
    fn aborted(
        &mut self,
        error: SourceError,
        reward: f64,
        [missing, planned]: [u32; 2],
    ) -> Result<Step, EnvironmentError> {
        let (SourceError::Fault { fault, .. }, Some(running)) = (&error, &self.running) else {
            return Err(error.into());
        };
        let worst = self.task.config.reward.worst(&running.draw.settings);
        let of_step = (reward + f64::from(missing) * worst) / f64::from(planned);
        let reward = of_step + f64::from(self.ended.steps - running.steps) * worst;
        self.end(Some(*fault));
        Ok(Step { reward, ended: true })
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
        (self.breaths, self.ticks) = (self.breaths + 1, 0);
        self.record.clear();
        task.observer.start_breath(memory, self.command);
        self.observe(task, memory, 0);
        Ok(())
    }

    /// Observes the tick that comes next, or the end of the inspiration.
    fn observe(&mut self, task: &Task, memory: &mut Memory, tick: u32) {
        let Some(breathing) = self.source.breathing() else { return };
        let pressure = breathing.reading().pressure;
        let seen = Observation::at(&self.breath.at(tick), pressure);
        task.observer.see(memory, &seen);
    }

    /// Ticks of the running inspiration that are left.
    fn ticks_left(&self) -> u32 {
        self.breath.inspiration_ticks() - self.ticks
    }

    /// Runs one tick of the inspiration; returns its reward.
    fn tick(&mut self, task: &Task, memory: &mut Memory) -> Result<f64, SourceError> {
        let Self { source, command, record, .. } = self;
        let (mut reward, pip) = (0.0, self.draw.settings.pip);
        let Some(mut breathing) = source.breathing() else { return Ok(reward) };
        breathing.tick(&mut |tick: &Tick| {
            reward = task.config.reward.of(tick, pip, *command);
            *command = tick.sample.u_in;
            record.add(tick);
        })?;
        self.ticks += 1;
        task.observer.applied(memory, self.command);
        // The target of an inspiration ends with it; the last observation still has one.
        self.observe(task, memory, self.ticks.min(self.breath.inspiration_ticks() - 1));
        Ok(reward)
    }

    /// Runs the expiration.
    fn exhale(&mut self) -> Result<(), SourceError> {
        let Self { source, command, .. } = self;
        let Some(mut breathing) = source.breathing() else { return Ok(()) };
        while !(breathing.tick(&mut |tick: &Tick| *command = tick.sample.u_in)? && breathing.is_at_start()) {}
        Ok(())
    }
}
