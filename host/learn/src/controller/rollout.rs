//! A whole inspiration in closed loop, forward and backward: learned simulator, sensor noise, features, network,
//! PID and valve limits, for the rollouts of one shard.
//!
//! The forward pass computes what [`shared::control::residual`] computes on the chip, tick by tick; the backward
//! pass walks the ticks in reverse and carries the gradients of everything that reaches from tick to tick:
//! pressure, integral, derivative, leaky averages, taps, and the simulator's states.

use shared::control::COMMAND_MAX;
use shared::control::features::{
    AVERAGES, CLOCK, COMMAND_SCALE, ERROR_SCALE, FEATURES, Features, INTEGRAL, LEAKY, PAST_COMMANDS,
    PEEP_SCALE, PIP_SCALE,
};
use shared::control::pid::Pid;
use shared::control::residual::Residual;
use shared::math;

use super::network::{LaneNetwork, NetworkTape};
use crate::simulator::{self, CommandLog, Dynamics, Start, Timing};
use engine::Lane;

/// Where the leaky averages of the command begin.
const COMMAND_AVERAGES_AT: usize = LEAKY.start + AVERAGES;
/// Places of PIP and PEEP.
const PIP_AT: usize = CLOCK.end;
const PEEP_AT: usize = PIP_AT + 1;

/// Error below which the L1 loss is rounded off, cmH2O: its kink would make the last steps of training rattle.
const LOSS_ROUNDING: f32 = 0.02;

/// What a shard breathes.
#[derive(Clone, Debug)]
pub struct Scenario {
    /// Ticks of the inspiration.
    pub ticks: usize,
    /// PIP of each rollout, cmH2O.
    pub pip: Lane,
    /// PEEP, cmH2O.
    pub peep: f32,
    /// How the breaths start.
    pub start: Start,
    /// Command before the inspiration, percent.
    pub rest: f32,
    /// Sensor noise of each tick, cmH2O.
    pub noise: Vec<Lane>,
    /// Weight of each rollout in the loss.
    pub weight: Lane,
    /// Factor on errors above the target, 1 for the plain L1.
    pub overshoot_weight: f32,
}

/// Memory of a rollout; one per shard, used again and again.
#[derive(Debug)]
pub struct Tape<T> {
    simulator: T,
    network: NetworkTape,
    log: CommandLog,
    d_log: CommandLog,
    /// Pressure at the start and at the points of each block, cmH2O.
    points: Vec<Lane>,
    /// True (simulated) pressure at each tick, cmH2O.
    pressure: Vec<Lane>,
    /// Measured error at each tick, cmH2O, and its gradient.
    error: Vec<Lane>,
    d_error: Vec<Lane>,
    /// Applied command at each tick, percent, and its gradient.
    command: Vec<Lane>,
    d_command: Vec<Lane>,
    /// Command wanted before the limits, and residual wanted before its authority, percent.
    wanted: Vec<Lane>,
    correction: Vec<Lane>,
    /// One where the integral took the error in, zero where it was frozen.
    integrates: Vec<Lane>,
}

/// Loss of a shard: the weighted mean of |p - target| over ticks and rollouts (with its factor on overshoot),
/// and the plain mean of each rollout.
#[derive(Clone, Debug)]
pub struct Loss {
    /// Weighted sum over rollouts of the mean over ticks.
    pub weighted: f64,
    /// Mean |p - target| of each rollout, cmH2O.
    pub score: Lane,
}

/// The controller as it is trained: fixed parts and current network.
#[derive(Clone, Debug)]
pub struct LaneController<'a> {
    controller: &'a Residual,
    network: LaneNetwork,
}

/// State carried forward from tick to tick.
#[derive(Clone, Copy)]
struct Carried {
    integral: Lane,
    derivative: Lane,
    error_averages: [Lane; AVERAGES],
    command_averages: [Lane; AVERAGES],
}

/// Gradients carried backward from tick to tick.
type Back = Carried;

impl<'a> LaneController<'a> {
    /// Fixed parts of `controller` with the network of `parameters`.
    pub fn new(controller: &'a Residual, parameters: &[f32]) -> Self {
        Self { controller, network: LaneNetwork::new(parameters) }
    }

    fn pid(&self) -> &Pid {
        self.controller.pid()
    }

    fn features(&self) -> &Features {
        self.controller.features()
    }

