//! The PID under the residual over lanes, forward and backward: the same as [`shared::control::pid`] on the chip.

use engine::{LANES, Lane};
use shared::control::COMMAND_MAX;
use shared::control::pid::Pid;
use shared::math;

use super::limit::limit_back;

/// Integral and derivative part of the command, percent; in the backward pass, the gradients with respect to them.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct PidLanes {
    pub integral: Lane,
    pub derivative: Lane,
}

/// Values of the forward pass that the backward pass needs.
#[derive(Debug)]
pub(super) struct PidTape {
    /// Command before the limits at each tick, percent.
    wanted: Vec<Lane>,
    /// One where the integral was updated, zero where it was frozen.
    integrates: Vec<Lane>,
}

impl PidTape {
    /// Memory for `ticks` ticks.
    pub fn new(ticks: usize) -> Self {
        Self { wanted: vec![Lane::ZERO; ticks], integrates: vec![Lane::ZERO; ticks] }
    }
}

/// The command of a tick, percent, from the errors up to that tick and the rise of the target since the last one (cmH2O), and the
/// residual (percent).
pub(super) fn forward(
    pid: &Pid,
    state: &mut PidLanes,
    tape: &mut PidTape,
    (errors, rise): (&[Lane], &Lane),
    residual: &Lane,
    tick: usize,
) -> Lane {
    let error = errors[tick];
    // The pressure rises as far as the error falls behind the target.
    let mut change = if tick == 0 { Lane::ZERO } else { errors[tick - 1].zip(&error, |a, b| a - b) };
    change.add_scaled(1.0, rise);
    let (factor, scale) = (pid.derivative_factor(), pid.derivative_scale());
    state.derivative = state.derivative.zip(&change, |d, c| d + factor * (-scale * c - d));
    let (gain, step) = (pid.gains().p, pid.integral_step());
    let mut command = Lane::ZERO;
    for l in 0..LANES {
        let e = error[l];
        let wanted = gain * e + state.integral[l] + state.derivative[l] + residual[l];
        let winds_up = (wanted >= COMMAND_MAX && e > 0.0) || (wanted <= 0.0 && e < 0.0);
        let integral = state.integral[l] + step * e;
        let integrates = !winds_up && integral.abs() <= COMMAND_MAX;
        if !winds_up {
            state.integral[l] = math::limit(integral, -COMMAND_MAX, COMMAND_MAX);
        }
        tape.integrates[tick][l] = f32::from(u8::from(integrates));
        tape.wanted[tick][l] = wanted;
        command[l] = math::limit(wanted, 0.0, COMMAND_MAX);
    }
    command
}

/// Backward pass of one tick: adds the gradient with respect to the errors; returns that with respect to the residual.
pub(super) fn backward(
    pid: &Pid,
    back: &mut PidLanes,
    tape: &PidTape,
    d_errors: &mut [Lane],
    d_command: &Lane,
    tick: usize,
) -> Lane {
    let d_wanted = limit_back(d_command, &tape.wanted[tick], 0.0, COMMAND_MAX);
    let step = pid.integral_step();
    let from_integral = back.integral.zip(&tape.integrates[tick], |d, gate| step * gate * d);
    d_errors[tick].add_scaled(1.0, &from_integral);
    d_errors[tick].add_scaled(pid.gains().p, &d_wanted);
    back.integral.add_scaled(1.0, &d_wanted);
    back.derivative.add_scaled(1.0, &d_wanted);
    let (factor, scale) = (pid.derivative_factor(), pid.derivative_scale());
    if tick > 0 {
        // derivative += factor * scale * (error now - error before)
        d_errors[tick].add_scaled(factor * scale, &back.derivative);
        d_errors[tick - 1].add_scaled(-factor * scale, &back.derivative);
    }
    back.derivative = back.derivative.map(|d| (1.0 - factor) * d);
    d_wanted
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tests_support::check_slopes;
    use shared::control::pid::PidGains;

    const TICKS: usize = 20;

    /// Weighted sum of all commands, with different weights; errors and residuals of the ticks differ between lanes.
    fn run(pid: &Pid, errors: &[Lane], residuals: &[Lane], tape: &mut PidTape) -> f64 {
        let mut state = PidLanes::default();
        (0..TICKS)
            .map(|tick| {
                let seen = (errors, &Lane::splat(0.1));
                let command = forward(pid, &mut state, tape, seen, &residuals[tick], tick);
                (0..LANES).map(|l| f64::from(weight(tick)[l] * command[l])).sum::<f64>()
            })
            .sum()
    }

    fn weight(tick: usize) -> Lane {
        Lane::from_fn(|l| ((3 * tick + l) as f32).cos())
    }

    #[test]
    fn gradients_by_errors_and_residual_agree_with_finite_differences() {
        let pid = Pid::new(PidGains { p: 1.5, i: 40.0, d: 0.02 }, 1000).unwrap();
        let errors: Vec<Lane> =
            (0..TICKS).map(|tick| Lane::from_fn(|l| ((tick + 2 * l) as f32).sin())).collect();
        let residuals: Vec<Lane> = (0..TICKS).map(|tick| Lane::splat(50.0 + tick as f32)).collect();
        let mut tape = PidTape::new(TICKS);
        run(&pid, &errors, &residuals, &mut tape);
        let (mut back, mut d_errors) = (PidLanes::default(), vec![Lane::ZERO; TICKS]);
        let mut d_residuals = vec![Lane::ZERO; TICKS];
        for tick in (0..TICKS).rev() {
            d_residuals[tick] = backward(&pid, &mut back, &tape, &mut d_errors, &weight(tick), tick);
        }
        let flat = |lanes: &[Lane]| -> Vec<f32> { lanes.iter().flat_map(|lane| lane.0).collect() };
        let lanes = |flat: &[f32]| -> Vec<Lane> {
            flat.chunks(LANES).map(|chunk| Lane::from_fn(|l| chunk[l])).collect()
        };
        check_slopes("error", &flat(&errors), 1e-2, &flat(&d_errors), |varied| {
            run(&pid, &lanes(varied), &residuals, &mut PidTape::new(TICKS))
        });
        check_slopes("residual", &flat(&residuals), 1e-1, &flat(&d_residuals), |varied| {
            run(&pid, &errors, &lanes(varied), &mut PidTape::new(TICKS))
        });
    }
}
