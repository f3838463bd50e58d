//! Controllers of the fault matrix: the sound one, and those that drive every breath to the limit.

use shared::breath::DEFAULT_PERIOD_US;
use shared::control::Controller;
use shared::control::features::FeatureSpec;
use shared::control::network::Network;
use shared::control::pid::{Pid, PidGains};
use shared::control::residual::{Residual, ResidualSpec};
use ventilator::SourceError;

use CaseController::{Alternating, Greedy, Ringing, Sound};

/// The controller of a trial.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum CaseController {
    /// The PID that is best for all the paper's lungs.
    Sound,
    /// A PID that rings on every lung.
    Ringing,
    /// A network that always requests 100 % more.
    Greedy,
    /// A network that alternates between 100 % more and 100 % less.
    Alternating,
}

/// The PID that is best for all the paper's lungs.
pub(crate) const SOUND: PidGains = PidGains { p: 6.098, i: 290.6, d: 0.2094 };
/// The same without its integral, which would counteract a greedy network.
const WITHOUT_INTEGRAL: PidGains = PidGains { i: 0.0, ..SOUND };
/// Gains that ring on every lung.
const RINGING: PidGains = PidGains { p: 60.0, i: 3000.0, d: 0.0 };

impl CaseController {
    /// Builds it.
    pub(super) fn controller(self) -> Result<Controller, SourceError> {
        let pid = |gains| Pid::new(gains, DEFAULT_PERIOD_US).map(Controller::Pid);
        let built = match self {
            Sound => pid(SOUND).ok(),
            Ringing => pid(RINGING).ok(),
            Greedy => full_authority(WITHOUT_INTEGRAL, greedy()),
            Alternating => full_authority(SOUND, alternating()),
        };
        built.ok_or(SourceError::Stopped)
    }
}

/// The PID that is best for all the paper's lungs.
pub(super) fn sound_controller() -> Result<Controller, SourceError> {
    Sound.controller()
}

/// A learned controller with full authority over a PID.
pub(super) fn full_authority(gains: PidGains, network: Network) -> Option<Controller> {
    let spec = ResidualSpec {
        period_us: DEFAULT_PERIOD_US,
        gains,
        lambda: 1.0,
        authority: 100.0,
        features: FeatureSpec::default(),
    };
    Residual::new(spec, network).ok().map(Controller::Residual)
}

fn greedy() -> Network {
    let mut network = Network::zero();
    network.output.bias[0] = 1.0;
    network
}

/// Requests nothing after a command above 50 %, everything after one below.
fn alternating() -> Network {
    let mut network = Network::zero();
    let last_command = shared::control::features::PAST_COMMANDS.start;
    network.hidden_1.weights[0][last_command] = 100.0;
    network.hidden_1.bias[0] = -100.0;
    network.hidden_2.weights[0][0] = 100.0;
    network.output.weights[0][0] = -2.0;
    network
}
