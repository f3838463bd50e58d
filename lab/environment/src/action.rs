//! What an action commands: the whole valve, or a correction of a PID.

use laws::rl::Actions;
use laws::rl::ventilation::valve_command;
use serde::{Deserialize, Serialize};
use shared::control::pid::{Pid, PidGains, PidState};
use shared::control::{COMMAND_MAX, ControlLaw, ControlOutput, Observation};

use crate::EnvironmentError;

/// What an action from -1 to 1 commands. Values beyond that range are limited to it.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum ActionKind {
    /// The whole command: -1 closes the valve, 1 opens it fully.
    Valve,
    /// A correction that is added to the command of a PID, as that of a learned controller is. The supervisor treats it likewise:
    /// it limits the slew and leaves the correction out while something is unproven.
    Residual {
        /// Gains of the PID.
        gains: PidGains,
        /// Correction at an action of 1, percent of the valve, 0 to 100.
        authority: f32,
    },
}

impl ActionKind {
    /// The law for a control period in microseconds.
    pub(crate) fn law(self, period_us: u32) -> Result<Commanded, EnvironmentError> {
        let kind = match self {
            Self::Valve => Kind::Valve,
            Self::Residual { gains, authority } => {
                if !(0.0..=COMMAND_MAX).contains(&authority) {
                    return Err(EnvironmentError::out_of_bounds("authority", authority, 0.0, COMMAND_MAX));
                }
                Kind::Residual { pid: Pid::new(gains, period_us)?, authority }
            }
        };
        Ok(Commanded { kind, action: 0.0 })
    }
}

/// The control law that carries an action to the valve.
#[derive(Clone, Debug)]
pub(crate) struct Commanded {
    kind: Kind,
    action: f32,
}

#[derive(Clone, Debug)]
enum Kind {
    Valve,
    Residual { pid: Pid, authority: f32 },
}

impl Commanded {
    /// The same law with this finite action.
    pub(crate) fn with(&self, action: f32) -> Self {
        Self { action: action.clamp(-1.0, 1.0), kind: self.kind.clone() }
    }
}

impl ControlLaw for Commanded {
    type State = PidState;

    fn initial_state(&self) -> PidState {
        PidState::new()
    }

    fn start_breath(&self, state: &mut PidState, _command: f32) {
        *state = PidState::new();
    }

    fn step(&self, state: &mut PidState, seen: &Observation) -> ControlOutput {
        match &self.kind {
            Kind::Valve => ControlOutput::plain(valve_command(Actions::Continuous, self.action)),
            Kind::Residual { pid, authority } => pid.step(state, seen, authority * self.action),
        }
    }

    fn applied(&self, _state: &mut PidState, _command: f32) {}
}
