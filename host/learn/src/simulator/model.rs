//! A learned simulator as a value: architecture, parameters, origin, and the safetensors file that contains them.

use std::ops::Deref;
use std::path::Path;
use std::sync::Arc;

use serde::{Deserialize, Serialize};

use super::design::{Design, Dynamics};
use super::hybrid::HybridConfig;
use super::state_space::StateSpaceConfig;
use super::stitched::StitchedConfig;
use super::unit::UnitConfig;
use data::tensors::{self, TensorError};

/// Lists the architectures: the shape of each is a [`Design`].
macro_rules! architectures {
    ($($(#[$doc:meta])* $name:ident($shape:ty),)+) => {
        /// An architecture and its shape.
        #[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
        #[serde(tag = "architecture", rename_all = "snake_case")]
        pub enum Architecture {
            $($(#[$doc])* $name($shape),)+
        }

        impl Deref for Architecture {
            type Target = dyn Design;

            fn deref(&self) -> &(dyn Design + 'static) {
                match self {
                    $(Self::$name(shape) => shape,)+
                }
            }
        }
    };
}

architectures! {
    /// Our model of one plant.
    StateSpace(StateSpaceConfig),
    /// Our model of many lungs.
    Hybrid(HybridConfig),
    /// The authors' stitched networks.
    Stitched(StitchedConfig),
    /// Our physical model of many units.
    Unit(UnitConfig),
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
    parameters: Arc<[f32]>,
}

impl Model {
    /// A model of an architecture.
    ///
    /// # Panics
    /// If `parameters` does not have as many entries as the architecture has parameters.
    pub fn new(architecture: Architecture, parameters: &[f32]) -> Self {
        assert_eq!(parameters.len(), architecture.parameters(), "parameters of another shape");
        Self { architecture, parameters: parameters.into() }
    }

    /// Architecture and shape.
    pub fn architecture(&self) -> &Architecture {
        &self.architecture
    }

    /// Its parameters, in the architecture's order.
    pub(crate) fn parameters(&self) -> &[f32] {
        &self.parameters
    }

    /// The equations with these parameters, and memory for a rollout of `blocks` blocks.
    pub(super) fn dynamics(&self, blocks: usize) -> Box<dyn Dynamics> {
        self.architecture.dynamics(&self.parameters, blocks)
    }

    /// Whether the other is a copy of this model.
    pub(super) fn is(&self, other: &Self) -> bool {
        Arc::ptr_eq(&self.parameters, &other.parameters)
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
    /// The file cannot be read, is damaged, contains something else, or describes a simulator that cannot be built
    /// ([`Design::check`]).
    pub fn load(path: &Path) -> Result<Self, TensorError> {
        let (mut simulator, mut vectors): (Self, _) = tensors::load(path, KIND, &[PARAMETERS])?;
        let refused = |reason: &dyn ToString| TensorError::format(path, KIND, &reason.to_string());
        simulator.architecture.check().map_err(|error| refused(&error))?;
        if !(0.0..=f32::MAX).contains(&simulator.noise) {
            return Err(refused(&format!("noise is {}, but must be a number from 0 on", simulator.noise)));
        }
        simulator.parameters = vectors.swap_remove(0);
        let (found, expected) = (simulator.parameters.len(), simulator.architecture.parameters());
        if found != expected {
            return Err(refused(&format!("{found} parameters, expected {expected}")));
        }
        Ok(simulator)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand_chacha::ChaCha8Rng;
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
    fn metadata_that_no_simulator_can_have_is_refused_with_file_and_value() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("simulator.safetensors");
        let shapes = [
            Architecture::StateSpace(StateSpaceConfig::for_period(1000, 1)),
            Architecture::Hybrid(HybridConfig {
                ventilators: 2,
                groups: 3,
                ..HybridConfig::for_period(1000, 2)
            }),
            Architecture::Stitched(StitchedConfig::for_period(30_000)),
            Architecture::Unit(UnitConfig::for_period(1000, 2)),
        ];
        let huge = u64::MAX;
        for (name, values) in [
            ("period_us", vec![0, 1_000_001]),
            ("block_ticks", vec![0, huge]),
            ("parts", vec![0, 11, huge]),
            ("points", vec![0, 3, huge]),
            ("channels", vec![0, 4, huge]),
            ("states", vec![0, huge]),
            ("hidden", vec![0, huge]),
            ("history", vec![0, huge]),
            ("units", vec![0, huge]),
            ("ventilators", vec![huge]),
            ("groups", vec![huge]),
            ("inspiration_ms", vec![0]),
            ("expiration_ms", vec![0]),
        ] {
            let mut damaged = 0;
            for architecture in shapes {
                let parameters = architecture.initialise(&mut ChaCha8Rng::seed_from_u64(0));
                let whole = Simulator { architecture, parameters, ..simulator() };
                whole.save(&path).unwrap();
                assert_eq!(Simulator::load(&path).unwrap(), whole);
                for value in &values {
                    let mut description = serde_json::to_value(&whole).unwrap();
                    let own = description.get(name).is_some();
                    let place = if own { &mut description } else { &mut description["timing"] };
                    if let Some(field) = place.get_mut(name) {
                        *field = (*value).into();
                        tensors::save(&path, KIND, &description, &[(PARAMETERS, &whole.parameters)]).unwrap();
                        let told = Simulator::load(&path).unwrap_err().to_string();
                        assert!(told.contains("simulator.safetensors"), "{told}");
                        assert!(told.contains(&format!("{name} is {value}, ")), "{name}: {told}");
                        damaged += 1;
                    }
                }
            }
            assert!(damaged >= values.len(), "{name} is in no file");
        }
        Simulator { noise: -1.0, ..simulator() }.save(&path).unwrap();
        let told = Simulator::load(&path).unwrap_err().to_string();
        assert!(told.contains("noise is -1, "), "{told}");
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
