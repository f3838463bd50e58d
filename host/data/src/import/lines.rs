//! The lines of a file that is no table, whose rows form one group, named after the file.

use std::io::{BufRead, BufReader, Read};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use super::rows::index_of;
use super::table::text::Text;
use crate::identity::TestRun;
use crate::recording::DatasetError;

/// A file that is read line by line.
pub(super) struct Lines {
    path: PathBuf,
    reader: BufReader<Box<dyn Read + Send>>,
    bytes: Arc<AtomicU64>,
    line: Vec<u8>,
    group: Option<u32>,
}

impl Lines {
    pub(super) fn open(path: &Path) -> Result<Self, DatasetError> {
        let Text { reader, bytes } = Text::open(path)?;
        let reader = BufReader::new(reader);
        Ok(Self { path: path.to_owned(), reader, bytes, line: Vec::new(), group: None })
    }

    /// The next line that is not empty, without white space around it; none at the end.
    pub(super) fn next(&mut self) -> Result<Option<&[u8]>, DatasetError> {
        loop {
            self.line.clear();
            let read = self.reader.read_until(b'\n', &mut self.line);
            let count = read.map_err(|source| DatasetError::Read { path: self.path.clone(), source })?;
            if count == 0 {
                return Ok(None);
            }
            // Some ventilators leave zero bytes in between.
            self.line.retain(|byte| *byte != 0);
            if !self.line.trim_ascii().is_empty() {
                return Ok(Some(self.line.trim_ascii()));
            }
        }
    }

    /// Index of the file's group.
    pub(super) fn group(&mut self, groups: &mut Vec<TestRun>) -> u32 {
        *self.group.get_or_insert_with(|| {
            let name = self.path.file_stem().unwrap_or_default().to_string_lossy();
            index_of(groups, name.as_ref().into())
        })
    }

    /// Bytes of the file read so far.
    pub(super) fn position(&self) -> u64 {
        self.bytes.load(Ordering::Relaxed)
    }
}
