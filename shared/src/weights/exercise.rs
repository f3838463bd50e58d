//! The exercise: a short scripted run of a built controller. Its commands prove that trainer and device compute features,
//! network and PID alike. Fulfils: weights-checks.
//!
//! The script is part of the format version. A breath starts with the valve at 5 %. In each tick `k` of [`TICKS`] the
//! target rises from a PEEP of 8 to a PIP of 25 cmH2O within 64 ticks, and the pressure is `((7 k) mod 16) / 2 - 2` cmH2O below the target; every
//! command is applied unchanged. All these numbers are exact in single precision. The breath is then adopted, and
//! 80 ticks of a second one follow in the same way, with what the first one taught.

use serde::{Deserialize, Serialize};

use crate::breath::rising;
use crate::checksum::CRC_32;
use crate::control::memory::Lesson;
use crate::control::residual::Residual;
use crate::control::{ControllerState, Observation};

/// Length of the first breath, ticks: longer than the features' history, so that every tap reads values of the script.
pub const TICKS: u32 = 160;
/// Length of the second breath, ticks: long enough to recall from all over the first one.
pub const SECOND_TICKS: u32 = 80;

/// Command before the first tick of a breath, percent.
pub const START: f32 = 5.0;

/// Length of the target's rise, ticks.
const RISE_TICKS: u32 = 64;

/// Result of a controller in the exercise.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Golden {
    /// Bits of the last command (f32, percent).
    #[serde(with = "postcard::fixint::le")]
    pub last: u32,
    /// CRC-32 over the bits of all commands, little endian, in order.
    #[serde(with = "postcard::fixint::le")]
    pub all: u32,
}

/// Observation in a tick of the script.
pub fn script(tick: u32) -> Observation {
    let error = 0.5 * (7 * tick % 16) as f32 - 2.0;
    let (pip, peep, rise_ticks) = (25.0, 8.0, RISE_TICKS);
    let target = rising(pip, peep, rise_ticks, tick);
    Observation { pressure: target - error, target, pip, peep, tick, rise_ticks }
}

/// Runs the exercise.
pub fn golden(residual: &Residual) -> Golden {
    // Of the residual itself: a controller around a copy would take kilobytes of the chip's stack.
    let mut state = ControllerState::new();
    let mut all = CRC_32.digest();
    let mut last = 0;
    for ticks in [TICKS, SECOND_TICKS] {
        state.start_breath(START);
        for tick in 0..ticks {
            let command = residual.step(&mut state, &script(tick)).command;
            residual.applied(&mut state, command);
            last = command.to_bits();
            all.update(&last.to_le_bytes());
        }
        state.learn(Lesson::Adopt);
    }
    Golden { last, all: all.finalize() }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::control::features::FeatureSpec;
    use crate::control::network::{INPUTS, Network};
    use crate::control::pid::PidGains;
    use crate::control::residual::ResidualSpec;

    fn built(change: impl Fn(&mut ResidualSpec, &mut Network)) -> Golden {
        let gains = PidGains { p: 1.0, i: 20.0, d: 0.01 };
        let mut spec = ResidualSpec {
            period_us: 1000,
            gains,
            lambda: 0.5,
            authority: 40.0,
            features: FeatureSpec::default(),
        };
        let mut network = Network::zero();
        for (index, weight) in network.parameters_mut().enumerate() {
            *weight = (index % 23) as f32 * 0.02 - 0.2;
        }
        network.output.bias[0] = 0.5;
        change(&mut spec, &mut network);
        golden(&Residual::new(spec, network).unwrap())
    }

    /// Pins script, features, network and PID to bits, the same on every target. A change of any of them needs a new
    /// format version.
    #[test]
    fn the_exercise_of_a_known_controller_has_known_bits() {
        let known = Golden { last: 0x41E1_C7D1, all: 0x3930_C05E };
        assert_eq!(built(|_, _| ()), known);
    }

    #[test]
    fn every_feature_and_layer_reaches_the_golden_value() {
        let base = built(|_, _| ());
        for input in 0..INPUTS {
            let changed = built(|_, network| network.hidden_1.weights[input][3] += 0.5);
            assert_ne!(changed, base, "input {input}");
        }
        assert_ne!(built(|_, network| network.hidden_2.weights[5][2] += 0.1), base);
        assert_ne!(built(|_, network| network.output.weights[7][0] += 0.1), base);
    }

    #[test]
    fn every_part_of_the_pid_and_of_the_scale_reaches_the_golden_value() {
        let base = built(|_, _| ());
        assert_ne!(built(|spec, _| spec.gains.p += 0.01), base);
        assert_ne!(built(|spec, _| spec.gains.i += 0.1), base);
        assert_ne!(built(|spec, _| spec.gains.d += 0.001), base);
        assert_ne!(built(|spec, _| spec.lambda += 0.01), base);
        assert_ne!(built(|spec, _| spec.authority = 5.0), base);
        assert_ne!(built(|spec, _| spec.features.error_taps[6] = 127), base);
        assert_ne!(built(|spec, _| spec.features.target_ahead[1] = 41), base);
        assert_ne!(built(|spec, _| spec.features.command_averages[1] = 0.31), base);
    }
}
