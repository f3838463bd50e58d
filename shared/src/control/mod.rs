//! Controllers: what turns a pressure reading into a demand on the inspiratory valve.
//!
//! [`ControlLaw`] is what a ventilator asks of a controller. [`Controller`] is the one that a device runs: [`pid`], the
//! industry's standard, alone or with the learned residual, which [`features`] and [`network`] compute and [`residual`] adds,
//! scaled by lambda. A controller works during the inspiration only; each breath starts it afresh.

pub mod features;
pub mod network;
pub mod pid;
pub mod residual;

use features::FeatureState;
use pid::{Pid, PidState};
use residual::Residual;

/// Highest command of the inspiratory valve, percent.
pub const COMMAND_MAX: f32 = 100.0;

/// What a controller may look at in one tick.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Observation {
    /// Measured airway pressure, cmH2O.
    pub pressure: f32,
    /// Target, cmH2O.
    pub target: f32,
    /// PIP of the breath, cmH2O.
    pub pip: f32,
    /// PEEP of the breath, cmH2O.
    pub peep: f32,
    /// Ticks since the breath started.
    pub tick: u32,
}

/// What a controller asks of the inspiratory valve before the safety filter, percent, both within `0..=100`.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ControlOutput {
    /// The part that needs no trust: what its PID would command alone, in the same state.
    pub base: f32,
    /// The whole command, with what it has learned.
    pub command: f32,
}

impl ControlOutput {
    /// A command with nothing learned in it.
    pub const fn plain(command: f32) -> Self {
        Self { base: command, command }
    }

    /// The same with so many percent more.
    #[must_use]
    pub fn plus(self, percent: f32) -> Self {
        Self { base: self.base + percent, command: self.command + percent }
    }
}

/// A controller as the ventilator runs it: [`Controller`], or any other that takes its place.
///
/// In a tick of the inspiration the ventilator calls [`Self::step`], filters the output, and calls [`Self::applied`].
pub trait ControlLaw {
    /// What it remembers from tick to tick.
    type State;

    /// Before the first breath, valve closed.
    fn initial_state(&self) -> Self::State;

    /// Forgets the last breath; the valve stands at `command` percent.
    fn start_breath(&self, state: &mut Self::State, command: f32);

    /// One tick: the command wanted.
    fn step(&self, state: &mut Self::State, seen: &Observation) -> ControlOutput;

    /// Takes in which command was applied, percent; exploration and the safety filter may have changed it.
    fn applied(&self, state: &mut Self::State, command: f32);
}

/// A built controller.
#[derive(Clone, Debug, PartialEq)]
#[expect(clippy::large_enum_variant, reason = "one controller exists at a time, and nothing may allocate")]
pub enum Controller {
    /// PID alone.
    Pid(Pid),
    /// PID and learned residual.
    Residual(Residual),
}

/// State of either controller; both have the PID's part, so that one can take over from the other.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ControllerState {
    pid: PidState,
    features: FeatureState,
}

impl Controller {
    /// The PID, or the one under the residual.
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

    fn start_breath(&self, state: &mut ControllerState, command: f32) {
        state.pid = PidState::new();
        state.features.start_breath(command);
    }

    fn step(&self, state: &mut ControllerState, seen: &Observation) -> ControlOutput {
        match self {
            Self::Pid(pid) => pid.step(&mut state.pid, seen, 0.0),
            Self::Residual(residual) => residual.step(state, seen),
        }
    }

    fn applied(&self, state: &mut ControllerState, command: f32) {
        if let Self::Residual(residual) = self {
            residual.features().applied(&mut state.features, command);
        }
    }
}

impl ControllerState {
    /// State before the first breath, valve closed.
    pub const fn new() -> Self {
        Self { pid: PidState::new(), features: FeatureState::new() }
    }
}
