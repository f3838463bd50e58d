//! First pass through the rows of files whose breaths are not numbered: what shows them.

use std::path::{Path, PathBuf};

use super::inspirations::{By, Marks};
use super::map::{EndBy, Quantity, StartBy, TableLayout};
use super::rises::{Rises, Shown};
use super::rows::{Between, NO_ROWS, RowSource, TableRow};
use crate::recording::DatasetError;

/// Rows from which flows and pressures are judged: the first ones, so that memory is bounded.
const JUDGED: usize = 200_000;
/// Share of the range of pressures, from its low end, in which the patient exhales.
const LOW: f64 = 0.2;
/// Share of the readings below the low end of a range, and above its high end.
const ENDS: f64 = 0.05;
/// Share of the flows in expirations below that of a leak: the others belong to the start of an inspiration.
const LEAK: f64 = 0.75;
/// Flow of which breaths cannot be told, L/s.
const LEAST_FLOW: f64 = 0.02;

/// The layout with what shows the breaths in all files and, of each file, how.
pub(super) fn with_breaths<R: RowSource>(
    paths: &[PathBuf],
    layout: &TableLayout,
    period_s: f64,
    open: impl Fn(usize, &Path) -> Result<R, DatasetError>,
) -> Result<(TableLayout, Vec<Marks>), DatasetError> {
    let mut layout = layout.clone();
    if layout.start == StartBy::Number && layout.end != EndBy::Found {
        return Ok((layout, vec![Marks::Own; paths.len()]));
    }
    let of = |(n, path): (usize, &PathBuf)| survey(path, open(n, path)?, period_s);
    let surveys: Vec<Survey> = paths.iter().enumerate().map(of).collect::<Result<_, _>>()?;
    let target = surveys.iter().all(|survey| !survey.by_target.is_empty());
    let valve = surveys.iter().all(|survey| !survey.by_valve.is_empty());
    layout.start = match layout.start {
        StartBy::Number => StartBy::Number,
        _ if target => StartBy::Target,
        _ if valve => StartBy::Valve,
        _ => StartBy::Found,
    };
    layout.end = match layout.end {
        EndBy::Time(seconds) => EndBy::Time(seconds),
        _ if valve => EndBy::Valve,
        _ if target => EndBy::Target,
        _ => EndBy::Found,
    };
    let marks = |survey: Survey| match (layout.start, layout.end) {
        (StartBy::Target, _) => Marks::Starts(survey.by_target),
        (StartBy::Valve, _) => Marks::Starts(survey.by_valve),
        (StartBy::Number, end) if end != EndBy::Found => Marks::Own,
        (StartBy::Number, _) => Marks::Phases(survey.by),
        (StartBy::Found, _) => Marks::Breaths(survey.by),
    };
    let marks = surveys.into_iter().map(marks).collect();
    Ok((layout, marks))
}

/// What shows the breaths of a file.
#[derive(Debug, Clone, PartialEq)]
struct Survey {
    /// The rows at which the set-point starts breaths.
    by_target: Vec<usize>,
    /// Those at which the expiratory valve does.
    by_valve: Vec<usize>,
    /// What else shows them.
    by: By,
}

/// Reads all rows of a file.
///
/// # Errors
/// Those of its rows, or there are none.
fn survey(path: &Path, mut rows: impl RowSource, period_s: f64) -> Result<Survey, DatasetError> {
    let mut rises = Rises::new(period_s);
    let (mut by_target, mut by_valve, mut last) = (Vec::new(), Vec::new(), None::<TableRow>);
    let (mut pressures, mut flows) = (Vec::new(), Vec::new());
    let mut groups = Vec::new();
    let mut number = 0;
    while let Some(row) = rows.next(&mut groups)? {
        let before = last.replace(row).filter(|last| last.group == row.group);
        if before.is_none_or(|before| Between::of(&before, &row, period_s) == Between::Gap) {
            rises.reset();
        }
        match rises.next(row.get(Quantity::Target) as f32) {
            Shown::Nothing => {}
            Shown::Start => by_target.push(number),
            Shown::StartAfterStep => {
                by_target.pop();
                by_target.push(number);
            }
        }
        if before.is_some_and(|before| before.opens_out()) && !row.opens_out() {
            by_valve.push(number);
        }
        if pressures.len() < JUDGED {
            pressures.push(row.get(Quantity::Pressure));
            flows.push(row.flow());
        }
        number += 1;
    }
    if last.is_none() {
        return Err(DatasetError::NoTable { path: path.to_owned(), reason: NO_ROWS });
    }
    Ok(Survey { by_target, by_valve, by: shown_by(&pressures, &flows) })
}

/// Whether flow or pressure shows the breaths, and from which values on.
fn shown_by(pressures: &[f64], flows: &[f64]) -> By {
    let [low, high] = [ENDS, 1.0 - ENDS].map(|share| quantile(pressures.to_vec(), share));
    let exhales = low + LOW * (high - low);
    let of_expirations = flows.iter().zip(pressures).filter(|(_, pressure)| **pressure <= exhales);
    let leak = quantile(of_expirations.map(|(flow, _)| *flow).collect(), LEAK).max(0.0);
    let flow = quantile(flows.to_vec(), 1.0 - ENDS);
    if flow - leak > LEAST_FLOW { By::Flow { leak, high: flow } } else { By::Pressure { low } }
}

/// The value below which this share of the values lies; 0 of none.
fn quantile(mut values: Vec<f64>, share: f64) -> f64 {
    if values.is_empty() {
        return 0.0;
    }
    let place = (share * (values.len() - 1) as f64) as usize;
    *values.select_nth_unstable_by(place, f64::total_cmp).1
}
