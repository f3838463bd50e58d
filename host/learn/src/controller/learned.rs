//! A learned controller as a file: safetensors for analysis and Python, and for our architecture the weights image for the chip.

use std::path::Path;

use serde::{Deserialize, Serialize};
use shared::control::residual::{Residual, ResidualError};
use shared::weights::{IMAGE_BYTES, Identity, WeightsError, encode};
use thiserror::Error;

use super::architecture::Trainable;
use data::tensors::{self, TensorError};

/// A trained controller with its origin.
#[derive(Clone, Debug, PartialEq)]
pub struct Learned<C = Residual> {
    /// The controller.
    pub controller: C,
    /// Its origin.
    pub origin: Origin,
}

/// Origin of a controller, and its scores in training.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Origin {
    /// The plant that its simulators were learned from.
    pub plant: String,
    /// Seed of the training.
    pub seed: u64,
    /// Git revision of the program.
    pub git_revision: String,
    /// Score on the held-out simulator, cmH2O.
    pub validation: f64,
    /// Score of its PID alone on the held-out simulator, cmH2O.
    pub base: f64,
}

/// Why a controller cannot be loaded or packed.
#[derive(Debug, Error)]
pub enum LearnedError {
    /// The file could not be read or written.
    #[error(transparent)]
    Tensors(#[from] TensorError),
    /// The controller in the file is not valid.
    #[error(transparent)]
    Residual(#[from] ResidualError),
    /// The image is not valid.
    #[error(transparent)]
    Weights(#[from] WeightsError),
    /// The controller in the file has another architecture than the one wanted.
    #[error(
        "{path} is a controller of the architecture {found}, not {wanted}: only ours runs on a device and fits a weights image; that \
         of the paper's authors runs on the host, in evaluate, robust and margins"
    )]
    Architecture {
        /// Path of the file.
        path: String,
        /// The architecture in the file.
        found: String,
        /// The architecture wanted.
        wanted: &'static str,
    },
}

#[derive(Serialize, Deserialize)]
struct Description<S> {
    #[serde(flatten)]
    named: Named,
    #[serde(flatten)]
    spec: S,
    origin: Origin,
}

/// The part of the description that names the architecture.
#[derive(Serialize, Deserialize)]
struct Named {
    /// None for ours.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    architecture: Option<String>,
}

impl Named {
    fn name(self) -> String {
        self.architecture.unwrap_or_else(|| OURS.to_owned())
    }
}

/// Name of our architecture.
const OURS: &str = "ours";

/// The kind recorded in the file.
pub const KIND: &str = "controller";
/// Name of the parameter vector: layer by layer, weights row by row, then biases.
const NETWORK: &str = "network";

/// The name of the architecture of a file written by [`Learned::save`].
///
/// # Errors
/// The file cannot be read, is damaged or contains something else.
pub fn architecture(path: &Path) -> Result<String, LearnedError> {
    let (named, _): (Named, _) = tensors::load(path, KIND, &[])?;
    Ok(named.name())
}

impl<C: Trainable> Learned<C> {
    /// Writes a safetensors file.
    ///
    /// # Errors
    /// The file cannot be written.
    pub fn save(&self, path: &Path) -> Result<(), LearnedError> {
        let description = Description {
            named: Named { architecture: C::NAME.map(str::to_owned) },
            spec: self.controller.specification(),
            origin: self.origin.clone(),
        };
        Ok(tensors::save(path, KIND, &description, &[(NETWORK, &self.controller.parameters())])?)
    }

    /// Reads a file written by [`Self::save`].
    ///
    /// # Errors
    /// The file cannot be read, is damaged or contains something else, has another architecture, or its controller is out of range.
    pub fn read(path: &Path) -> Result<Self, LearnedError> {
        let (found, wanted) = (architecture(path)?, C::NAME.unwrap_or(OURS));
        if found != wanted {
            return Err(LearnedError::Architecture { path: path.display().to_string(), found, wanted });
        }
        let (description, vectors): (Description<C::Spec>, _) = tensors::load(path, KIND, &[NETWORK])?;
        let network = &vectors[0];
        if network.len() != C::size() {
            let reason = format!("{} weights, expected {}", network.len(), C::size());
            return Err(TensorError::format(path, KIND, &reason).into());
        }
        Ok(Self { controller: C::build(description.spec, network)?, origin: description.origin })
    }
}

impl Learned {
    /// Reads a controller of our architecture; see [`Self::read`].
    ///
    /// # Errors
    /// See [`Self::read`].
    pub fn load(path: &Path) -> Result<Self, LearnedError> {
        Self::read(path)
    }

    /// The weights image for the chip.
    ///
    /// # Errors
    /// A controller that does not fit the image format.
    pub fn image(&self) -> Result<Vec<u8>, LearnedError> {
        let identity = Identity {
            training: label(&format!("seed {}", self.origin.seed)),
            plant: label(&self.origin.plant),
        };
        let mut image = vec![0; IMAGE_BYTES];
        let length = encode(&self.controller, &identity, &mut image)?;
        image.truncate(length);
        Ok(image)
    }
}

/// Text as a fixed-length field of the image: cut, or padded with zeros.
fn label(text: &str) -> [u8; 16] {
    let mut field = [0; 16];
    for (place, byte) in field.iter_mut().zip(text.bytes()) {
        *place = byte;
    }
    field
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::controller::network::{chip_network, initial_parameters};
    use rand_chacha::ChaCha8Rng;
    use rand_chacha::rand_core::SeedableRng;
    use shared::control::features::FeatureSpec;
    use shared::control::pid::PidGains;
    use shared::control::residual::ResidualSpec;
    use shared::weights::decode;

    fn learned() -> Learned {
        let network = chip_network(&initial_parameters(&mut ChaCha8Rng::seed_from_u64(1)));
        let spec = ResidualSpec {
            period_us: 1000,
            gains: PidGains { p: 2.0, i: 20.0, d: 0.01 },
            lambda: 0.8,
            authority: 90.0,
            features: FeatureSpec::default(),
        };
        let origin =
            Origin { plant: "R20C20".into(), seed: 7, validation: 0.9, base: 1.5, ..Origin::default() };
        Learned { controller: Residual::new(spec, network).unwrap(), origin }
    }

    #[test]
    fn a_controller_survives_its_file_bit_for_bit() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("controller.safetensors");
        learned().save(&path).unwrap();
        assert_eq!(Learned::load(&path).unwrap(), learned());
    }

    /// Older files do not name it either.
    #[test]
    fn a_file_of_our_architecture_does_not_name_it() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("controller.safetensors");
        learned().save(&path).unwrap();
        let bytes = std::fs::read(&path).unwrap();
        assert!(!String::from_utf8_lossy(&bytes).contains("architecture"));
        assert_eq!(architecture(&path).unwrap(), OURS);
    }

    #[test]
    fn the_image_holds_the_same_controller() {
        let image = decode(&learned().image().unwrap()).unwrap();
        assert_eq!(image.residual, learned().controller);
        assert_eq!(&image.identity.plant[..6], b"R20C20");
    }

    #[test]
    fn a_simulator_is_not_taken_for_a_controller() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("simulator.safetensors");
        tensors::save(&path, "simulator", &1, &[("parameters", &[0.0])]).unwrap();
        let text = Learned::load(&path).unwrap_err().to_string();
        assert!(text.contains("is not a valid controller"), "{text}");
    }
}
