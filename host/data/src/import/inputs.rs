//! The files of an import, and whether they stay the same while they are read: one to which another program still writes would give
//! a part of a recording, and say nothing.

use std::fs;
use std::path::{Path, PathBuf};
use std::time::SystemTime;

use crate::recording::DatasetError;

/// Length in bytes and time of the last change; none of what is not there, or is no plain file.
type Stamp = Option<(u64, Option<SystemTime>)>;

/// The files in their order, with what they were like before they were read.
#[derive(Debug)]
pub(super) struct Inputs<'a> {
    pub paths: &'a [PathBuf],
    stamps: Vec<Stamp>,
}

impl<'a> Inputs<'a> {
    pub fn new(paths: &'a [PathBuf]) -> Self {
        Self { paths, stamps: paths.iter().map(|path| stamp(path)).collect() }
    }

    /// Length of all files, bytes.
    pub fn bytes(&self) -> u64 {
        self.stamps.iter().flatten().map(|(length, _)| length).sum()
    }

    /// Fails if a file is no longer what it was.
    pub fn check(&self) -> Result<(), DatasetError> {
        let changed = |(path, before): &(&PathBuf, &Stamp)| stamp(path) != **before;
        match self.paths.iter().zip(&self.stamps).find(changed) {
            Some((path, _)) => Err(DatasetError::Changed(path.clone())),
            None => Ok(()),
        }
    }
}

fn stamp(path: &Path) -> Stamp {
    let there = fs::metadata(path).ok().filter(fs::Metadata::is_file)?;
    Some((there.len(), there.modified().ok()))
}
