//! Imports third-party recordings: a stream of rows in, a recording in Parquet out, in bounded memory.
//!
//! A file's [`mod@format`] makes rows of it; a [`map::ColumnMap`] gives the quantity and unit of each column of a table. The rows are put in
//! order, a survey finds what shows the breaths, and an assembler puts each breath on an even grid. Every row that is left out is counted
//! in the [`account::ImportSummary`].

pub mod account;
mod breaths;
pub mod format;
mod inputs;
mod inspirations;
mod lines;
mod makair;
pub mod map;
mod measured;
mod pb840;
mod pirds;
mod propose;
mod rises;
mod rows;
mod saturation;
mod servo_u;
mod survey;
mod table;
#[cfg(test)]
mod tests;
mod tidy;

use std::path::{Path, PathBuf};

use progress::{Progress, Stage, Task};
use serde_json::json;

use self::account::ImportSummary;
use self::breaths::Assembler;
use self::format::Format;
use self::inputs::Inputs;
use self::inspirations::Phased;
use self::makair::MakairRows;
pub use self::makair::{Telemetry as MakairTelemetry, telemetry as makair_telemetry};
use self::map::{Quantity, StartBy, TableLayout};
pub use self::measured::{files as recorded_files, measured, measured_recording};
use self::pb840::Pb840Rows;
pub(crate) use self::pirds::import_pirds;
pub use self::propose::propose;
use self::rows::{NO_ROWS, RowSource};
use self::servo_u::ServoURows;
use self::survey::with_breaths;
use self::table::TableReader;
use self::tidy::Tidy;
use crate::files::check_room;
use crate::provenance::Provenance;
use crate::recording::{DatasetError, Extra, RecordingWriter};

/// Importing tables: bytes.
pub const IMPORT: Stage = Stage("read tables, bytes");

/// Note of a recording whose tables have no set-point: its targets cannot tell how well they were met.
pub const NO_SET_POINT: &str = "no set-point in the tables: target and PIP are the measured plateau, PEEP the pressure before the breath";
/// Whether the tables of a recording had a set-point.
pub fn had_set_point(provenance: &Provenance) -> bool {
    // What follows has had other words.
    let start = |note: &str| note.split(':').next().map(str::to_owned);
    !provenance.notes.iter().any(|note| start(note) == start(NO_SET_POINT))
}

/// A recording is not larger than this part of its tables.
const BYTES_READ_PER_WRITTEN: u64 = 2;
/// Number of rows whose time steps determine the sample period.
const PERIOD_ROWS: usize = 20_000;
/// Number of rows between two progress reports.
const PROGRESS_ROWS: usize = 1 << 16;

/// Optional columns of a recording, and the quantities that fill them.
const EXTRAS: [(Extra, Quantity); 5] = [
    (Extra::FlowIn, Quantity::FlowIn),
    (Extra::FlowOut, Quantity::FlowOut),
    (Extra::Resistance, Quantity::Resistance),
    (Extra::Compliance, Quantity::Compliance),
    (Extra::UPsol, Quantity::UPsol),
];
/// Largest difference of a table's sample period from the first table's, as a share of it.
const SAME_PERIOD: f64 = 0.05;

/// Converts files of a format, in the given order, into one recording.
///
/// # Errors
/// See [`import`].
pub fn import_as(
    format: &Format,
    paths: &[PathBuf],
    out: &Path,
    progress: &Progress<'_>,
) -> Result<ImportSummary, DatasetError> {
    match format {
        Format::Table(layout) => import(paths, layout, out, progress),
        Format::Pirds => import_pirds(paths, out, progress),
        Format::Makair => {
            let surveys = makair::survey(paths)?;
            let layout = makair::layout(&surveys);
            import_format(paths, &layout, out, progress, |n, path| MakairRows::open(path, &surveys[n]))
        }
        Format::Pb840 => {
            let layout = pb840::layout();
            import_format(paths, &layout, out, progress, |_, path| Pb840Rows::open(path))
        }
        Format::ServoU => {
            let layout = servo_u::layout();
            import_format(paths, &layout, out, progress, |_, path| ServoURows::open(path))
        }
    }
}

/// Converts tables, in the given order, into one recording.
///
/// # Errors
/// A table that cannot be read, lacks a column or has a cell that is not a number (with line and column), no
/// breath at all, a recording that cannot be written, or a request to stop. The recording is written
/// atomically.
pub fn import(
    paths: &[PathBuf],
    layout: &TableLayout,
    out: &Path,
    progress: &Progress<'_>,
) -> Result<ImportSummary, DatasetError> {
    let period_s = layout.period_s.unwrap_or_default();
    import_format(paths, layout, out, progress, |_, path| TableReader::open(path, layout, period_s))
}

/// Converts files that `open` opens by their number and path.
fn import_format<R: RowSource>(
    paths: &[PathBuf],
    layout: &TableLayout,
    out: &Path,
    progress: &Progress<'_>,
    open: impl Fn(usize, &Path) -> Result<R, DatasetError>,
) -> Result<ImportSummary, DatasetError> {
    let inputs = Inputs::new(paths);
    let period_us = match layout.period_s {
        Some(seconds) => (seconds * 1e6).round() as u32,
        None => common_period_us(paths, &open)?,
    };
    import_rows(&inputs, layout, period_us, out, progress, open)
}

