//! Writes a recording row by row, in bounded memory.

use std::fs::File;
use std::io::BufWriter;
use std::path::{Path, PathBuf};

use parquet::file::writer::SerializedFileWriter;

use super::columns::Extra;
use super::parquet_file::{GROUP_ROWS, metadata, write_rows, writer};
use super::{DatasetError, Recording, Row, checksum};
use crate::files::Draft;
use crate::provenance::Provenance;

/// A recording that is being written. [`Self::finish`] makes the complete file appear; otherwise no file is left.
#[derive(Debug)]
pub struct RecordingWriter {
    path: PathBuf,
    /// `None` once it is finished.
    draft: Option<Draft>,
    chunk: Recording,
    extras: Vec<Extra>,
    /// `None` once it is finished.
    writer: Option<SerializedFileWriter<BufWriter<File>>>,
    last: Option<(u32, u32)>,
    rows: usize,
}

impl Recording {
    /// Writes the recording, atomically replacing an existing file.
    ///
    /// # Errors
    /// If the recording is not valid, cannot be encoded or cannot be written.
    pub fn save(&self, path: impl AsRef<Path>) -> Result<(), DatasetError> {
        self.validate()?;
        let names: Vec<_> = self.columns().iter().map(|column| column.0).collect();
        let extras: Vec<_> = Extra::ALL.into_iter().filter(|extra| names.contains(&extra.name())).collect();
        RecordingWriter::create(path.as_ref(), self.provenance.clone(), &extras)?.finish_with(self)
    }
}

impl RecordingWriter {
    /// Starts a recording with these optional columns.
    ///
    /// # Errors
    /// The file cannot be written.
    pub fn create(path: &Path, provenance: Provenance, extras: &[Extra]) -> Result<Self, DatasetError> {
        let write = |source| DatasetError::Write { path: path.to_owned(), source };
        let draft = Draft::of(path).map_err(write)?;
        let chunk = Recording::with_extras(provenance, extras);
        let file = BufWriter::new(File::create(draft.path()).map_err(write)?);
        let writer = writer(file, &chunk).map_err(|e| encode(path, &e))?;
        Ok(Self {
            path: path.to_owned(),
            draft: Some(draft),
            chunk,
            extras: extras.to_vec(),
            writer: Some(writer),
            last: None,
            rows: 0,
        })
    }

    /// The origin of the rows, which may be completed until the end.
    pub fn provenance(&mut self) -> &mut Provenance {
        &mut self.chunk.provenance
    }

    /// Adds one tick.
    ///
    /// # Errors
    /// A rule of [`Recording::validate`] is violated (rows are checked in chunks), or the file cannot be written.
    pub fn push(&mut self, row: Row) -> Result<(), DatasetError> {
        self.chunk.push(row);
        if self.chunk.len() >= GROUP_ROWS { self.flush() } else { Ok(()) }
    }

    fn flush(&mut self) -> Result<(), DatasetError> {
        let (Some(first), Some(last)) = (self.chunk.key(0), self.chunk.len().checked_sub(1)) else {
            return Ok(());
        };
        // Groups are complete only at the end.
        self.chunk.validate_rows().map_err(|source| self.invalid(source))?;
        if self.last.is_some_and(|last| first <= last) {
            return Err(self.invalid(DatasetError::Order(self.rows)));
        }
        self.last = self.chunk.key(last);
        self.rows += self.chunk.len();
        if let Some(writer) = &mut self.writer {
            write_rows(writer, &self.chunk).map_err(|e| encode(&self.path, &e))?;
        }
        let provenance = self.chunk.provenance.clone();
        self.chunk = Recording::with_extras(provenance, &self.extras);
        Ok(())
    }

    /// Writes a valid recording and finishes the file.
    pub(super) fn finish_with(mut self, recording: &Recording) -> Result<(), DatasetError> {
        if let Some(writer) = &mut self.writer {
            write_rows(writer, recording).map_err(|e| encode(&self.path, &e))?;
        }
        self.finish()
    }

    fn invalid(&self, source: DatasetError) -> DatasetError {
        DatasetError::Invalid { path: self.path.clone(), source: Box::new(source) }
    }

