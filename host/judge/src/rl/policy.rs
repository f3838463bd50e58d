//! A learned policy as a controller of the valve: its file, and its score on the true bench.
//!
//! A policy is no [`shared::control::Controller`]: its network is larger than the chip's, and it never leaves the
//! host. It is a [`ControlLaw`] of its own, so the ventilator runs it with the timing and the safety of any other.

use std::path::Path;

use serde::{Deserialize, Serialize};
use shared::control::features::FEATURES;
use shared::control::residual::ResidualError;
use shared::control::{ControlLaw, ControlOutput, Observation};

use super::network::{Mlp, MlpTape, Weights};
use super::ventilation::{Perception, PolicyMemory, Senses, command};
use super::{Actions, Greedy, best};
use crate::evaluate::{Evaluation, Plan, evaluate_law};
use data::tensors::{self, TensorError};
use engine::Lane;
use plant::bench::BenchConfig;
use progress::Progress;
use ventilator::SourceError;

/// What the file says it is.
const KIND: &str = "policy";
/// Name of the parameter vector.
const PARAMETERS: &str = "parameters";

/// A policy without exploration, with the senses that it was trained with.
#[derive(Clone, Debug, PartialEq)]
pub struct Policy {
    /// Network and what its outputs stand for.
    pub greedy: Greedy,
    /// How it senses and acts.
    pub perception: Perception,
}

/// What stands in the file's metadata.
#[derive(Serialize, Deserialize)]
struct Metadata {
    network: Mlp,
    actions: Actions,
    senses: Senses,
}

impl Policy {
    /// Writes a safetensors file: one vector of parameters, everything else as JSON in the metadata.
    ///
    /// # Errors
    /// The file cannot be written.
    pub fn save(&self, path: &Path) -> Result<(), TensorError> {
        let Greedy { network, parameters, actions } = &self.greedy;
        let senses = *self.perception.senses();
        let metadata = Metadata { network: network.clone(), actions: *actions, senses };
        tensors::save(path, KIND, &metadata, &[(PARAMETERS, parameters)])
    }

    /// Reads what [`Self::save`] wrote.
    ///
    /// # Errors
    /// The file cannot be read, is torn, or holds something else.
    pub fn load(path: &Path) -> Result<Self, TensorError> {
        let (metadata, mut vectors): (Metadata, _) = tensors::load(path, KIND, &[PARAMETERS])?;
        let Metadata { network, actions, senses } = metadata;
        let outputs = super::head::Head::outputs(actions);
        if network.inputs() != FEATURES || network.outputs() != outputs {
            return Err(TensorError::format(path, KIND, &"its network does not fit its task"));
        }
        let parameters = vectors.swap_remove(0);
        if parameters.len() != network.parameters() {
            let expected = network.parameters();
            let reason = format!("{} parameters where {expected} belong", parameters.len());
            return Err(TensorError::format(path, KIND, &reason));
        }
        let perception = senses.build().map_err(|e: ResidualError| TensorError::format(path, KIND, &e))?;
        Ok(Self { greedy: Greedy { network, parameters, actions }, perception })
    }
}

/// Runs a policy on a bench as planned, at the control period it was trained for. The result does not depend on the
/// number of threads.
///
/// # Errors
/// The first waveform's, in the plan's order, that could not be run: refused settings or a fault.
pub fn evaluate(bench: &BenchConfig, policy: &Policy, plan: &Plan) -> Result<Evaluation, SourceError> {
    let plan = Plan { period_us: policy.perception.senses().period_us, ..plan.clone() };
    evaluate_law(bench, &PolicyLaw::new(policy), &plan, &Progress::silent())
}

/// A policy built to control.
#[derive(Clone)]
struct PolicyLaw<'a> {
    policy: &'a Policy,
    weights: Weights,
}

/// What a policy remembers of a breath, room for its network, and the command that it holds, percent.
struct PolicyState {
    memory: PolicyMemory,
    tape: MlpTape,
    held: f32,
}

impl<'a> PolicyLaw<'a> {
    fn new(policy: &'a Policy) -> Self {
        let Greedy { network, parameters, .. } = &policy.greedy;
        Self { policy, weights: network.load(parameters) }
    }
}

impl ControlLaw for PolicyLaw<'_> {
    type State = PolicyState;

    fn initial_state(&self) -> PolicyState {
        let tape = MlpTape::new(&self.policy.greedy.network, 1);
        PolicyState { memory: PolicyMemory::default(), tape, held: 0.0 }
    }

    fn start_breath(&self, state: &mut PolicyState, command: f32) {
        self.policy.perception.start_breath(&mut state.memory, command);
    }

    /// All of the command is the base: there is no PID under it to go back to.
    fn step(&self, state: &mut PolicyState, seen: &Observation) -> ControlOutput {
        let features = self.policy.perception.see(&mut state.memory, seen);
        if seen.tick.is_multiple_of(self.policy.perception.senses().hold) {
            for (lane, feature) in state.tape.inputs(0).iter_mut().zip(features) {
                *lane = Lane::splat(feature);
            }
            self.weights.forward(&mut state.tape);
            let actions = self.policy.greedy.actions;
            state.held = command(actions, best(actions, state.tape.outputs(0))[0]);
        }
        ControlOutput::plain(state.held)
    }

    fn applied(&self, state: &mut PolicyState, command: f32) {
        self.policy.perception.applied(&mut state.memory, command);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rl::ventilation::TaskConfig;
    use rand_chacha::ChaCha8Rng;
    use rand_chacha::rand_core::SeedableRng;

    fn plan() -> Plan {
        Plan { pips: vec![15.0, 35.0], breaths: 2, seeds: vec![4, 5], ..Plan::default() }
    }

    /// A policy that always chooses the same level of 21.
    fn stubborn(level: usize) -> Policy {
        let network = Mlp::new(&[FEATURES, 21]);
        let mut parameters = vec![0.0; network.parameters()];
        parameters[FEATURES * 21 + level] = 1.0;
        let perception = Senses::new(&TaskConfig::default(), 1000).build().unwrap();
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
        let law = PolicyLaw::new(&policy);
        let mut state = law.initial_state();
        law.start_breath(&mut state, 5.0);
        let commands: Vec<u32> = (0..30)
            .map(|tick| {
                let seen = Observation {
                    pressure: 5.0 + 0.3 * tick as f32,
                    target: 20.0,
                    pip: 20.0,
                    peep: 5.0,
                    tick,
                };
                let command = law.step(&mut state, &seen).command;
                law.applied(&mut state, command);
                command.to_bits()
            })
            .collect();
        let held = |from: usize| commands[from..from + 10].iter().all(|command| *command == commands[from]);
        assert!(held(0) && held(10) && held(20));
        assert!(commands[0] != commands[10] && commands[10] != commands[20]);
    }

    #[test]
    fn a_policy_survives_its_file_and_a_torn_one_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("policy.safetensors");
        stubborn(3).save(&path).unwrap();
        assert_eq!(Policy::load(&path).unwrap(), stubborn(3));
        let mut misfit = stubborn(3);
        misfit.greedy.actions = Actions::Continuous;
        misfit.save(&path).unwrap();
        assert!(matches!(Policy::load(&path), Err(TensorError::Format { .. })));
        let whole = std::fs::read(&path).unwrap();
        std::fs::write(&path, &whole[..whole.len() - 4]).unwrap();
        assert!(matches!(Policy::load(&path), Err(TensorError::Format { .. })));
    }
}