    /// Memory for rollouts of so many ticks.
    pub fn tape<M: Dynamics>(&self, model: &M, ticks: usize) -> Tape<M::Tape> {
        let timing = model.timing();
        let blocks = timing.blocks(ticks);
        let log = CommandLog::new(blocks, vec![Lane::ZERO; timing.width()]);
        let zeros = || vec![Lane::ZERO; ticks];
        Tape {
            simulator: model.tape(blocks),
            network: NetworkTape::new(ticks),
            d_log: log.clone(),
            log,
            points: vec![Lane::ZERO; 1 + blocks * timing.points],
            pressure: zeros(),
            error: zeros(),
            d_error: zeros(),
            command: zeros(),
            d_command: zeros(),
            wanted: zeros(),
            correction: zeros(),
            integrates: zeros(),
        }
    }

    /// Runs the inspiration; the tape then holds everything that [`Self::backward`] needs.
    pub fn forward<M: Dynamics>(&self, model: &M, scenario: &Scenario, tape: &mut Tape<M::Tape>) -> Loss {
        let timing = *model.timing();
        tape.log = CommandLog::new(
            timing.blocks(scenario.ticks),
            vec![Lane::splat(scenario.rest / simulator::COMMAND_SCALE); timing.width()],
        );
        tape.points[0] = scenario.start.pressure;
        model.begin(&mut tape.simulator, &scenario.start);
        let mut carried = Carried::zero();
        carried.command_averages = [Lane::splat(scenario.rest / COMMAND_SCALE); AVERAGES];
        let fixed = Self::pressure_features(scenario);
        for block in 0..timing.blocks(scenario.ticks) {
            let first = block * timing.block_ticks;
            let ticks = first..(first + timing.block_ticks).min(scenario.ticks);
            if timing.lag() > 0 {
                predict(model, tape, block);
            }
            for tick in ticks {
                self.tick(&timing, scenario, tape, &mut carried, &fixed, tick);
            }
            if timing.lag() == 0 {
                predict(model, tape, block);
            }
        }
        loss(scenario, &tape.pressure)
    }

    /// Features that do not change within a breath: PIP and PEEP.
    fn pressure_features(scenario: &Scenario) -> [Lane; 2] {
        let pip = scenario.pip.map(|pip| (pip - PIP_SCALE.0) / PIP_SCALE.1);
        [pip, Lane::splat((scenario.peep - PEEP_SCALE.0) / PEEP_SCALE.1)]
    }

    fn tick<T>(
        &self,
        timing: &Timing,
        scenario: &Scenario,
        tape: &mut Tape<T>,
        carried: &mut Carried,
        fixed: &[Lane; 2],
        tick: usize,
    ) {
        let pressure = interpolate(timing, &tape.points, tick);
        tape.pressure[tick] = pressure;
        let measured = pressure.zip(&scenario.noise[tick], |p, n| p + n);
        let error = scenario.pip.zip(&measured, |target, p| target - p);
        tape.error[tick] = error;
        for (average, factor) in carried.error_averages.iter_mut().zip(self.features().error_factors()) {
            *average = average.zip(&error, |a, e| a + factor * (e / ERROR_SCALE - a));
        }
        self.write_features(scenario, tape, carried, fixed, tick);
        let scale = self.controller.spec().lambda * COMMAND_MAX;
        let correction = self.network.forward(&mut tape.network, tick).map(|y| scale * y);
        tape.correction[tick] = correction;
        self.command(tape, carried, tick);
        let part = tick / timing.block_ticks;
        let place = timing.part(tick % timing.block_ticks);
        let share = 1.0 / (simulator::COMMAND_SCALE * timing.part_ticks(place) as f32);
        tape.log.block_mut(part)[place].add_scaled(share, &tape.command[tick]);
    }

    fn write_features<T>(
        &self,
        scenario: &Scenario,
        tape: &mut Tape<T>,
        carried: &Carried,
        fixed: &[Lane; 2],
        tick: usize,
    ) {
        let spec = self.features().spec();
        let features = tape.network.features(tick);
        for (feature, tap) in features.iter_mut().zip(spec.error_taps) {
            *feature = match tick.checked_sub(usize::from(tap)) {
                Some(then) => tape.error[then].map(|e| e / ERROR_SCALE),
                None => Lane::ZERO,
            };
        }
        for (feature, tap) in features[PAST_COMMANDS.start..].iter_mut().zip(spec.command_taps) {
            *feature = match tick.checked_sub(usize::from(tap)) {
                Some(then) => tape.command[then].map(|u| u / COMMAND_SCALE),
                None => Lane::splat(scenario.rest / COMMAND_SCALE),
            };
        }
        features[LEAKY.start..COMMAND_AVERAGES_AT].copy_from_slice(&carried.error_averages);
        features[COMMAND_AVERAGES_AT..INTEGRAL].copy_from_slice(&carried.command_averages);
        features[INTEGRAL] = carried.integral.map(|i| i / COMMAND_SCALE);
        for (feature, time) in features[CLOCK.start..].iter_mut().zip(self.features().times(tick as u32)) {
            *feature = Lane::splat(time);
        }
        [features[PIP_AT], features[PEEP_AT]] = *fixed;
    }

