//! Exports of runs into the files of viewers, one file format per module. Exporting twice gives the same files.

mod mlflow;
mod tensorboard;

use std::path::Path;

use crc::{Algorithm, CRC_64_ECMA_182, CRC_64_XZ, Crc};

use super::{Run, RunsError};
use data::files::write_atomically;

pub use mlflow::export as mlflow;
pub use tensorboard::export as tensorboard;

/// The checksums that make up an id.
static SUMS: [Algorithm<u64>; 2] = [CRC_64_XZ, CRC_64_ECMA_182];

/// Id of a run: 32 digits that follow from the path of its record and its beginning.
fn id(run: &Run) -> String {
    let path = run.file.canonicalize().unwrap_or_else(|_| run.file.clone());
    let text = format!("{}\n{}", path.display(), run.record.began_s);
    let sums = SUMS.each_ref().map(|sum| Crc::<u64>::new(sum).checksum(text.as_bytes()));
    format!("{:016x}{:016x}", sums[0], sums[1])
}

/// Name of a run outside its folder: that of the folder itself has none of its own.
fn title(run: &Run) -> String {
    if run.name != "." {
        return run.name.clone();
    }
    let folder = run.file.canonicalize().ok();
    let name = folder.as_deref().and_then(Path::parent).and_then(Path::file_name);
    name.map_or_else(|| run.command().to_owned(), |name| name.to_string_lossy().into_owned())
}

/// Time at which the results were known, seconds since 1970.
fn known_s(run: &Run) -> u64 {
    run.record.ended_s.unwrap_or(run.record.began_s)
}

fn write(path: &Path, bytes: &[u8]) -> Result<(), RunsError> {
    write_atomically(path, bytes).map_err(|source| RunsError::Write { path: path.to_owned(), source })
}
