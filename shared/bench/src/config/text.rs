//! Descriptions as TOML.

use std::path::Path;

use super::{BenchConfig, BenchError};

impl BenchConfig {
    /// Reads and validates a description; absent fields have their defaults.
    ///
    /// # Errors
    /// [`BenchError::Syntax`] for text that is not TOML, an unknown field or a wrong type; [`BenchError::OutOfRange`]
    /// and [`BenchError::LeakOrder`] as in [`BenchConfig::validate`].
    pub fn from_toml(text: &str) -> Result<Self, BenchError> {
        let config: Self = toml::from_str(text)?;
        config.validate()?;
        Ok(config)
    }

    /// The complete description, including defaults, as TOML.
    pub fn to_toml(&self) -> String {
        toml::to_string(self).expect("numbers, strings, tables and arrays of tables always have a TOML form")
    }

    /// Reads and validates the file at `path`.
    ///
    /// # Errors
    /// [`BenchError::File`] if it cannot be read; otherwise see [`BenchConfig::from_toml`].
    pub fn load(path: impl AsRef<Path>) -> Result<Self, BenchError> {
        let path = path.as_ref();
        let text = std::fs::read_to_string(path)
            .map_err(|source| BenchError::File { path: path.to_path_buf(), source })?;
        Self::from_toml(&text)
    }
}