    /// PID, residual and limits: the command of a tick.
    fn command<T>(&self, tape: &mut Tape<T>, carried: &mut Carried, tick: usize) {
        let (pid, gains) = (self.pid(), self.pid().gains());
        let authority = self.controller.spec().authority;
        let error = tape.error[tick];
        // The pressure rises by what the error falls: the target is constant within an inspiration.
        let change = if tick == 0 { Lane::ZERO } else { tape.error[tick - 1].zip(&error, |a, b| a - b) };
        let (factor, scale) = (pid.derivative_factor(), pid.derivative_scale());
        carried.derivative = carried.derivative.zip(&change, |d, c| d + factor * (-scale * c - d));
        for l in 0..engine::LANES {
            let residual = math::limit(tape.correction[tick][l], -authority, authority);
            let e = error[l];
            let wanted = gains.p * e + carried.integral[l] + carried.derivative[l] + residual;
            let winds_up = (wanted >= COMMAND_MAX && e > 0.0) || (wanted <= 0.0 && e < 0.0);
            let integral = carried.integral[l] + pid.integral_step() * e;
            let within = integral.abs() <= COMMAND_MAX;
            let integrates = !winds_up && within;
            if !winds_up {
                carried.integral[l] = math::limit(integral, -COMMAND_MAX, COMMAND_MAX);
            }
            tape.integrates[tick][l] = f32::from(u8::from(integrates));
            tape.wanted[tick][l] = wanted;
            tape.command[tick][l] = math::limit(wanted, 0.0, COMMAND_MAX);
        }
        let command = tape.command[tick];
        for (average, factor) in carried.command_averages.iter_mut().zip(self.features().command_factors()) {
            *average = average.zip(&command, |a, u| a + factor * (u / COMMAND_SCALE - a));
        }
    }

    /// Adds the gradient of the weighted loss by the network's parameters.
    pub fn backward<M: Dynamics>(
        &self,
        model: &M,
        scenario: &Scenario,
        tape: &mut Tape<M::Tape>,
        gradient: &mut [f32],
    ) {
        let timing = *model.timing();
        tape.d_log.clear();
        tape.d_error.fill(Lane::ZERO);
        tape.d_command.fill(Lane::ZERO);
        let mut back = Back::zero();
        // Gradient by the start of the block (the end of the one before) and by its points.
        let mut d_points = [Lane::ZERO; 3];
        for block in (0..timing.blocks(scenario.ticks)).rev() {
            let first = block * timing.block_ticks;
            let ticks = first..(first + timing.block_ticks).min(scenario.ticks);
            // What was the start of the next block is the last point of this one.
            let d_end = std::mem::replace(&mut d_points, [Lane::ZERO; 3])[0];
            d_points[timing.points] = d_end;
            if timing.lag() == 0 {
                model.step_back(&mut tape.simulator, block, &d_points[1..=timing.points], &mut tape.d_log);
            }
            for tick in ticks.rev() {
                let d_pressure = self.tick_back(&timing, scenario, tape, &mut back, tick);
                let weights = timing.interpolation(tick - first);
                for (d, weight) in d_points.iter_mut().zip(weights).take(1 + timing.points) {
                    d.add_scaled(weight, &d_pressure);
                }
            }
            if timing.lag() > 0 {
                model.step_back(&mut tape.simulator, block, &d_points[1..=timing.points], &mut tape.d_log);
            }
        }
        self.network.finish(&tape.network, gradient);
    }

