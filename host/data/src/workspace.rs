//! The folder of a run, from which a stopped run continues.
//!
//! Its `run.json` holds the recipe: everything that decides the results. A run of another recipe is refused there. Every part is
//! written whole and renamed, so a run can be killed at any moment.

use std::fs;
use std::io::{self, ErrorKind};
use std::path::{Path, PathBuf};

use serde::Serialize;
use serde::de::DeserializeOwned;
use serde_json::Value;
use thiserror::Error;

use crate::difference;
use crate::files::{ROOM, check_room, create_json_indented, read_json, write_json, write_json_indented};

/// File of the recipe.
const RECIPE: &str = "run.json";

/// Why a folder or a file of a run cannot be used.
#[derive(Debug, Error)]
#[expect(missing_docs, reason = "the messages name every field")]
pub enum WorkspaceError {
    /// The file system refuses, or a file is damaged.
    #[error("cannot use {}: {source}", path.display())]
    File { path: PathBuf, source: io::Error },
    /// What is there has another recipe.
    #[error("{} belongs to another run: {difference}; choose another folder or file, or use the same options", path.display())]
    OtherRun { path: PathBuf, difference: String },
}

impl WorkspaceError {
    /// Wraps an error of a file with its path.
    pub fn file(path: &Path) -> impl FnOnce(io::Error) -> Self + use<> {
        let path = path.to_owned();
        move |source| Self::File { path, source }
    }
}

/// Refuses a file whose recipe differs from that of the run.
///
/// # Errors
/// The first difference.
pub fn same(path: &Path, there: &impl Serialize, here: &impl Serialize) -> Result<(), WorkspaceError> {
    match difference::between(there, here) {
        None => Ok(()),
        Some(difference) => Err(WorkspaceError::OtherRun { path: path.to_owned(), difference }),
    }
}

/// A folder of parts: JSON files, and others whose writers take a path. It need not exist yet.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Workspace(PathBuf);

impl Workspace {
    /// The run in this folder.
    pub fn new(path: impl Into<PathBuf>) -> Self {
        Self(path.into())
    }

    /// Path of the part with this name.
    pub fn path(&self, name: &str) -> PathBuf {
        self.0.join(name)
    }

    /// A folder within.
    #[must_use]
    pub fn folder(&self, name: &str) -> Self {
        Self(self.path(name))
    }

    /// Marks the folder as that of a run. Of runs with different recipes that begin at the same moment, one succeeds.
    ///
    /// # Errors
    /// The folder has another recipe, or cannot be used.
    pub fn claim<R: Serialize + DeserializeOwned>(&self, recipe: &R) -> Result<(), WorkspaceError> {
        let path = self.path(RECIPE);
        check_room(&self.0, ROOM).map_err(WorkspaceError::file(&self.0))?;
        loop {
            if let Some(there) = self.recipe::<Value>()? {
                // What an earlier program did not write has its default.
                return R::deserialize(&there).map_or_else(
                    |_| same(&self.0, &there, recipe),
                    |earlier| same(&self.0, &earlier, recipe),
                );
            }
            if create_json_indented(&path, recipe).map_err(WorkspaceError::file(&path))? {
                return Ok(());
            }
        }
    }

    /// The recipe of the run, or a part of it; none before the run has begun.
    ///
    /// # Errors
    /// A file that cannot be read.
    pub fn recipe<R: DeserializeOwned>(&self) -> Result<Option<R>, WorkspaceError> {
        self.load(RECIPE)
    }

    /// The part with this name; none if there is none.
    ///
    /// # Errors
    /// A file that cannot be read, or contains something else.
    pub fn load<T: DeserializeOwned>(&self, name: &str) -> Result<Option<T>, WorkspaceError> {
        let path = self.path(name);
        read_json(&path).map_err(WorkspaceError::file(&path))
    }

    /// Writes a part as one line of JSON.
    ///
    /// # Errors
    /// A file that cannot be written.
    pub fn save(&self, name: &str, part: &impl Serialize) -> Result<(), WorkspaceError> {
        let path = self.path(name);
        write_json(&path, part).map_err(WorkspaceError::file(&path))
    }

    /// Writes a part as JSON that people read, too.
    ///
    /// # Errors
    /// A file that cannot be written.
    pub fn save_indented(&self, name: &str, part: &impl Serialize) -> Result<(), WorkspaceError> {
        let path = self.path(name);
        write_json_indented(&path, part).map_err(WorkspaceError::file(&path))
    }

    /// The part with this name, or the one that `make` gives, which is then kept.
    ///
    /// # Errors
    /// That of `make`, or a file that cannot be used.
    pub fn keep<T: Serialize + DeserializeOwned, E: From<WorkspaceError>>(
        &self,
        name: &str,
        make: impl FnOnce() -> Result<T, E>,
    ) -> Result<T, E> {
        if let Some(kept) = self.load(name)? {
            return Ok(kept);
        }
        let part = make()?;
        self.save_indented(name, &part)?;
        Ok(part)
    }

    /// Removes a part, or a folder within, if it exists.
    ///
    /// # Errors
    /// The file system refuses.
    pub fn remove(&self, name: &str) -> Result<(), WorkspaceError> {
        let path = self.path(name);
        let removed = if path.is_dir() { fs::remove_dir_all(&path) } else { fs::remove_file(&path) };
        match removed {
            Err(error) if error.kind() != ErrorKind::NotFound => Err(WorkspaceError::file(&path)(error)),
            _ => Ok(()),
        }
    }
}

#[cfg(test)]
mod tests;
