//! Descriptions as bytes, for a chip that runs the bench: CBOR (RFC 8949), the same tables and names as in TOML.

use super::{BenchConfig, BenchError};

impl BenchConfig {
    /// The complete description as bytes.
    #[cfg(feature = "std")]
    pub fn to_bytes(&self) -> Vec<u8> {
        minicbor_serde::to_vec(self).expect("numbers, texts, maps and lists always have a CBOR form")
    }

    /// Reads and validates a description; absent fields have their defaults.
    ///
    /// # Errors
    /// [`BenchError::Unreadable`] for bytes that are no description, or one with more faults, changes of the leak or letters than the
    /// storage has room for; as in [`BenchConfig::validate`].
    pub fn from_bytes(bytes: &[u8]) -> Result<Self, BenchError> {
        let config: Self = minicbor_serde::from_slice(bytes).map_err(|_| BenchError::Unreadable)?;
        config.validate()?;
        Ok(config)
    }
}