    /// Writes the remaining rows, the provenance and the checksum, and atomically replaces an existing file.
    ///
    /// # Errors
    /// See [`Self::push`].
    pub fn finish(mut self) -> Result<(), DatasetError> {
        self.flush()?;
        let write = |source| DatasetError::Write { path: self.path.clone(), source };
        let provenance = serde_json::to_string(&self.chunk.provenance).map_err(|e| encode(&self.path, &e))?;
        let (Some(mut writer), Some(draft)) = (self.writer.take(), self.draft.take()) else { return Ok(()) };
        for pair in metadata(provenance) {
            writer.append_key_value_metadata(pair);
        }
        let file = writer.into_inner().map_err(|e| encode(&self.path, &e))?;
        let file = file.into_inner().map_err(|e| write(e.into_error()))?;
        file.sync_all().map_err(write)?;
        drop(file);
        checksum::seal(draft.path()).map_err(write)?;
        draft.complete().map_err(write)
    }
}

fn encode(path: &Path, reason: &dyn std::fmt::Display) -> DatasetError {
    DatasetError::Encode { path: path.to_owned(), detail: reason.to_string() }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::fs;

    const EXTRAS: [Extra; 2] = [Extra::Resistance, Extra::Group];

    fn rows(count: u32) -> impl Iterator<Item = Row> {
        (0..count).map(|n| Row {
            breath: n / 100,
            tick: n % 100,
            pressure: (n % 977) as f32 * 0.07,
            resistance: Some(20.0),
            group: Some(n % 2),
            ..Row::default()
        })
    }

    fn provenance() -> Provenance {
        Provenance { groups: vec!["a".into(), "b".into()], ..Provenance::new(10_000, "test") }
    }

    fn written(path: &Path, count: u32) -> Result<(), DatasetError> {
        let mut writer = RecordingWriter::create(path, Provenance::new(10_000, "test"), &EXTRAS)?;
        rows(count).try_for_each(|row| writer.push(row))?;
        writer.provenance().groups = provenance().groups;
        writer.finish()
    }

    #[test]
    fn a_recording_written_row_by_row_is_the_one_written_at_once() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("new/streamed.parquet");
        // More than one chunk, and not a multiple of it.
        written(&path, GROUP_ROWS as u32 + 1_234).unwrap();
        let mut whole = Recording::with_extras(provenance(), &EXTRAS);
        rows(GROUP_ROWS as u32 + 1_234).for_each(|row| whole.push(row));
        assert_eq!(Recording::load(&path).unwrap(), whole);
        written(&path, 0).unwrap();
        assert!(Recording::load(&path).unwrap().is_empty());
        assert_eq!(fs::read_dir(path.parent().unwrap()).unwrap().count(), 1, "no temporary file");
    }

    #[test]
    fn a_flipped_bit_in_a_streamed_file_is_found() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("streamed.parquet");
        written(&path, 500).unwrap();
        let good = fs::read(&path).unwrap();
        for place in (0..good.len()).step_by(97) {
            let mut bad = good.clone();
            bad[place] ^= 4;
            fs::write(&path, bad).unwrap();
            assert!(Recording::load(&path).is_err(), "byte {place}");
        }
    }

    #[test]
    fn a_writer_that_is_given_up_leaves_the_old_file_alone() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("streamed.parquet");
        written(&path, 10).unwrap();
        let mut writer = RecordingWriter::create(&path, provenance(), &EXTRAS).unwrap();
        writer.push(rows(1).next().unwrap()).unwrap();
        drop(writer);
        assert_eq!(Recording::load(&path).unwrap().len(), 10);
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1);
    }

    #[test]
    fn rows_out_of_order_and_numbers_that_are_none_are_refused_across_bundles() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("streamed.parquet");
        let mut writer = RecordingWriter::create(&path, provenance(), &EXTRAS).unwrap();
        rows(GROUP_ROWS as u32).for_each(|row| writer.push(row).unwrap());
        writer.push(rows(1).next().unwrap()).unwrap();
        assert!(writer.finish().unwrap_err().to_string().contains("out of order"));
        let mut writer = RecordingWriter::create(&path, provenance(), &EXTRAS).unwrap();
        writer
            .push(Row { pressure: f32::NAN, resistance: Some(1.0), group: Some(0), ..Row::default() })
            .unwrap();
        assert!(writer.finish().unwrap_err().to_string().contains("pressure"));
        assert!(!path.exists());
    }
}
