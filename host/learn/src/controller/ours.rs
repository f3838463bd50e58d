//! Our architecture in training: features, what earlier breaths have taught, and the network of the chip.

use engine::Lane;
use rand_chacha::ChaCha8Rng;
use shared::control::Controller;
use shared::control::features::{FEATURES, Features};
use shared::control::network::Network;
use shared::control::pid::Pid;
use shared::control::residual::{Residual, ResidualError, ResidualSpec};

use super::architecture::{ControllerArchitecture, LanePart, Trainable};
use super::features::{Averages, LaneFeatures};
use super::memory::Recall;
use super::network::{blind_to, chip_network, initial_parameters, lane_network};
use super::scenario::Scenario;
use super::signals::Signals;
use super::student::Student;
use crate::layers::{Layers, LayersTape};

impl Trainable for Residual {
    type Lanes = OurLanes;
    type Law = Controller;
    type Spec = ResidualSpec;

    const NAME: Option<&'static str> = None;

    fn build(spec: ResidualSpec, parameters: &[f32]) -> Result<Self, ResidualError> {
        Self::new(spec, chip_network(parameters))
    }

    fn specify(residual: ResidualSpec, architecture: ControllerArchitecture) -> Option<ResidualSpec> {
        architecture.is_ours().then_some(residual)
    }

    fn specification(&self) -> ResidualSpec {
        *self.spec()
    }

    fn parameters(&self) -> Vec<f32> {
        self.network().parameters().copied().collect()
    }

    fn size() -> usize {
        Network::PARAMETERS
    }

    fn initial_parameters(rng: &mut ChaCha8Rng) -> Vec<f32> {
        initial_parameters(rng)
    }

    fn blind_to(features: &[usize], parameters: &mut [f32]) {
        blind_to(features, parameters);
    }

    fn fixed_parts(&self) -> &Residual {
        self
    }

    fn lanes(&self, parameters: &[f32]) -> OurLanes {
        OurLanes { features: *self.features(), network: lane_network(parameters) }
    }

    fn law(&self) -> Controller {
        Controller::Residual(self.clone())
    }

    fn pid_law(pid: Pid, _period_us: u32) -> Result<Controller, ResidualError> {
        Ok(Controller::Pid(pid))
    }
}

/// Features and network.
#[derive(Clone, Debug)]
pub struct OurLanes {
    features: Features,
    network: Layers,
}

/// The features of a breath, and their averages up to a tick.
#[derive(Debug)]
pub struct OurBreath<'a> {
    features: LaneFeatures<'a>,
    averages: Averages,
    /// Its state, if the controller is a student.
    student: Option<Student>,
}

/// The state of a student at the start or the end of a breath, if the scenario asks for one.
fn student(scenario: &Scenario) -> Option<Student> {
    scenario.memory.as_ref().is_some_and(Recall::is_student).then(Student::default)
}

impl LanePart for OurLanes {
    type Tape = LayersTape;
    type Carried<'a> = OurBreath<'a>;

    fn tape(ticks: usize) -> LayersTape {
        lane_network(&vec![0.0; Network::PARAMETERS]).tape(ticks)
    }

    fn start<'a>(&'a self, scenario: &'a Scenario) -> OurBreath<'a> {
        let features = LaneFeatures::new(&self.features, scenario);
        let averages = features.start();
        OurBreath { features, averages, student: student(scenario) }
    }

    fn start_back<'a>(&'a self, scenario: &'a Scenario, _tape: &mut LayersTape) -> OurBreath<'a> {
        let features = LaneFeatures::new(&self.features, scenario);
        OurBreath { features, averages: Averages::default(), student: student(scenario) }
    }

    fn forward(
        &self,
        scenario: &Scenario,
        tape: &mut LayersTape,
        breath: &mut OurBreath<'_>,
        (signals, integral): (&Signals, &Lane),
        tick: usize,
    ) -> Lane {
        let seen = tape.inputs(tick);
        breath.features.forward(&mut breath.averages, signals, integral, tick, seen);
        match (&breath.student, &scenario.memory) {
            (Some(student), _) => seen[FEATURES..].copy_from_slice(student.inputs()),
            (None, Some(memory)) => memory.at(tick, &mut seen[FEATURES..]),
            // A tape may hold what another shard recalled.
            (None, None) => seen[FEATURES..].fill(Lane::ZERO),
        }
        let output = self.network.forward(tape, tick);
        if let Some(student) = &mut breath.student {
            student.learn(self.network.hidden(tape, tick));
        }
        output
    }

    fn applied(&self, breath: &mut OurBreath<'_>, command: &Lane) {
        breath.features.applied(&mut breath.averages, command);
    }

    fn applied_back(&self, breath: &mut OurBreath<'_>, d_command: &mut Lane) {
        breath.features.applied_back(&mut breath.averages, d_command);
    }

    fn backward(
        &self,
        tape: &mut LayersTape,
        breath: &mut OurBreath<'_>,
        d_output: Lane,
        (d_signals, d_integral): (&mut Signals, &mut Lane),
        tick: usize,
    ) {
        let d_features = if let Some(student) = &mut breath.student {
            let d_features = self.network.backward_with(tape, tick, d_output, &student.learn_back());
            student.inputs_back(&d_features[FEATURES..]);
            d_features
        } else {
            self.network.backward(tape, tick, d_output)
        };
        breath.features.backward(&mut breath.averages, d_features, tick, d_signals, d_integral);
    }

    fn finish(&self, tape: &LayersTape, gradient: &mut [f32]) {
        self.network.finish(tape, gradient);
    }
}
