//! A learned policy as a controller of the valve: its file, and its score on the true bench.
//!
//! A policy is no [`shared::control::Controller`]: its network is larger than the chip's, and it never leaves the
//! host. The bench therefore has a loop of its own here, with the timing, the supervisor and the safety filter of
//! [`shared::ventilator`]; a test holds it to the same scores as the ventilator's, bit for bit.

use std::path::Path;

use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use shared::breath::{Breath, Phase, period_s};
use shared::control::features::FEATURES;
use shared::control::residual::ResidualError;
use shared::control::{Observation, Wish};
use shared::safety::alarms::Fault;
use shared::safety::monitors::Monitors;
use shared::safety::supervisor::Supervisor;

use super::network::{Mlp, MlpTape, Weights};
use super::ventilation::{Perception, PerceptionState, Senses, command};
use super::{Actions, Greedy, best};
use crate::evaluate::{Evaluation, Inspiration, Plan, Score, score_breath, summarize};
use data::tensors::{self, TensorError};
use engine::Lane;
use plant::bench::{Bench, BenchConfig, STEP_US};
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
    score_pilots(bench, &plan, || Flight::new(policy))
}

/// Who commands the valve during an inspiration.
trait Pilot {
    /// Forgets the last breath; the valve stands at `command` percent.
    fn start_breath(&mut self, command: f32);

    /// The command wanted, percent.
    fn step(&mut self, seen: &Observation) -> f32;

    /// Takes in the command applied, percent.
    fn applied(&mut self, command: f32);
}

/// A policy at work.
struct Flight<'a> {
    policy: &'a Policy,
    weights: Weights,
    tape: MlpTape,
    memory: PerceptionState,
    held: f32,
}

impl<'a> Flight<'a> {
    fn new(policy: &'a Policy) -> Self {
        let Greedy { network, parameters, .. } = &policy.greedy;
        let (weights, tape) = (network.load(parameters), MlpTape::new(network, 1));
        Self { policy, weights, tape, memory: PerceptionState::default(), held: 0.0 }
    }
}

impl Pilot for Flight<'_> {
    fn start_breath(&mut self, command: f32) {
        self.policy.perception.start_breath(&mut self.memory, command);
    }

    fn step(&mut self, seen: &Observation) -> f32 {
        let features = self.policy.perception.see(&mut self.memory, seen);
        if seen.tick.is_multiple_of(self.policy.perception.senses().hold) {
            for (lane, feature) in self.tape.inputs(0).iter_mut().zip(features) {
                *lane = Lane::splat(feature);
            }
            self.weights.forward(&mut self.tape);
            let actions = self.policy.greedy.actions;
            self.held = command(actions, best(actions, self.tape.outputs(0))[0]);
        }
        self.held
    }

    fn applied(&mut self, command: f32) {
        self.policy.perception.applied(&mut self.memory, command);
    }
}

fn score_pilots<P: Pilot>(
    bench: &BenchConfig,
    plan: &Plan,
    pilot: impl Fn() -> P + Sync,
) -> Result<Evaluation, SourceError> {
    let jobs: Vec<(f32, u64)> =
        plan.pips.iter().flat_map(|pip| plan.seeds.iter().map(move |seed| (*pip, *seed))).collect();
    let outcomes: Vec<Result<Score, SourceError>> =
        jobs.par_iter().map(|(pip, seed)| run(bench, &mut pilot(), plan, *pip, *seed)).collect();
    Ok(summarize(plan, &outcomes.into_iter().collect::<Result<Vec<_>, _>>()?))
}

/// All breaths of one waveform under one seed.
fn run(
    config: &BenchConfig,
    pilot: &mut impl Pilot,
    plan: &Plan,
    pip: f32,
    seed: u64,
) -> Result<Score, SourceError> {
    let settings = plan.waveform(pip);
    let breath = Breath::new(&settings, plan.period_us)?;
    if !plan.period_us.is_multiple_of(STEP_US) {
        return Err(SourceError::Period { period_us: plan.period_us });
    }
    let mut lung = Lung {
        bench: Bench::new(config, settings.peep, seed)?,
        breath,
        supervisor: Supervisor::new(plan.period_us, Monitors::ALL),
        reading: settings.peep,
        last_command: 0.0,
    };
    let mut scores = Vec::with_capacity(plan.breaths);
    for number in 0..plan.warm_up + plan.breaths {
        let score = lung.breathe(pilot, number as u32)?;
        if number >= plan.warm_up {
            scores.push(score);
        }
    }
    Ok(Score::mean(&scores))
}

