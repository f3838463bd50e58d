//! Controllers: they compute the command of the inspiratory valve from the pressure reading.
//!
//! [`ControlLaw`] is the interface that the ventilator uses. [`Controller`] is its implementation on a device: the [`pid`]
//! alone, or the PID plus a learned [`residual`], which a [`network`] computes from [`features`] and lambda scales. A
//! controller runs during the inspiration only and is reset at the start of each breath.

pub mod features;
pub mod memory;
pub mod network;
pub mod pid;
pub mod residual;

use crate::breath::{Moment, rising};
use crate::settings::Settings;
use features::FeatureState;
use memory::{BreathMemory, Lesson};
use pid::{Pid, PidState};
use residual::Residual;

/// Highest command of the inspiratory valve, percent.
pub const COMMAND_MAX: f32 = 100.0;

/// Input of a controller in one tick.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Observation {
    /// Measured airway pressure, cmH2O.
    pub pressure: f32,
    /// Target pressure, cmH2O.
    pub target: f32,
    /// PIP of the breath, cmH2O.
    pub pip: f32,
    /// PEEP of the breath, cmH2O.
    pub peep: f32,
    /// Ticks since the breath started.
    pub tick: u32,
    /// Length of the rise from PEEP to PIP, ticks.
    pub rise_ticks: u32,
}

impl Observation {
    /// What is seen at a moment of a breath with this pressure, cmH2O.
    pub fn at(moment: &Moment<'_>, pressure: f32) -> Self {
        let Settings { pip, peep, .. } = *moment.settings();
        let rise_ticks = moment.breath.rise_ticks();
        Self { pressure, target: moment.target(), pip, peep, tick: moment.tick, rise_ticks }
    }

    /// Rise of the target within this many ticks, as if the inspiration went on, cmH2O.
    #[inline]
    pub fn rise_within(&self, ticks: u32) -> f32 {
        let target = |tick| rising(self.pip, self.peep, self.rise_ticks, tick);
        target(self.tick.saturating_add(ticks)) - target(self.tick)
    }
}

/// Command of the inspiratory valve before the safety filter; before exploration both parts are in `0..=100` percent.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ControlOutput {
    /// The command of the PID alone in the same state, percent: used when the learned part is not trusted.
    pub base: f32,
    /// The command including the learned part, percent.
    pub command: f32,
}

impl ControlOutput {
    /// A command without a learned part.
    pub const fn plain(command: f32) -> Self {
        Self { base: command, command }
    }

    /// Adds `percent` to both parts.
    #[must_use]
    pub fn plus(self, percent: f32) -> Self {
        Self { base: self.base + percent, command: self.command + percent }
    }
}

/// Interface between ventilator and controller; [`Controller`] implements it, and any other controller can.
///
/// In each tick of the inspiration the ventilator calls [`Self::step`], filters the output, and calls [`Self::applied`].
pub trait ControlLaw {
    /// State that persists from tick to tick.
    type State;

    /// State before the first breath, with the valve closed.
    fn initial_state(&self) -> Self::State;

    /// Learns from the inspiration that has ended, or forgets all before the next one; a law without memory ignores it. Returns what
    /// has become of the breath.
    fn learn(&self, _state: &mut Self::State, _lesson: Lesson) -> Lesson {
        Lesson::Discard
    }

    /// Resets the state for a new breath; the last command was `command` percent.
    fn start_breath(&self, state: &mut Self::State, command: f32);

    /// Computes the command of one tick.
    fn step(&self, state: &mut Self::State, seen: &Observation) -> ControlOutput;

    /// Records the applied command, percent; exploration and the safety filter may have changed it.
    fn applied(&self, state: &mut Self::State, command: f32);
}

/// A built controller.
#[derive(Clone, Debug, PartialEq)]
#[expect(clippy::large_enum_variant, reason = "one controller exists at a time, and nothing may allocate")]
pub enum Controller {
    /// PID alone.
    Pid(Pid),
    /// PID plus learned residual.
    Residual(Residual),
}

/// State of either controller. Both use the PID's state, so that a change of controller within a breath is possible.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ControllerState {
    pid: PidState,
    features: FeatureState,
    memory: BreathMemory,
}

impl Controller {
    /// The PID: alone, or underneath the residual.
    pub fn pid(&self) -> &Pid {
        match self {
            Self::Pid(pid) => pid,
            Self::Residual(residual) => residual.pid(),
        }
    }
}

impl ControlLaw for Controller {
    type State = ControllerState;

    fn initial_state(&self) -> ControllerState {
        ControllerState::new()
    }

    fn learn(&self, state: &mut ControllerState, lesson: Lesson) -> Lesson {
        match self {
            Self::Residual(_) => state.learn(lesson),
            // A memory would be out of date by the time a residual runs again.
            Self::Pid(_) => state.learn(Lesson::Forget),
        }
    }

    fn start_breath(&self, state: &mut ControllerState, command: f32) {
        state.start_breath(command);
    }

    fn step(&self, state: &mut ControllerState, seen: &Observation) -> ControlOutput {
        match self {
            Self::Pid(pid) => pid.step(&mut state.pid, seen, 0.0),
            Self::Residual(residual) => residual.step(state, seen),
        }
    }

    fn applied(&self, state: &mut ControllerState, command: f32) {
        if let Self::Residual(residual) = self {
            residual.applied(state, command);
        }
    }
}

impl ControllerState {
    /// Starts a breath; the last command was `command` percent.
    pub(crate) fn start_breath(&mut self, command: f32) {
        self.pid = PidState::new();
        self.features.start_breath(command);
    }

    /// Learns from the inspiration that has ended, or forgets.
    pub(crate) fn learn(&mut self, lesson: Lesson) -> Lesson {
        self.memory.learn(lesson)
    }

    /// Breaths that are remembered, at most [`memory::LEARNING`].
    pub(crate) fn adopted(&self) -> u8 {
        self.memory.adopted()
    }

    /// State before the first breath, with the valve closed.
    pub const fn new() -> Self {
        Self { pid: PidState::new(), features: FeatureState::new(), memory: BreathMemory::new() }
    }
}
