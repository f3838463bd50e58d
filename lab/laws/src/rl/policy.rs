//! A learned policy as a controller of the valve, and its score on the true bench.
//!
//! A policy is not a [`shared::control::Controller`]: its network is larger than the chip's and runs only on the host.
//! It implements [`ControlLaw`], so the ventilator runs it with the same timing and safety as any other controller.

use shared::control::{ControlLaw, ControlOutput, Observation};

use super::network::Single;
use super::ventilation::{Perception, PolicyMemory, valve_command};
use super::{Greedy, best};
use engine::Lane;
use plant::bench::BenchConfig;
use progress::Progress;
use score::evaluate::{Evaluated, Plan, evaluate_law};

/// A policy without exploration, with the perception that it was trained with.
#[derive(Clone, Debug, PartialEq)]
pub struct Policy {
    /// Network and meaning of its outputs.
    pub greedy: Greedy,
    /// How it observes and acts.
    pub perception: Perception,
}

/// Runs a policy on a bench by a plan, at the control period that it was trained for. The result does not depend on the
/// number of threads.
///
/// # Errors
/// The error of the first waveform, in the plan's order, that could not be run: refused settings or a fault.
pub fn evaluate(bench: &BenchConfig, policy: &Policy, plan: &Plan) -> Evaluated {
    let plan = Plan { period_us: policy.perception.period_us, ..plan.clone() };
    evaluate_law(bench, policy, &plan, &Progress::silent())
}

/// A policy's memory of a breath, its network, and the command that it holds, percent.
pub struct TrainedPolicyState {
    memory: PolicyMemory,
    network: Single,
    held: f32,
}

impl ControlLaw for Policy {
    type State = TrainedPolicyState;

    fn initial_state(&self) -> TrainedPolicyState {
        let Greedy { network, parameters, .. } = &self.greedy;
        TrainedPolicyState { memory: PolicyMemory::default(), network: network.single(parameters), held: 0.0 }
    }

    fn start_breath(&self, state: &mut TrainedPolicyState, command: f32) {
        self.perception.start_breath(&mut state.memory, command);
    }

    /// The whole command is the base: there is no PID under it to fall back to.
    fn step(&self, state: &mut TrainedPolicyState, seen: &Observation) -> ControlOutput {
        let features = self.perception.see(&mut state.memory, seen);
        if seen.tick.is_multiple_of(self.perception.hold) {
            let actions = self.greedy.actions;
            let outputs = state.network.outputs(&features.map(Lane::splat));
            state.held = valve_command(actions, best(actions, outputs)[0]);
        }
        ControlOutput::plain(state.held)
    }

    fn applied(&self, state: &mut TrainedPolicyState, command: f32) {
        self.perception.applied(&mut state.memory, command);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rl::Actions;
    use crate::rl::network::Mlp;
    use crate::rl::ventilation::TaskConfig;
    use rand_chacha::ChaCha8Rng;
    use rand_chacha::rand_core::SeedableRng;
    use score::evaluate::at_pips;
    use shared::control::features::FEATURES;
    use shared::settings::Settings;
    use ventilator::SourceError;

    fn plan() -> Plan {
        Plan {
            waveforms: at_pips(&[15.0, 35.0], &Settings::default()),
            breaths: 2,
            seeds: vec![4, 5],
            ..Plan::default()
        }
    }

    /// A policy that always chooses the same level of 21.
    fn stubborn(level: usize) -> Policy {
        let network = Mlp::new(&[FEATURES, 21]);
        let mut parameters = vec![0.0; network.parameters()];
        parameters[FEATURES * 21 + level] = 1.0;
        let perception = Perception::new(&TaskConfig::default(), 1000).unwrap();
        Policy { greedy: Greedy { network, parameters, actions: Actions::Discrete(21) }, perception }
    }

    #[test]
    fn a_policy_that_opens_the_valve_for_good_ends_in_a_fault() {
        let outcome = evaluate(&BenchConfig::paper(20.0, 20.0), &stubborn(20), &plan());
        assert!(matches!(outcome, Err(SourceError::Fault { breath: 0, .. })), "{outcome:?}");
    }

    #[test]
    fn a_policy_that_never_opens_the_valve_misses_by_the_whole_step() {
        let evaluation = evaluate(&BenchConfig::paper(20.0, 20.0), &stubborn(0), &plan()).unwrap();
        for waveform in evaluation.waveforms {
            assert!((waveform.score.score - f64::from(waveform.pip - 5.0)).abs() < 0.5, "{waveform:?}");
        }
    }

    #[test]
    fn an_action_is_held() {
        let network = Mlp::with_hidden(FEATURES, &[8], 1);
        let parameters = network.initialise(0.1, &mut ChaCha8Rng::seed_from_u64(2));
        let policy =
            Policy { greedy: Greedy { network, parameters, actions: Actions::Continuous }, ..stubborn(0) };
        let mut state = policy.initial_state();
        policy.start_breath(&mut state, 5.0);
        let commands: Vec<u32> = (0..30)
            .map(|tick| {
                let seen = Observation {
                    pressure: 5.0 + 0.3 * tick as f32,
                    target: 20.0,
                    pip: 20.0,
                    peep: 5.0,
                    tick,
                    rise_ticks: 0,
                };
                let command = policy.step(&mut state, &seen).command;
                policy.applied(&mut state, command);
                command.to_bits()
            })
            .collect();
        let held = |from: usize| commands[from..from + 10].iter().all(|command| *command == commands[from]);
        assert!(held(0) && held(10) && held(20));
        assert!(commands[0] != commands[10] && commands[10] != commands[20]);
    }
}