/// A bench under a pilot.
struct Lung {
    bench: Bench,
    breath: Breath,
    supervisor: Supervisor,
    reading: f32,
    last_command: f32,
}

impl Lung {
    /// One breath; the score of its inspiration, by the true pressure.
    fn breathe(&mut self, pilot: &mut impl Pilot, number: u32) -> Result<Score, SourceError> {
        let (mut pressure, mut target) = (Vec::new(), Vec::new());
        pilot.start_breath(self.last_command);
        for tick in 0..self.breath.total_ticks() {
            if self.breath.phase(tick) == Phase::Inspiration {
                pressure.push(f64::from(self.bench.pressures().airway_pressure));
                target.push(f64::from(self.breath.target(tick)));
            }
            self.tick(pilot, number, tick)?;
        }
        let settings = self.breath.settings();
        Ok(score_breath(&Inspiration {
            period_s: f64::from(period_s(self.breath.period_us())),
            peep: f64::from(settings.peep),
            pip: f64::from(settings.pip),
            pressure: &pressure,
            target: &target,
        }))
    }

    fn tick(&mut self, pilot: &mut impl Pilot, number: u32, tick: u32) -> Result<(), SourceError> {
        let (phase, settings) = (self.breath.phase(tick), *self.breath.settings());
        let believed = self.supervisor.check(self.reading, &self.breath, Some(tick));
        let cut = self.supervisor.cut().then_some(Fault::HighPressure);
        if let Some(fault) = self.supervisor.fault().or(cut) {
            return Err(SourceError::Fault { fault, breath: number, tick });
        }
        let wish = match phase {
            Phase::Inspiration => pilot.step(&Observation {
                pressure: believed.unwrap_or(self.reading),
                target: self.breath.target(tick),
                pip: settings.pip,
                peep: settings.peep,
                tick,
            }),
            Phase::Fall => 0.0,
            Phase::Expiration => settings.expiratory_bias,
        };
        let command = self.supervisor.command(Wish::plain(wish), phase != Phase::Inspiration);
        if phase == Phase::Inspiration {
            pilot.applied(command.u_in());
        }
        self.last_command = command.u_in();
        for _ in 0..self.breath.period_us() / STEP_US {
            self.reading = self.bench.step(command.u_in(), command.u_out()).pressure;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rl::ventilation::TaskConfig;
    use rand_chacha::ChaCha8Rng;
    use rand_chacha::rand_core::SeedableRng;
    use shared::control::pid::{Pid, PidGains};
    use shared::control::{Controller, ControllerState};

    struct Ventilated(Controller, ControllerState);

    impl Pilot for Ventilated {
        fn start_breath(&mut self, command: f32) {
            self.0.start_breath(&mut self.1, command);
        }

        fn step(&mut self, seen: &Observation) -> f32 {
            self.0.step(&mut self.1, seen).command
        }

        fn applied(&mut self, command: f32) {
            self.0.applied(&mut self.1, command);
        }
    }

    fn plan() -> Plan {
        Plan { pips: vec![15.0, 35.0], breaths: 2, seeds: vec![4, 5], ..Plan::default() }
    }

    #[test]
    fn the_loop_breathes_and_scores_as_the_ventilator_does() {
        let bench = BenchConfig::paper(20.0, 20.0);
        let pid = Pid::new(PidGains { p: 1.0, i: 15.0, d: 0.0 }, 1000).unwrap();
        let controller = Controller::Pid(pid);
        let expected = crate::evaluate::evaluate(&bench, &controller, &plan()).unwrap();
        let pilot = || Ventilated(controller.clone(), ControllerState::new());
        assert_eq!(score_pilots(&bench, &plan(), pilot).unwrap(), expected);
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
        let mut flight = Flight::new(&policy);
        flight.start_breath(5.0);
        let commands: Vec<u32> = (0..30)
            .map(|tick| {
                let seen = Observation {
                    pressure: 5.0 + 0.3 * tick as f32,
                    target: 20.0,
                    pip: 20.0,
                    peep: 5.0,
                    tick,
                };
                let command = flight.step(&seen);
                flight.applied(command);
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