    /// One tick backwards; gives the gradient by the tick's pressure.
    fn tick_back<T>(
        &self,
        timing: &Timing,
        scenario: &Scenario,
        tape: &mut Tape<T>,
        back: &mut Back,
        tick: usize,
    ) -> Lane {
        let place = timing.part(tick % timing.block_ticks);
        let share = 1.0 / (simulator::COMMAND_SCALE * timing.part_ticks(place) as f32);
        let mut d_command = tape.d_command[tick];
        d_command.add_scaled(share, &tape.d_log.block(Some(tick / timing.block_ticks))[place]);
        for (d, factor) in back.command_averages.iter_mut().zip(self.features().command_factors()) {
            d_command.add_scaled(factor / COMMAND_SCALE, d);
            *d = d.map(|d| (1.0 - factor) * d);
        }
        let d_wanted = limit_back(&d_command, &tape.wanted[tick], 0.0, COMMAND_MAX);
        self.pid_back(tape, back, &d_wanted, tick);

        let authority = self.controller.spec().authority;
        let d_correction = limit_back(&d_wanted, &tape.correction[tick], -authority, authority);
        let scale = self.controller.spec().lambda * COMMAND_MAX;
        let d_features = self.network.backward(&mut tape.network, tick, d_correction.map(|d| scale * d));
        self.features_back(tape, back, &d_features, tick);

        let d_error = tape.d_error[tick];
        loss_slope(scenario, tape.pressure[tick]).zip(&d_error, |loss, d| loss - d)
    }

    /// Integral, proportional and derivative part, from the gradient by the command wanted.
    fn pid_back<T>(&self, tape: &mut Tape<T>, back: &mut Back, d_wanted: &Lane, tick: usize) {
        let pid = self.pid();
        let step = pid.integral_step();
        let from_integral = back.integral.zip(&tape.integrates[tick], |d, gate| step * gate * d);
        tape.d_error[tick].add_scaled(1.0, &from_integral);
        tape.d_error[tick].add_scaled(pid.gains().p, d_wanted);
        back.integral.add_scaled(1.0, d_wanted);
        back.derivative.add_scaled(1.0, d_wanted);
        let (factor, scale) = (pid.derivative_factor(), pid.derivative_scale());
        if tick > 0 {
            // derivative += factor * scale * (error now - error before)
            tape.d_error[tick].add_scaled(factor * scale, &back.derivative);
            tape.d_error[tick - 1].add_scaled(-factor * scale, &back.derivative);
        }
        back.derivative = back.derivative.map(|d| (1.0 - factor) * d);
    }

    /// Taps, averages and the integral, from the gradient by the features.
    fn features_back<T>(&self, tape: &mut Tape<T>, back: &mut Back, d: &[Lane; FEATURES], tick: usize) {
        let spec = self.features().spec();
        for (d, tap) in d.iter().zip(spec.error_taps) {
            if let Some(then) = tick.checked_sub(usize::from(tap)) {
                tape.d_error[then].add_scaled(1.0 / ERROR_SCALE, d);
            }
        }
        for (d, tap) in d[PAST_COMMANDS.start..].iter().zip(spec.command_taps) {
            if let Some(then) = tick.checked_sub(usize::from(tap)) {
                tape.d_command[then].add_scaled(1.0 / COMMAND_SCALE, d);
            }
        }
        let factors = self.features().error_factors();
        for ((carried, d), factor) in back.error_averages.iter_mut().zip(&d[LEAKY.start..]).zip(factors) {
            carried.add_scaled(1.0, d);
            tape.d_error[tick].add_scaled(factor / ERROR_SCALE, carried);
            *carried = carried.map(|d| (1.0 - factor) * d);
        }
        for (carried, d) in back.command_averages.iter_mut().zip(&d[COMMAND_AVERAGES_AT..]) {
            carried.add_scaled(1.0, d);
        }
        back.integral.add_scaled(1.0 / COMMAND_SCALE, &d[INTEGRAL]);
    }
}

impl<T> Tape<T> {
    /// Simulated pressure at each tick, cmH2O.
    pub fn pressure(&self) -> &[Lane] {
        &self.pressure
    }

    /// Command at each tick, percent.
    pub fn command(&self) -> &[Lane] {
        &self.command
    }
}

impl Carried {
    fn zero() -> Self {
        Self {
            integral: Lane::ZERO,
            derivative: Lane::ZERO,
            error_averages: [Lane::ZERO; AVERAGES],
            command_averages: [Lane::ZERO; AVERAGES],
        }
    }
}

/// The simulator's step of a block.
fn predict<M: Dynamics>(model: &M, tape: &mut Tape<M::Tape>, block: usize) {
    let count = model.timing().points;
    let (_, points) = tape.points.split_at_mut(1 + block * count);
    model.step(&mut tape.simulator, block, &tape.log, &mut points[..count]);
}

