//! A learned simulator as a value: architecture, parameters, origin, and the safetensors file that contains them.

use std::path::Path;
use std::sync::Arc;

use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};

use super::hybrid::{Hybrid, HybridConfig};
use super::state_space::{StateSpace, StateSpaceConfig};
use super::stitched::{Stitched, StitchedConfig};
use super::unit::{UnitConfig, Units};
use super::{AnyDynamics, Timing};
use data::tensors::{self, TensorError};

/// An architecture and its shape.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(tag = "architecture", rename_all = "snake_case")]
pub enum Architecture {
    /// Our model of one plant.
    StateSpace(StateSpaceConfig),
    /// Our model of many lungs.
    Hybrid(HybridConfig),
    /// The authors' stitched networks.
    Stitched(StitchedConfig),
    /// Our physical model of many units.
    Unit(UnitConfig),
}

impl Architecture {
    /// Division of time into blocks.
    pub fn timing(&self) -> &Timing {
        match self {
            Self::StateSpace(config) => &config.timing,
            Self::Hybrid(config) => &config.timing,
            Self::Stitched(config) => &config.timing,
            Self::Unit(config) => &config.timing,
        }
    }

    /// Number of parameters.
    pub fn parameters(&self) -> usize {
        match self {
            Self::StateSpace(config) => config.parameters(),
            Self::Hybrid(config) => config.parameters(),
            Self::Stitched(config) => config.parameters(),
            Self::Unit(config) => config.parameters(),
        }
    }

    /// Number of units that a breath can name as its ventilator; 1 for a model of one plant.
    pub fn members(&self) -> usize {
        match self {
            Self::Unit(config) => config.units,
            Self::Hybrid(config) => config.ventilators,
            Self::StateSpace(_) | Self::Stitched(_) => 1,
        }
    }

    /// Draws initial parameters.
    pub fn initialise(&self, rng: &mut ChaCha8Rng) -> Vec<f32> {
        match self {
            Self::StateSpace(config) => config.initialise(rng),
            Self::Hybrid(config) => config.initialise(rng),
            Self::Stitched(config) => config.initialise(rng),
            Self::Unit(config) => config.initialise(),
        }
    }
}

/// A learned simulator. In its file, everything except the parameters is JSON in the metadata.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Simulator {
    /// Architecture and shape.
    #[serde(flatten)]
    pub architecture: Architecture,
    /// Its parameters, in the architecture's order.
    #[serde(skip)]
    pub parameters: Vec<f32>,
    /// Standard deviation of the sensor noise, estimated from the recording, cmH2O.
    pub noise: f32,
    /// Mean pressure before an inspiration in the recording, cmH2O.
    pub start_pressure: f32,
    /// Name of the plant it was learned from.
    pub plant: String,
}

/// A simulator ready to run; any number of rollouts can share it.
#[derive(Clone, Debug)]
pub struct Model {
    architecture: Architecture,
    pub(super) dynamics: Arc<dyn AnyDynamics>,
}

impl Model {
    /// A model of an architecture.
    ///
    /// # Panics
    /// If `parameters` does not have [`Architecture::parameters`] entries.
    pub fn new(architecture: Architecture, parameters: &[f32]) -> Self {
        let dynamics: Arc<dyn AnyDynamics> = match architecture {
            Architecture::StateSpace(config) => Arc::new(StateSpace::new(config, parameters)),
            Architecture::Hybrid(config) => Arc::new(Hybrid::new(config, parameters)),
            Architecture::Stitched(_) => Arc::new(Stitched::new(parameters)),
            Architecture::Unit(config) => Arc::new(Units::new(config, parameters)),
        };
        Self { architecture, dynamics }
    }

    /// Architecture and shape.
    pub fn architecture(&self) -> &Architecture {
        &self.architecture
    }
}

/// The kind recorded in the file.
pub const KIND: &str = "simulator";
/// Name of the parameter vector in the file.
const PARAMETERS: &str = "parameters";

impl Simulator {
    /// The simulator, ready to run.
    pub fn model(&self) -> Model {
        Model::new(self.architecture, &self.parameters)
    }

    /// Writes a safetensors file: one vector of parameters, everything else as JSON in the metadata.
    ///
    /// # Errors
    /// The file cannot be written.
    pub fn save(&self, path: &Path) -> Result<(), TensorError> {
        tensors::save(path, KIND, self, &[(PARAMETERS, &self.parameters)])
    }

    /// Reads a file written by [`Self::save`].
    ///
    /// # Errors
    /// The file cannot be read, is damaged, or contains something else.
    pub fn load(path: &Path) -> Result<Self, TensorError> {
        let (mut simulator, mut vectors): (Self, _) = tensors::load(path, KIND, &[PARAMETERS])?;
        simulator.parameters = vectors.swap_remove(0);
        let (found, expected) = (simulator.parameters.len(), simulator.architecture.parameters());
        if found != expected {
            let reason = format!("{found} parameters, expected {expected}");
            return Err(TensorError::format(path, KIND, &reason));
        }
        Ok(simulator)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand_chacha::rand_core::SeedableRng;

    fn simulator() -> Simulator {
        let config = StateSpaceConfig::for_period(1000, 1);
        let parameters = config.initialise(&mut ChaCha8Rng::seed_from_u64(0));
        let architecture = Architecture::StateSpace(config);
        Simulator { architecture, parameters, noise: 0.1, start_pressure: 5.0, plant: "R20C20".into() }
    }

    #[test]
    fn a_simulator_survives_its_file_bit_for_bit() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("simulator.safetensors");
        simulator().save(&path).unwrap();
        assert_eq!(Simulator::load(&path).unwrap(), simulator());
    }

    #[test]
    fn a_torn_file_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("simulator.safetensors");
        simulator().save(&path).unwrap();
        let whole = std::fs::read(&path).unwrap();
        for length in [0, 7, 100, whole.len() - 1] {
            std::fs::write(&path, &whole[..length]).unwrap();
            assert!(matches!(Simulator::load(&path), Err(TensorError::Format { .. })), "{length}");
        }
    }

    #[test]
    fn a_weight_that_is_no_number_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("simulator.safetensors");
        let mut broken = simulator();
        broken.parameters[5] = f32::NAN;
        broken.save(&path).unwrap();
        let text = Simulator::load(&path).unwrap_err().to_string();
        assert!(text.contains("parameters[5]"), "{text}");
    }
}
