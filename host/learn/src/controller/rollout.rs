//! A whole inspiration in closed loop, forward and backward, for the rollouts of one shard: learned simulator, sensor
//! noise, the learned part, PID and valve limits.
//!
//! The forward pass computes the same as the controller's law ([`shared::control::residual`] on the chip), tick by tick. The backward pass
//! runs through the ticks in reverse and carries the gradients of all state: pressure, integral, derivative, leaky
//! averages, taps, and the simulator's states.

use engine::{LANES, Lane};
use shared::control::COMMAND_MAX;
use shared::control::residual::Residual;
use shared::math;

use super::architecture::{LanePart, Trainable};
use super::limit::{limit, limit_back};
use super::loss::{self, Loss};
use super::pid::{self, PidLanes, PidTape};
use super::scenario::{Scenario, Strain};
use super::signals::Signals;
use crate::simulator::model::Model;
use crate::simulator::rollout::Rollout;

/// Share of a command in the mean of the recent ones: about the last 50 ms at 1 kHz.
const LEVEL_SHARE: f32 = 0.02;

/// Memory of a closed loop; one per shard, reused.
#[derive(Debug)]
pub struct ClosedLoopTape<C: Trainable = Residual> {
    simulator: Rollout,
    learned: <C::Lanes as LanePart>::Tape,
    pid: PidTape,
    signals: Signals,
    d_signals: Signals,
    /// True (simulated) pressure at each tick, less the pull of efforts, cmH2O.
    pressure: Vec<Lane>,
    /// Command to the valve at each tick, before the loop is strained, percent; in the backward pass, its gradients.
    applied: Vec<Lane>,
    d_applied: Vec<Lane>,
    /// Residual before the limit by its authority at each tick, percent.
    correction: Vec<Lane>,
}

impl<C: Trainable> ClosedLoopTape<C> {
    /// Memory for inspirations of `ticks` ticks on a model.
    pub fn new(model: &Model, ticks: usize) -> Self {
        Self {
            simulator: Rollout::new(model, ticks),
            learned: C::Lanes::tape(ticks),
            pid: PidTape::new(ticks),
            signals: Signals::new(ticks),
            d_signals: Signals::new(ticks),
            pressure: vec![Lane::ZERO; ticks],
            applied: vec![Lane::ZERO; ticks],
            d_applied: vec![Lane::ZERO; ticks],
            correction: vec![Lane::ZERO; ticks],
        }
    }
}

impl<C: Trainable> ClosedLoopTape<C> {
    /// Errors and commands of the breath.
    pub(super) fn signals(&self) -> &Signals {
        &self.signals
    }

    /// Pressure, cmH2O, and command, percent, at the end of an inspiration of this many ticks.
    pub(super) fn plateau(&self, ticks: usize) -> (Lane, Lane) {
        let last = |lanes: &[Lane]| lanes[..ticks].last().copied().unwrap_or_default();
        (last(&self.pressure), last(&self.signals.command))
    }
}

/// The controller in training: fixed parts and the current network.
#[derive(Clone, Debug)]
pub struct LaneController<'a, C: Trainable = Residual> {
    /// PID, lambda and authority.
    fixed: &'a Residual,
    learned: C::Lanes,
}

/// State carried from tick to tick; in the backward pass, the gradients with respect to it.
struct Carried<L> {
    pid: PidLanes,
    learned: L,
    /// Mean of the recent commands, percent: around it, the loop is strained.
    level: Lane,
}

/// What a learned part carries.
type LearnedCarried<'a, C> = <<C as Trainable>::Lanes as LanePart>::Carried<'a>;

impl<'a, C: Trainable> LaneController<'a, C> {
    /// Fixed parts of `controller` with the network of `parameters`.
    pub fn new(controller: &'a C, parameters: &[f32]) -> Self {
        Self { fixed: controller.fixed_parts(), learned: controller.lanes(parameters) }
    }