/// Pressure at a tick from the points around it.
fn interpolate(timing: &Timing, points: &[Lane], tick: usize) -> Lane {
    let block = tick / timing.block_ticks;
    let weights = timing.interpolation(tick % timing.block_ticks);
    let mut pressure = Lane::ZERO;
    let around = &points[block * timing.points..];
    for (point, weight) in around.iter().zip(weights).take(1 + timing.points) {
        pressure.add_scaled(weight, point);
    }
    pressure
}

/// Gradient through a limit. Beyond it, only what would lead back is let through, so that a saturated command
/// can learn to leave its limit.
fn limit_back(d: &Lane, value: &Lane, lo: f32, hi: f32) -> Lane {
    d.zip(value, |d, value| if (value > hi && d < 0.0) || (value < lo && d > 0.0) { 0.0 } else { d })
}

fn loss_slope(scenario: &Scenario, pressure: Lane) -> Lane {
    let above = scenario.overshoot_weight;
    let share = 1.0 / scenario.ticks as f32;
    Lane::from_fn(|l| {
        let error = pressure[l] - scenario.pip[l];
        let slope = (error / LOSS_ROUNDING).clamp(-1.0, 1.0);
        share * scenario.weight[l] * if error > 0.0 { above * slope } else { slope }
    })
}

