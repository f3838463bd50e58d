//! Variable-gain control (Hunnekens et al., IEEE Transactions on Control Systems Technology 2020): a linear law with an extra gain
//! that acts only on the part of the error outside a dead zone.
//!
//! The command is `C(s) (e + phi(e))`, with `phi(e) = alpha (e - sign(e) delta)` where `abs(e) > delta`, and 0 elsewhere. Small errors,
//! such as noise and the patient's own flow, thus meet a low gain, and the large error of the rise a high one. The source uses an
//! integral or a PI as `C`; here it may have a derivative part too, of the measured pressure, because one helps on the bench.
//!
//! A dead zone below the noise of a pressure sensor, 0.5 cmH2O from peak to peak, would leave a plain PID with a higher gain, which is
//! compared anyway: the least dead zone is 0.5 cmH2O.

use shared::control::pid::{Pid, PidGains, PidState};
use shared::control::{ControlLaw, ControlOutput, Observation};

use super::parameter::{self, GAIN_D, GAIN_I, GAIN_P, Parameter, RivalError};
use ventilator::law::Law;

/// Parameters in the order of [`VariableGain::new`]. The values are those that `lab tune-rival variable-gain` finds for the
/// family `adult`.
pub(super) const PARAMETERS: [Parameter; 5] = [
    Parameter { coarse: &[1.0, 2.5, 5.0, 10.0], tuned: 5.0, ..GAIN_P },
    Parameter { coarse: &[30.0, 75.0, 150.0, 300.0], tuned: 178.125, ..GAIN_I },
    Parameter { coarse: &[0.0, 0.1, 0.2], tuned: 0.175, ..GAIN_D },
    Parameter {
        name: "alpha",
        unit: "",
        meaning: "extra gain on the error outside the dead zone",
        coarse: &[0.0, 1.0, 3.0, 9.0],
        bounds: (0.0, 100.0),
        tuned: 0.5,
    },
    Parameter {
        name: "delta",
        unit: "cmH2O",
        meaning: "dead zone of the extra gain",
        coarse: &[1.0, 2.5, 5.0, 10.0],
        bounds: (0.5, 50.0),
        tuned: 0.6875,
    },
];

/// A PID whose gain on large errors is higher.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct VariableGain {
    pid: Pid,
    alpha: f32,
    delta: f32,
}

impl VariableGain {
    /// The law with P, I, D, alpha and delta in cmH2O, for a control period in microseconds.
    ///
    /// # Errors
    /// A value out of bounds.
    pub fn new(values: [f32; 5], period_us: u32) -> Result<Self, RivalError> {
        parameter::check(&PARAMETERS, &values)?;
        let [p, i, d, alpha, delta] = values;
        Ok(Self { pid: Pid::new(PidGains { p, i, d }, period_us)?, alpha, delta })
    }

    /// The extra error phi(e), cmH2O.
    fn extra(&self, error: f32) -> f32 {
        let outside = (error.abs() - self.delta).max(0.0);
        self.alpha * outside.copysign(error)
    }
}

impl Law for VariableGain {
    fn pid(&self) -> &Pid {
        &self.pid
    }
}

impl ControlLaw for VariableGain {
    type State = PidState;

    fn initial_state(&self) -> PidState {
        PidState::new()
    }

    fn start_breath(&self, state: &mut PidState, _command: f32) {
        *state = PidState::new();
    }

    fn step(&self, state: &mut PidState, seen: &Observation) -> ControlOutput {
        let target = seen.target + self.extra(seen.target - seen.pressure);
        let command = self.pid.step(state, &Observation { target, ..*seen }, 0.0).command;
        ControlOutput::plain(command)
    }

    fn applied(&self, _state: &mut PidState, _command: f32) {}
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use shared::breath::DEFAULT_PERIOD_US;

    fn law(values: [f32; 5]) -> VariableGain {
        VariableGain::new(values, DEFAULT_PERIOD_US).unwrap()
    }

    fn seen(error: f32) -> Observation {
        Observation { pressure: 15.0 - error, target: 15.0, pip: 15.0, peep: 5.0, tick: 0, rise_ticks: 0 }
    }

    fn command(law: &VariableGain, error: f32) -> f32 {
        law.step(&mut law.initial_state(), &seen(error)).command
    }

    #[test]
    fn an_error_within_the_dead_zone_meets_the_pid_alone() {
        let law = law([2.0, 0.0, 0.0, 3.0, 1.5]);
        assert!((command(&law, 1.5) - 3.0).abs() < 1e-5);
        assert!(command(&law, 0.0).abs() < 1e-9);
    }

    #[test]
    fn the_part_of_an_error_outside_the_dead_zone_is_amplified_to_either_side() {
        let law = law([2.0, 0.0, 0.0, 3.0, 1.5]);
        assert!((command(&law, 4.0) - 2.0 * (4.0 + 3.0 * 2.5)).abs() < 1e-4);
        assert!((law.extra(-4.0) + 3.0 * 2.5).abs() < 1e-6);
    }

    #[test]
    fn without_an_extra_gain_it_is_a_pid() {
        let gains = PidGains { p: 5.0, i: 200.0, d: 0.1 };
        let (law, pid) = (law([5.0, 200.0, 0.1, 0.0, 1.0]), Pid::new(gains, DEFAULT_PERIOD_US).unwrap());
        let (mut state, mut other) = (law.initial_state(), PidState::new());
        for error in [8.0, 3.0, -1.0, 0.2] {
            let command = law.step(&mut state, &seen(error)).command;
            assert_eq!(command.to_bits(), pid.step(&mut other, &seen(error), 0.0).command.to_bits());
        }
    }

    #[test]
    fn values_out_of_bounds_are_refused_by_name() {
        let refused = VariableGain::new([2.0, 0.0, 0.0, f32::NAN, 1.5], DEFAULT_PERIOD_US).unwrap_err();
        assert!(refused.to_string().contains("alpha"), "{refused}");
        assert!(VariableGain::new([200.0, 0.0, 0.0, 1.0, 1.5], DEFAULT_PERIOD_US).is_err());
    }

    proptest! {
        #[test]
        fn the_command_stays_within_the_valves_range(errors in prop::collection::vec(-80.0f32..80.0, 1..50)) {
            let law = law([10.0, 500.0, 0.2, 10.0, 1.0]);
            let mut state = law.initial_state();
            for error in errors {
                prop_assert!((0.0..=100.0).contains(&law.step(&mut state, &seen(error)).command));
            }
        }
    }
}