    /// Runs the inspiration; afterwards the tape contains everything that [`Self::backward`] needs.
    pub fn forward(&self, model: &Model, scenario: &Scenario, tape: &mut ClosedLoopTape<C>) -> Loss {
        let (learned, level) = (self.learned.start(scenario), scenario.rest);
        let mut carried = Carried { pid: PidLanes::default(), learned, level };
        tape.simulator.begin(model, &scenario.start, &scenario.rest);
        for tick in 0..scenario.ticks {
            self.tick(scenario, tape, &mut carried, tick);
        }
        let loss = Loss::of(scenario, &tape.pressure);
        let amplified =
            scenario.probe.as_ref().map_or(0.0, |probe| probe.loss(&tape.applied, &scenario.weight));
        Loss { weighted: loss.weighted + amplified, ..loss }
    }

    fn tick(
        &self,
        scenario: &Scenario,
        tape: &mut ClosedLoopTape<C>,
        carried: &mut Carried<LearnedCarried<'_, C>>,
        tick: usize,
    ) {
        let mut pressure = tape.simulator.pressure();
        if let Some(pull) = scenario.pull.get(tick) {
            pressure.add_scaled(-1.0, pull);
        }
        tape.pressure[tick] = pressure;
        let measured = pressure.zip(&scenario.noise[tick], |p, n| p + n);
        tape.signals.error[tick] = scenario.prescribed.target(tick).zip(&measured, |target, p| target - p);
        let Carried { pid, learned, .. } = carried;
        let seen = (&tape.signals, &pid.integral);
        let output = self.learned.forward(scenario, &mut tape.learned, learned, seen, tick);

        let scale = self.fixed.spec().lambda * COMMAND_MAX;
        let correction = output.map(|y| scale * y);
        tape.correction[tick] = correction;
        let authority = self.fixed.spec().authority;
        let residual = limit(&correction, -authority, authority);
        let errors = (&tape.signals.error[..], &scenario.prescribed.rise(tick));
        let command = pid::forward(self.fixed.pid(), pid, &mut tape.pid, errors, &residual, tick);

        tape.signals.command[tick] = command;
        self.learned.applied(learned, &command);
        tape.applied[tick] = match &scenario.probe {
            Some(probe) => limit(&probe.added(&command, tick), 0.0, COMMAND_MAX),
            None => command,
        };
        let strained = strained(scenario, &tape.applied, &mut carried.level, tick);
        tape.simulator.advance(&strained);
    }

    /// Adds the gradient of the weighted loss with respect to the network's parameters.
    pub fn backward(&self, scenario: &Scenario, tape: &mut ClosedLoopTape<C>, gradient: &mut [f32]) {
        let learned = self.learned.start_back(scenario, &mut tape.learned);
        let mut back = Carried { pid: PidLanes::default(), learned, level: Lane::ZERO };
        tape.d_signals.clear();
        tape.d_applied.fill(Lane::ZERO);
        if let Some(probe) = &scenario.probe {
            probe.slopes(&tape.applied, &scenario.weight, &mut tape.d_applied);
        }
        tape.simulator.start_back();
        for tick in (0..scenario.ticks).rev() {
            self.tick_back(scenario, tape, &mut back, tick);
        }
        self.learned.finish(&tape.learned, gradient);
    }

    fn tick_back(
        &self,
        scenario: &Scenario,
        tape: &mut ClosedLoopTape<C>,
        back: &mut Carried<LearnedCarried<'_, C>>,
        tick: usize,
    ) {
        let Carried { pid, learned, .. } = back;
        let d_signals = &mut tape.d_signals;
        let d_plant = tape.simulator.command_gradient(tick);
        strained_back(scenario, &d_plant, &mut tape.d_applied, &mut back.level, tick);
        let mut d_command = d_signals.command[tick];
        let d_applied = match &scenario.probe {
            Some(probe) => {
                let added = probe.added(&tape.signals.command[tick], tick);
                limit_back(&tape.d_applied[tick], &added, 0.0, COMMAND_MAX)
            }
            None => tape.d_applied[tick],
        };
        d_command.add_scaled(1.0, &d_applied);
        d_command.add_scaled(1.0, &loss::effort_slope(scenario, &tape.signals.command, tick));
        let command = &tape.signals.command[tick];
        d_command.add_scaled(1.0, &loss::restraint_slope(scenario, &tape.pressure[tick], command, tick));
        self.learned.applied_back(learned, &mut d_command);

        let d_errors = &mut d_signals.error;
        let d_residual = pid::backward(self.fixed.pid(), pid, &tape.pid, d_errors, &d_command, tick);
        let authority = self.fixed.spec().authority;
        let d_correction = limit_back(&d_residual, &tape.correction[tick], -authority, authority);
        let scale = self.fixed.spec().lambda * COMMAND_MAX;
        let d_output = d_correction.map(|d| scale * d);
        let d_seen = (&mut *d_signals, &mut pid.integral);
        self.learned.backward(&mut tape.learned, learned, d_output, d_seen, tick);

        let d_pressure =
            loss::slope(scenario, &tape.pressure[tick], tick).zip(&d_signals.error[tick], |loss, d| loss - d);
        tape.simulator.add_pressure_gradient(tick, &d_pressure);
    }
}