fn loss(scenario: &Scenario, pressure: &[Lane]) -> Loss {
    let (mut score, mut weighted) = (Lane::ZERO, 0.0);
    let share = 1.0 / scenario.ticks as f32;
    for pressure in pressure {
        let error = pressure.zip(&scenario.pip, |p, target| p - target);
        score.add_scaled(share, &error.map(f32::abs));
        let rounded = error.map(|e| {
            let size = e.abs();
            let size = if size < LOSS_ROUNDING {
                0.5 * size * size / LOSS_ROUNDING
            } else {
                size - 0.5 * LOSS_ROUNDING
            };
            if e > 0.0 { scenario.overshoot_weight * size } else { size }
        });
        weighted += f64::from(rounded.zip(&scenario.weight, |e, w| share * w * e).sum());
    }
    Loss { weighted, score }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::controller::network::{chip_network, initial_parameters};
    use crate::simulator::state_space::{StateSpace, StateSpaceConfig};
    use crate::simulator::stitched::{Stitched, StitchedConfig};
    use engine::LANES;
    use rand_chacha::ChaCha8Rng;
    use rand_chacha::rand_core::SeedableRng;
    use shared::control::features::FeatureSpec;
    use shared::control::network::Network;
    use shared::control::pid::PidGains;
    use shared::control::residual::ResidualSpec;
    use shared::control::{ControlLaw, Controller, ControllerState, Observation};

    fn controller(period_us: u32, parameters: &[f32]) -> Residual {
        let spec = ResidualSpec {
            period_us,
            gains: PidGains { p: 0.6, i: 3.0, d: 0.004 },
            lambda: 0.3,
            authority: 100.0,
            features: FeatureSpec::for_period(period_us),
        };
        Residual::new(spec, chip_network(parameters)).unwrap()
    }

    /// A network that keeps the valve about half open.
    fn parameters() -> Vec<f32> {
        let mut parameters = initial_parameters(&mut ChaCha8Rng::seed_from_u64(5));
        let last = parameters.len() - 1;
        for (n, weight) in parameters[last - 16..last].iter_mut().enumerate() {
            *weight = 0.3 * (n as f32).sin();
        }
        parameters[last] = 1.6;
        parameters
    }

    fn scenario(ticks: usize) -> Scenario {
        Scenario {
            ticks,
            pip: Lane::from_fn(|l| 16.0 + 0.5 * l as f32),
            peep: 5.0,
            start: Start { pressure: Lane::splat(5.0), plateau: Lane::splat(20.0), ..Start::default() },
            rest: 5.0,
            noise: (0..ticks).map(|n| Lane::from_fn(|l| 0.1 * ((n * 7 + l) as f32).sin())).collect(),
            weight: Lane::from_fn(|l| if l % 3 == 0 { 1.0 } else { 0.5 }),
            overshoot_weight: 1.5,
        }
    }

    fn loss_of<M: Dynamics>(residual: &Residual, parameters: &[f32], model: &M, scenario: &Scenario) -> f64 {
        let controller = LaneController::new(residual, parameters);
        let mut tape = controller.tape(model, scenario.ticks);
        controller.forward(model, scenario, &mut tape).weighted
    }

    fn check<M: Dynamics>(period_us: u32, ticks: usize, model: &M) {
        let (mut parameters, scenario) = (parameters(), scenario(ticks));
        let residual = controller(period_us, &parameters);
        let lanes = LaneController::new(&residual, &parameters);
        let mut tape = lanes.tape(model, ticks);
        lanes.forward(model, &scenario, &mut tape);
        let limits = |u: &Lane| u.0.iter().all(|u| (1.0..99.0).contains(u));
        assert!(tape.command.iter().all(limits), "the check needs commands off their limits");
        let mut gradient = vec![0.0; Network::PARAMETERS];
        lanes.backward(model, &scenario, &mut tape, &mut gradient);

        let largest = gradient.iter().fold(0.0_f32, |m, g| m.max(g.abs()));
        let mut checked = 0;
        for n in (0..parameters.len()).step_by(13).chain([parameters.len() - 1]) {
            let (kept, step) = (parameters[n], 4e-3);
            parameters[n] = kept + step;
            let above = loss_of(&residual, &parameters, model, &scenario);
            parameters[n] = kept - step;
            let below = loss_of(&residual, &parameters, model, &scenario);
            parameters[n] = kept;
            let numeric = (above - below) / f64::from(2.0 * step);
            let error = (numeric - f64::from(gradient[n])).abs();
            assert!(
                error < 0.03 * f64::from(gradient[n].abs() + 0.1 * largest),
                "{n}: {numeric} {}",
                gradient[n]
            );
            checked += usize::from(gradient[n].abs() > 0.05 * largest);
        }
        assert!(checked > 10, "only {checked} gradients were large enough to tell anything");
    }

    #[test]
    fn the_gradient_of_a_rollout_agrees_with_finite_differences() {
        let config = StateSpaceConfig { states: 6, hidden: 8, ..StateSpaceConfig::for_period(1000, 1) };
        let model = StateSpace::new(config, &config.initialise(&mut ChaCha8Rng::seed_from_u64(2)));
        check(1000, 150, &model);
    }

    #[test]
    fn the_gradient_through_the_authors_simulator_agrees_with_finite_differences() {
        let config = StitchedConfig::for_period(30_000);
        let wild = config.initialise(&mut ChaCha8Rng::seed_from_u64(2));
        let tame: Vec<f32> = wild.iter().map(|w| 0.5 * w).collect();
        let model = Stitched::new(config, &tame);
        check(30_000, 29, &model);
    }

    #[test]
    fn lanes_and_chip_give_the_same_commands() {
        let parameters = parameters();
        let residual = controller(1000, &parameters);
        let config = StateSpaceConfig::for_period(1000, 1);
        let model = StateSpace::new(config, &config.initialise(&mut ChaCha8Rng::seed_from_u64(2)));
        let scenario = scenario(400);
        let lanes = LaneController::new(&residual, &parameters);
        let mut tape = lanes.tape(&model, scenario.ticks);
        lanes.forward(&model, &scenario, &mut tape);

        let chip = Controller::Residual(residual);
        for l in [0, 7, LANES - 1] {
            let mut state = ControllerState::new();
            chip.start_breath(&mut state, scenario.rest);
            for tick in 0..scenario.ticks {
                let pressure = tape.pressure[tick][l] + scenario.noise[tick][l];
                let (target, pip) = (scenario.pip[l], scenario.pip[l]);
                let seen = Observation { pressure, target, pip, peep: 5.0, tick: tick as u32 };
                let command = chip.step(&mut state, &seen).command;
                chip.applied(&mut state, command);
                // The chip follows the lanes' pressures, so a difference cannot build up through the plant.
                assert!((command - tape.command[tick][l]).abs() < 1e-2, "tick {tick}");
            }
        }
    }

    #[test]
    fn a_saturated_command_can_only_learn_to_come_back() {
        let value = Lane::from_fn(|l| [120.0, 120.0, -5.0, -5.0][l % 4]);
        let d = Lane::from_fn(|l| [1.0, -1.0, 1.0, -1.0][l % 4]);
        let through = limit_back(&d, &value, 0.0, 100.0);
        assert_eq!(through.0[..4].iter().map(|d| *d as i32).collect::<Vec<_>>(), [1, 0, 0, -1]);
    }
}
