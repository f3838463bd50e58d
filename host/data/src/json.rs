//! Values kept as JSON: settings, results, and the state from which stopped work goes on.

use std::fs;
use std::path::{Path, PathBuf};

use serde::Serialize;
use serde::de::DeserializeOwned;
use thiserror::Error;

use crate::files::write_atomically;

/// A file that cannot be read or written.
#[derive(Debug, Error)]
#[error("{}: {reason}", path.display())]
pub struct JsonError {
    /// The file.
    pub path: PathBuf,
    /// What is wrong, and what to do.
    pub reason: String,
}

impl JsonError {
    fn new(path: &Path, reason: impl Into<String>) -> Self {
        Self { path: path.to_owned(), reason: reason.into() }
    }
}

/// The value in a file; none if there is no file.
///
/// # Errors
/// A file that cannot be read or holds something else.
pub fn read<T: DeserializeOwned>(path: &Path) -> Result<Option<T>, JsonError> {
    if !path.exists() {
        return Ok(None);
    }
    let text = fs::read_to_string(path).map_err(|error| JsonError::new(path, error.to_string()))?;
    serde_json::from_str(&text).map(Some).map_err(|error| JsonError::new(path, format!("{error}; remove it")))
}

/// Writes a value, for people to read too; missing folders are created.
///
/// # Errors
/// A value that JSON cannot hold, or what the file system answers; the old file is then untouched.
pub fn write(path: &Path, value: &impl Serialize) -> Result<(), JsonError> {
    let text = text(value).map_err(|error| JsonError::new(path, error.to_string()))?;
    write_atomically(path, text.as_bytes()).map_err(|error| JsonError::new(path, error.to_string()))
}

/// A value as JSON on indented lines.
///
/// # Errors
/// A value that JSON cannot hold.
pub fn text(value: &impl Serialize) -> Result<String, serde_json::Error> {
    Ok(serde_json::to_string_pretty(value)? + "\n")
}

/// Marks a folder as that of one configuration, in its `run.json`; false if it belongs to another.
///
/// # Errors
/// A file that cannot be read or written.
pub fn claim<T: PartialEq + Serialize + DeserializeOwned>(
    folder: &Path,
    configuration: &T,
) -> Result<bool, JsonError> {
    let path = folder.join("run.json");
    if !path.exists() {
        return write(&path, configuration).map(|()| true);
    }
    // A configuration of another shape is another one.
    let text = fs::read_to_string(&path).map_err(|error| JsonError::new(&path, error.to_string()))?;
    Ok(serde_json::from_str::<T>(&text).is_ok_and(|earlier| earlier == *configuration))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_was_written_is_read_and_a_damaged_file_says_what_to_do() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a/b.json");
        assert_eq!(read::<Vec<f32>>(&path).unwrap(), None);
        write(&path, &[0.1_f32, 2.0]).unwrap();
        assert_eq!(read::<Vec<f32>>(&path).unwrap(), Some(vec![0.1, 2.0]));
        fs::write(&path, "[0.1, 2").unwrap();
        let error = read::<Vec<f32>>(&path).unwrap_err().to_string();
        assert!(error.contains("b.json") && error.contains("remove it"), "{error}");
    }

    #[test]
    fn a_value_that_json_cannot_hold_writes_no_file() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("map.json");
        let keyed_by_lists = std::collections::BTreeMap::from([(vec![1], 2)]);
        assert!(write(&path, &keyed_by_lists).is_err());
        assert!(!path.exists());
    }

    #[test]
    fn a_folder_belongs_to_its_first_configuration() {
        let folder = tempfile::tempdir().unwrap();
        for (configuration, own) in [(1, true), (1, true), (2, false)] {
            assert_eq!(claim(folder.path(), &configuration).unwrap(), own);
        }
        assert!(!claim(folder.path(), &"of another shape".to_owned()).unwrap());
    }
}