/// Whether the loop of a rollout is strained at a tick.
fn is_strained(scenario: &Scenario, l: usize, tick: usize) -> bool {
    scenario.strain.is_on(l) && tick >= scenario.settled[l]
}

/// What reaches the plant of the commands up to a tick, percent, and the mean of the recent commands before the strain.
fn strained(scenario: &Scenario, commands: &[Lane], level: &mut Lane, tick: usize) -> Lane {
    let Strain { gain, delay } = &scenario.strain;
    Lane::from_fn(|l| {
        let now = commands[tick][l];
        if !is_strained(scenario, l, tick) {
            level[l] += LEVEL_SHARE * (now - level[l]);
            return now;
        }
        let change = commands[tick.saturating_sub(delay[l])][l] - level[l];
        math::limit(level[l] + gain[l] * change, 0.0, COMMAND_MAX)
    })
}

/// Backward pass of [`strained`]: adds the gradients with respect to the commands; `level` is that of the mean.
fn strained_back(
    scenario: &Scenario,
    d_plant: &Lane,
    d_commands: &mut [Lane],
    level: &mut Lane,
    tick: usize,
) {
    let Strain { gain, delay } = &scenario.strain;
    for l in 0..LANES {
        if is_strained(scenario, l, tick) {
            d_commands[tick.saturating_sub(delay[l])][l] += gain[l] * d_plant[l];
            level[l] += (1.0 - gain[l]) * d_plant[l];
        } else {
            d_commands[tick][l] += d_plant[l] + LEVEL_SHARE * level[l];
            level[l] *= 1.0 - LEVEL_SHARE;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::controller::memory::Recall;
    use crate::controller::network::{chip_network, initial_parameters};
    use crate::controller::probe::{PAIRS, Probe, Sine};
    use crate::controller::scenario::Prescribed;
    use crate::simulator::BreathStart;
    use crate::simulator::model::Architecture;
    use crate::simulator::state_space::StateSpaceConfig;
    use crate::simulator::stitched::StitchedConfig;
    use rand_chacha::ChaCha8Rng;
    use rand_chacha::rand_core::SeedableRng;
    use shared::control::features::{FEATURES, FeatureSpec};
    use shared::control::network::{HIDDEN_1, INPUTS, Network};
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

    /// A network that keeps the valve about half open and also sees what it recalls.
    fn parameters() -> Vec<f32> {
        let mut parameters = initial_parameters(&mut ChaCha8Rng::seed_from_u64(5));
        for (n, row) in parameters.chunks_exact_mut(INPUTS).take(HIDDEN_1).enumerate() {
            row[FEATURES..].fill(0.5 * (n as f32).cos());
        }
        let last = parameters.len() - 1;
        for (n, weight) in parameters[last - 16..last].iter_mut().enumerate() {
            *weight = 0.3 * (n as f32).sin();
        }
        parameters[last] = 1.6;
        parameters
    }

    fn model(architecture: Architecture) -> Model {
        Model::new(architecture, &architecture.initialise(&mut ChaCha8Rng::seed_from_u64(2)))
    }

    fn scenario(ticks: usize) -> Scenario {
        Scenario {
            ticks,
            scored_from: ticks / 10,
            held_tick: ticks * 9 / 10,
            probe: None,
            prescribed: Prescribed::new(
                ticks,
                Lane::from_fn(|l| 16.0 + 0.5 * l as f32),
                Lane::from_fn(|l| 4.0 + 0.1 * l as f32),
                std::array::from_fn(|l| (ticks / 20 * l) as u32),
            ),
            settled: [ticks / 3; LANES],
            strain: Strain {
                gain: Lane::from_fn(|l| if l % 4 == 0 { 1.5 } else { 1.0 }),
                delay: std::array::from_fn(|l| if l % 4 == 1 { 3 } else { 0 }),
            },
            start: BreathStart {
                pressure: Lane::splat(5.0),
                plateau: Lane::splat(20.0),
                ..BreathStart::default()
            },
            rest: Lane::splat(5.0),
            memory: None,
            effort_price: 0.0,
            restraint_price: 0.0,
            noise: (0..ticks).map(|n| Lane::from_fn(|l| 0.1 * ((n * 7 + l) as f32).sin())).collect(),
            pull: (0..ticks).map(|n| Lane::from_fn(|l| 0.2 * l as f32 * (0.1 * n as f32).sin())).collect(),
            weight: Lane::from_fn(|l| if l % 3 == 0 { 1.0 } else { 0.5 }),
            overshoot_weight: 1.5,
            overshoot_from: Lane::splat(0.3),
        }
    }

    fn loss_of(residual: &Residual, parameters: &[f32], model: &Model, scenario: &Scenario) -> f64 {
        let controller = LaneController::new(residual, parameters);
        let mut tape = ClosedLoopTape::new(model, scenario.ticks);
        let weighted = controller.forward(model, scenario, &mut tape).weighted;
        weighted + (0..scenario.ticks).map(|tick| restraint(scenario, &tape, tick)).sum::<f64>()
    }

    /// Price of holding the valve back at a tick: linear in the command below the open valve.
    fn restraint(scenario: &Scenario, tape: &ClosedLoopTape, tick: usize) -> f64 {
        let command = &tape.signals.command[tick];
        let slope = loss::restraint_slope(scenario, &tape.pressure[tick], command, tick);
        f64::from(slope.zip(command, |slope, u| slope * (u - COMMAND_MAX)).sum())
    }

    fn check(period_us: u32, scenario: &Scenario, model: &Model) {
        let (mut parameters, ticks) = (parameters(), scenario.ticks);
        let residual = controller(period_us, &parameters);
        let lanes = LaneController::new(&residual, &parameters);
        let mut tape = ClosedLoopTape::new(model, ticks);
        lanes.forward(model, scenario, &mut tape);
        let limits = |u: &Lane| u.0.iter().all(|u| (1.0..99.0).contains(u));
        assert!(tape.signals.command.iter().all(limits), "the check needs commands off their limits");
        let mut gradient = vec![0.0; Network::PARAMETERS];
        lanes.backward(scenario, &mut tape, &mut gradient);

        let largest = gradient.iter().fold(0.0_f32, |m, g| m.max(g.abs()));
        let mut checked = 0;
        for n in (0..parameters.len()).step_by(13).chain([parameters.len() - 1]) {
            let (kept, step) = (parameters[n], 4e-3);
            parameters[n] = kept + step;
            let above = loss_of(&residual, &parameters, model, scenario);
            parameters[n] = kept - step;
            let below = loss_of(&residual, &parameters, model, scenario);
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
        let model = model(Architecture::StateSpace(config));
        check(1000, &scenario(150), &model);
    }

    #[test]
    fn the_gradient_of_the_price_of_restraint_agrees_with_finite_differences() {
        let config = StateSpaceConfig { states: 6, hidden: 8, ..StateSpaceConfig::for_period(1000, 1) };
        let model = model(Architecture::StateSpace(config));
        let scenario = Scenario {
            prescribed: Prescribed::square(150, Lane::splat(40.0), 5.0),
            weight: Lane::ZERO,
            restraint_price: 1.0,
            ..scenario(150)
        };
        check(1000, &scenario, &model);
    }

    #[test]
    fn the_gradient_of_the_measured_margins_agrees_with_finite_differences() {
        let config = StateSpaceConfig { states: 6, hidden: 8, ..StateSpaceConfig::for_period(1000, 1) };
        let model = model(Architecture::StateSpace(config));
        let sine = |periods: usize, amplitude: f32| Sine {
            periods,
            amplitude: std::array::from_fn(|pair| amplitude * (1.0 + pair as f32)),
            phase: 0.3 * periods as f32,
        };
        let probe = Probe {
            window: (60, 80),
            sines: vec![sine(1, 0.5), sine(3, 0.3)],
            bound: [0.2; PAIRS],
            price: 10.0,
        };
        check(1000, &Scenario { probe: Some(probe), ..scenario(150) }, &model);
    }

    #[test]
    fn the_gradient_through_a_students_state_agrees_with_finite_differences() {
        let config = StateSpaceConfig { states: 6, hidden: 8, ..StateSpaceConfig::for_period(1000, 1) };
        let model = model(Architecture::StateSpace(config));
        check(1000, &Scenario { memory: Some(Recall::of_student()), ..scenario(150) }, &model);
    }

    #[test]
    fn the_gradient_through_the_authors_simulator_agrees_with_finite_differences() {
        let stitched = Architecture::Stitched(StitchedConfig::for_period(30_000));
        let wild = stitched.initialise(&mut ChaCha8Rng::seed_from_u64(2));
        let tame: Vec<f32> = wild.iter().map(|w| 0.5 * w).collect();
        let model = Model::new(stitched, &tame);
        check(30_000, &scenario(29), &model);
    }

    #[test]
    fn lanes_and_chip_give_the_same_commands() {
        let parameters = parameters();
        let residual = controller(1000, &parameters);
        let config = StateSpaceConfig::for_period(1000, 1);
        let model = model(Architecture::StateSpace(config));
        let scenario = scenario(400);
        let lanes = LaneController::new(&residual, &parameters);
        let mut tape = ClosedLoopTape::new(&model, scenario.ticks);
        lanes.forward(&model, &scenario, &mut tape);

        let chip = Controller::Residual(residual);
        for l in [0, 7, LANES - 1] {
            let mut state = ControllerState::new();
            chip.start_breath(&mut state, scenario.rest[l]);
            for tick in 0..scenario.ticks {
                let pressure = tape.pressure[tick][l] + scenario.noise[tick][l];
                let Prescribed { pip, peep, rise_ticks, .. } = &scenario.prescribed;
                let seen = Observation {
                    pressure,
                    target: scenario.prescribed.target(tick)[l],
                    pip: pip[l],
                    peep: peep[l],
                    tick: tick.min(scenario.held_tick) as u32,
                    rise_ticks: rise_ticks[l],
                };
                let command = chip.step(&mut state, &seen).command;
                chip.applied(&mut state, command);
                // The chip gets the pressures of the lanes, so differences cannot accumulate through the plant.
                assert!((command - tape.signals.command[tick][l]).abs() < 1e-2, "tick {tick}");
            }
        }
    }

    #[test]
    fn an_effort_lowers_the_simulated_pressure_by_its_pull() {
        let config = StateSpaceConfig::for_period(1000, 1);
        let model = model(Architecture::StateSpace(config));
        let parameters = parameters();
        let residual = controller(1000, &parameters);
        let disturbed = scenario(200);
        let calm = Scenario { pull: Vec::new(), ..disturbed.clone() };
        let pressures = |scenario: &Scenario| {
            let mut tape = ClosedLoopTape::new(&model, scenario.ticks);
            LaneController::new(&residual, &parameters).forward(&model, scenario, &mut tape);
            (tape.pressure, tape.signals.error)
        };
        let ((pulled, seen), (free, _)) = (pressures(&disturbed), pressures(&calm));
        // Within the dead time of 10 ms the commands, which differ, have not acted yet.
        for tick in 0..10 {
            let pull = disturbed.pull[tick];
            for l in 0..LANES {
                assert!((free[tick][l] - pulled[tick][l] - pull[l]).abs() < 1e-5, "tick {tick}");
                let measured = pulled[tick][l] + disturbed.noise[tick][l];
                let target = disturbed.prescribed.target(tick)[l];
                assert!((seen[tick][l] - (target - measured)).abs() < 1e-5, "tick {tick}");
            }
        }
        assert!((free[9][LANES - 1] - pulled[9][LANES - 1]).abs() > 1.0, "the pull is large enough to tell");
    }
}
