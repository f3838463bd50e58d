//! Imports PIRDS files ([`crate::pirds`]): a survey finds the sensors and the sample period, a second pass
//! makes rows.

mod rows;
mod survey;
#[cfg(test)]
mod tests;

use std::io::{BufReader, Read};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::AtomicU64;

use progress::Progress;

use self::rows::EventRows;
use self::survey::{Survey, survey};
use super::account::ImportSummary;
use super::inputs::Inputs;
use super::map::{EndBy, Quantity, StartBy, TableLayout};
use super::table::text::Text;
use super::{import_rows, same_period};
use crate::pirds::{EventFault, EventReader};
use crate::recording::DatasetError;

/// Note of a recording from events, which give no valve commands.
const NO_COMMANDS: &str = "no valve commands in PIRDS: u_in is 0, and u_out shows only the phases";
/// Bytes that are read from the file at a time.
const BUFFER: usize = 1 << 18;

/// Converts PIRDS files, in the given order, into one recording; each is a group of its own.
///
/// # Errors
/// A file that cannot be read, a line that is not an event (with its number), no usable pressure sensor, no
/// breath, a recording that cannot be written, or a request to stop. The recording is written atomically.
pub fn import_pirds(
    paths: &[PathBuf],
    out: &Path,
    progress: &Progress<'_>,
) -> Result<ImportSummary, DatasetError> {
    let inputs = Inputs::new(paths);
    let surveys = paths.iter().map(|path| survey(path, progress)).collect::<Result<Vec<_>, _>>()?;
    let periods: Vec<_> = surveys.iter().map(|survey| survey.period_us).collect();
    let period_us = same_period(paths, &periods)?;
    let layout = layout(&surveys);
    let open = |n: usize, path: &Path| EventRows::open(path, &surveys[n]);
    import_rows(&inputs, &layout, period_us, out, progress, open).map_err(|error| match error {
        DatasetError::NoBreath { .. } => {
            unusable(&paths[0], "no breath was found in its pressure or flow: export a longer part")
        }
        error => error,
    })
}

/// What the rows of all files have.
fn layout(surveys: &[Survey]) -> TableLayout {
    let has = |quantity: Quantity| match quantity {
        Quantity::Time | Quantity::Pressure => true,
        Quantity::Target => surveys.iter().all(|survey| survey.phases > 0),
        Quantity::FlowIn | Quantity::FlowOut => surveys.iter().all(|survey| survey.flow.is_some()),
        _ => false,
    };
    let marked = surveys.iter().all(|survey| survey.phases > 0);
    TableLayout {
        start: if marked { StartBy::Number } else { StartBy::Found },
        end: if marked { EndBy::Phase } else { EndBy::Found },
        ..TableLayout::of_format("PIRDS", NO_COMMANDS, has)
    }
}

/// The events of a file.
type Events = EventReader<BufReader<Box<dyn Read + Send>>>;

/// Opens a file; its events, and the number of bytes read so far.
fn open(path: &Path) -> Result<(Events, Arc<AtomicU64>), DatasetError> {
    let Text { reader, bytes } = Text::open(path)?;
    Ok((EventReader::new(BufReader::with_capacity(BUFFER, reader)), bytes))
}

fn faulty(path: &Path, fault: EventFault) -> DatasetError {
    let path = path.to_owned();
    match fault {
        EventFault::Read(source) => DatasetError::Read { path, source },
        EventFault::Line { line, reason } => DatasetError::EventLine { path, line, reason },
    }
}

fn unusable(path: &Path, reason: &'static str) -> DatasetError {
    DatasetError::Events { path: path.to_owned(), reason }
}
