//! Controllers: what turns a pressure reading into a command of the inspiratory valve.
//!
//! [`pid`] is the industry's standard and the base; [`features`] and [`network`] make the learned residual;
//! [`residual`] adds it, scaled by lambda, to the base. [`Controller`] is whichever of the two a ventilator
//! runs. A controller works during the inspiration only; [`Controller::start_breath`] resets it.

pub mod features;
pub mod network;
pub mod pid;
pub mod residual;

use pid::{Pid, PidState};
use residual::{Residual, ResidualState};

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

/// What a controller wants of the inspiratory valve, percent, both within `0..=100`.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Wish {
    /// What its PID would command alone, in the same state.
    pub base: f32,
    /// What it commands, with what it has learned.
    pub command: f32,
}

impl Wish {
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

/// A built controller.
#[derive(Clone, Debug, PartialEq)]
#[expect(clippy::large_enum_variant, reason = "one controller exists at a time, and nothing may allocate")]
pub enum Controller {
    /// PID alone.
    Pid(Pid),
    /// PID and learned residual.
    Residual(Residual),
}

/// State of either controller; the PID's part is shared, so that one can take over from the other.
#[derive(Clone, Debug, PartialEq)]
pub struct ControllerState {
    residual: ResidualState,
}

impl Controller {
    /// The PID, or the one under the residual.
    pub fn pid(&self) -> &Pid {
        match self {
            Self::Pid(pid) => pid,
            Self::Residual(residual) => residual.pid(),
        }
    }

    /// Forgets the last breath; the valve stands at `command` percent.
    pub fn start_breath(&self, state: &mut ControllerState, command: f32) {
        state.residual.start_breath(command);
    }

    /// One tick: the command wanted.
    pub fn step(&self, state: &mut ControllerState, seen: &Observation) -> Wish {
        match self {
            Self::Pid(pid) => pid.step(&mut state.residual.pid, seen, 0.0),
            Self::Residual(residual) => residual.step(&mut state.residual, seen),
        }
    }

    /// Tells the controller which command was applied (it may differ: exploration, safety filter).
    pub fn applied(&self, state: &mut ControllerState, command: f32) {
        state.residual.applied(self, command);
    }
}

impl ControllerState {
    /// State before the first breath, valve closed.
    pub const fn new() -> Self {
        Self { residual: ResidualState::new() }
    }

    /// The PID's state.
    pub fn pid(&self) -> &PidState {
        &self.residual.pid
    }
}

impl Default for ControllerState {
    fn default() -> Self {
        Self::new()
    }
}
