//! Import of tables in any layout: a stream of rows in, a recording in Parquet out, in bounded memory.
//!
//! A [`map::ColumnMap`] says which column is what, in which unit. Time may be uneven: breaths are put on an even grid.
//! No row disappears without being counted in the [`account::Summary`].

pub mod account;
mod breaths;
pub mod map;
pub mod reader;
#[cfg(test)]
mod tests;

use std::fs;
use std::path::{Path, PathBuf};

use progress::{Progress, Stage};
use serde_json::json;

use self::account::{Account, Summary};
use self::breaths::Assembler;
use self::map::{Layout, Quantity};
use self::reader::Reader;
use crate::provenance::Provenance;
use crate::recording::{DatasetError, Extra, RecordingWriter, Row};

/// Rows from whose time steps the sample period is taken.
const PERIOD_ROWS: usize = 20_000;
/// Rows between two reports of progress.
const PROGRESS_ROWS: usize = 1 << 16;

/// Optional columns of a recording, and the quantities that they come from.
const EXTRAS: [(Extra, Quantity); 4] = [
    (Extra::FlowIn, Quantity::FlowIn),
    (Extra::FlowOut, Quantity::FlowOut),
    (Extra::Resistance, Quantity::Resistance),
    (Extra::Compliance, Quantity::Compliance),
];

/// Makes one recording of tables, in the order given; it cannot be stopped.
///
/// # Errors
/// A table that cannot be read, lacks a column or has a cell that is no number (with line and column), no breath at
/// all, or a recording that cannot be written.
pub fn import(
    paths: &[PathBuf],
    layout: &Layout,
    out: &Path,
    progress: &Progress<'_>,
) -> Result<Summary, DatasetError> {
    let period_us = match (layout.period_s, paths.first()) {
        (Some(seconds), _) => (seconds * 1e6).round() as u32,
        (None, Some(path)) => period_us(path, layout)?,
        (None, None) => return Err(DatasetError::NoBreath { tables: 0 }),
    };
    let mut extras: Vec<_> = EXTRAS
        .iter()
        .filter(|(_, quantity)| layout.origins[*quantity as usize].is_some())
        .map(|pair| pair.0)
        .collect();
    extras.push(Extra::Group);
    let mut writer = RecordingWriter::create(out, provenance(paths, layout, period_us), &extras)?;
    let mut assembler = Assembler::new(layout, f64::from(period_us) * 1e-6);
    let mut account = Account::new();
    let mut groups = Vec::new();
    let mut bytes = 0;
    let length = |path: &PathBuf| fs::metadata(path).map_or(0, |metadata| metadata.len() as usize);
    let task = progress.task(Stage::Import, paths.iter().map(length).sum());
    for path in paths {
        let mut reader = Reader::open(path, layout)?;
        let mut sink = |rows: &[Row]| rows.iter().try_for_each(|row| writer.push(*row));
        while let Some(sample) = reader.next(&mut groups)? {
            assembler.push(sample, &mut account, &mut sink)?;
            if account.rows.is_multiple_of(PROGRESS_ROWS) {
                task.reach((bytes + reader.position()) as usize);
            }
        }
        assembler.end_of_stretch(&mut account, &mut sink)?;
        bytes += reader.position();
    }
    let summary = account.finish(period_us);
    if summary.breaths == 0 {
        return Err(DatasetError::NoBreath { tables: paths.len() });
    }
    writer.provenance().groups = groups;
    writer.provenance().notes.push(format!(
        "{} rows read, {} dropped, {} gaps, {} breaths put on an even grid, {:.1} % of inspiratory rows with the valve \
         at an end",
        summary.rows,
        summary.dropped_before_first_breath + summary.dropped_after_gap,
        summary.gaps,
        summary.resampled_breaths,
        100.0 * summary.saturated
    ));
    writer.finish()?;
    Ok(summary)
}

fn provenance(paths: &[PathBuf], layout: &Layout, period_us: u32) -> Provenance {
    let files: Vec<_> =
        paths.iter().filter_map(|path| path.file_name()).map(|name| name.to_string_lossy()).collect();
    let measured = layout.origins[Quantity::Target as usize].is_none();
    let note = "no set-point in the tables: target and PIP are the measured plateau, PEEP the first pressure";
    Provenance {
        plant: layout.plant.clone(),
        settings: json!({ "files": files, "columns": format!("{:?}", layout.origins) }),
        notes: measured.then(|| note.to_owned()).into_iter().collect(),
        ..Provenance::new(period_us, "import of foreign tables")
    }
}

/// Median time step of the first rows of a table.
fn period_us(path: &Path, layout: &Layout) -> Result<u32, DatasetError> {
    let mut reader = Reader::open(path, layout)?;
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
    steps.sort_by(f64::total_cmp);
    let median = steps.get(steps.len() / 2).map_or(0, |step| (step * 1e6).round() as u32);
    if median == 0 { Err(DatasetError::NoPeriod { path: path.to_owned() }) } else { Ok(median) }
}