/// Converts the rows of files, each of which `open` opens by its number and path.
fn import_rows<R: RowSource>(
    inputs: &Inputs<'_>,
    layout: &TableLayout,
    period_us: u32,
    out: &Path,
    progress: &Progress<'_>,
    open: impl Fn(usize, &Path) -> Result<R, DatasetError>,
) -> Result<ImportSummary, DatasetError> {
    let period_s = f64::from(period_us) * 1e-6;
    let in_order = |n: usize, path: &Path| {
        let ordered = layout.is_ordered();
        Ok(Tidy::new(open(n, path)?, path, period_s, ordered, layout.has_volumes()))
    };
    let (layout, marks) = with_breaths(inputs.paths, layout, period_s, in_order)?;
    let layout = &layout;
    let write = |source| DatasetError::Write { path: out.to_owned(), source };
    check_room(out, inputs.bytes() / BYTES_READ_PER_WRITTEN).map_err(write)?;
    let provenance = provenance(inputs.paths, layout, period_us);
    let writer = RecordingWriter::create(out, provenance, &extras(layout))?;
    let mut assembler = Assembler::new(layout, period_s, writer);
    let mut groups = Vec::new();
    let mut bytes = 0;
    let task = progress.task(IMPORT, inputs.bytes() as usize);
    for ((n, path), marks) in inputs.paths.iter().enumerate().zip(marks) {
        let mut reader = Phased::new(in_order(n, path)?, marks);
        // A line that is being written is not wrong, but not complete.
        let or_changed = |error| inputs.check().err().unwrap_or(error);
        while let Some(sample) = reader.next(&mut groups).map_err(or_changed)? {
            assembler.push(sample)?;
            if assembler.account.counts.rows.is_multiple_of(PROGRESS_ROWS) {
                task.reach((bytes + reader.position()) as usize);
                goes_on(&task)?;
            }
        }
        assembler.end_of_stretch()?;
        assembler.account.end_of_table(reader.unused(), reader.disorder());
        bytes += reader.position();
        goes_on(&task)?;
    }
    inputs.check()?;
    let Assembler { account, mut writer, .. } = assembler;
    let summary = account.finish(period_us, groups.len(), breaths_from(layout));
    if summary.breaths == 0 {
        let rows = summary.rows;
        return Err(DatasetError::NoBreath { rows, seconds: rows as f64 * f64::from(period_us) * 1e-6 });
    }
    writer.provenance().groups = groups;
    writer.provenance().notes.push(summary.note());
    writer.finish()?;
    Ok(summary)
}

/// What shows the breaths, in words.
fn breaths_from(layout: &TableLayout) -> &'static str {
    match layout.start {
        StartBy::Number => "the breath column",
        StartBy::Target => "the set-point",
        StartBy::Valve => "the expiratory valve",
        StartBy::Found if layout.has(Quantity::FlowIn) => "the flow",
        StartBy::Found => "the pressure",
    }
}

/// Fails if the user asked to stop. A dropped writer leaves no file behind.
fn goes_on(task: &Task<'_>) -> Result<(), DatasetError> {
    if task.stopped() { Err(DatasetError::Stopped) } else { Ok(()) }
}

/// The optional columns that a layout fills.
fn extras(layout: &TableLayout) -> Vec<Extra> {
    let filled = EXTRAS.iter().filter(|(_, quantity)| layout.has(*quantity));
    filled.map(|(extra, _)| *extra).chain([Extra::Group]).collect()
}

fn provenance(paths: &[PathBuf], layout: &TableLayout, period_us: u32) -> Provenance {
    let files: Vec<_> =
        paths.iter().filter_map(|path| path.file_name()).map(|name| name.to_string_lossy()).collect();
    let measured = !layout.has(Quantity::Target);
    Provenance {
        plant: layout.plant.clone(),
        settings: json!({ "files": files, "columns": format!("{:?}", layout.origins) }),
        notes: layout.note.clone().into_iter().chain(measured.then(|| NO_SET_POINT.to_owned())).collect(),
        ..Provenance::new(period_us, "import of tables")
    }
}

/// The sample period of the first file, which the others must share.
fn common_period_us<R: RowSource>(
    paths: &[PathBuf],
    open: impl Fn(usize, &Path) -> Result<R, DatasetError>,
) -> Result<u32, DatasetError> {
    let of = |(n, path): (usize, &PathBuf)| period_us(path, open(n, path)?);
    let periods = paths.iter().enumerate().map(of).collect::<Result<Vec<_>, _>>()?;
    same_period(paths, &periods)
}

/// The first of the files' sample periods, which the others must share.
fn same_period(paths: &[PathBuf], periods_us: &[u32]) -> Result<u32, DatasetError> {
    let expected_us = *periods_us.first().ok_or(DatasetError::NoTables)?;
    let other =
        |found_us: u32| f64::from(found_us.abs_diff(expected_us)) > SAME_PERIOD * f64::from(expected_us);
    match paths.iter().zip(periods_us).find(|(_, found_us)| other(**found_us)) {
        Some((path, &found_us)) => Err(DatasetError::Period { path: path.clone(), found_us, expected_us }),
        None => Ok(expected_us),
    }
}

/// Median time step of the first rows of a file.
fn period_us(path: &Path, mut reader: impl RowSource) -> Result<u32, DatasetError> {
    let (mut steps, mut last) = (Vec::new(), None);
    while steps.len() < PERIOD_ROWS {
        let Some(sample) = reader.next(&mut Vec::new())? else { break };
        let time = sample.get(Quantity::Time);
        if let Some(last) = last.replace(time)
            && !sample.next_breath
            && time > last
        {
            steps.push(time - last);
        }
    }
    if last.is_none() {
        return Err(DatasetError::NoTable { path: path.to_owned(), reason: NO_ROWS });
    }
    steps.sort_by(f64::total_cmp);
    let median = steps.get(steps.len() / 2).map_or(0, |step| (step * 1e6).round() as u32);
    if median == 0 { Err(DatasetError::NoPeriod(path.to_owned())) } else { Ok(median) }
}
