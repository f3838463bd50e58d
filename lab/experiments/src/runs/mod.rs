//! Runs that left a record in a folder: finding, choosing, comparing and plotting them.

mod compare;
mod plots;
#[cfg(test)]
mod tests;

use std::cmp::Ordering;
use std::path::{Path, PathBuf, is_separator};

use campaign::record::{MADE_BY, Record};
use thiserror::Error;
use walkdir::WalkDir;

use show::report::ReportError;

pub use compare::{Comparison, FigureDifference, OptionDifference};
pub use plots::plots;

/// End of the name of a task's record.
const TASK: &str = ".task.json";
/// Most names that an error lists.
const NAMED: usize = 12;

/// Why runs cannot be listed, compared or plotted.
#[derive(Debug, Error)]
#[expect(missing_docs, reason = "the messages name every field")]
pub enum RunsError {
    /// The folder cannot be read.
    #[error("cannot read {}: {source}", path.display())]
    Folder { path: PathBuf, source: std::io::Error },
    /// The folder has no record.
    #[error("{} contains no runs: commands with --out leave a {MADE_BY} in their folder", .0.display())]
    None(PathBuf),
    /// No run of that name.
    #[error("there is no run {name}: choose among {known}")]
    NoRun { name: String, known: String },
    /// Several runs of that name.
    #[error("{name} is the end of several runs' names: choose among {known}")]
    Several { name: String, known: String },
    /// No run has that figure.
    #[error("no run has a figure or a curve {name}: choose among {known}")]
    NoFigure { name: String, known: String },
    /// Nothing to plot.
    #[error("no run has a training curve: name a figure to plot with --figure, such as {known}")]
    NothingToPlot { known: String },
    /// No run with the figure has a number there.
    #[error(
        "no run with the figure {figure} has a number for --x {x}: choose an option that is a number, such as seed"
    )]
    NoNumber { figure: String, x: String },
    /// A plot cannot be drawn.
    #[error(transparent)]
    Report(#[from] ReportError),
}

/// A run, from its record.
#[derive(Clone, Debug, PartialEq)]
pub struct Run {
    /// Its folder or its JSON without the ending, relative to the folder that was searched.
    pub name: String,
    /// The file with the record.
    pub file: PathBuf,
    /// The record.
    pub record: Record,
}

/// What a folder contains.
#[derive(Clone, Debug, Default)]
pub struct Found {
    /// Runs in the order of their beginning.
    pub runs: Vec<Run>,
    /// Records that cannot be read, each with the reason.
    pub damaged: Vec<String>,
}

/// Finds all runs in a folder and those below it; with `tasks` also the tasks with shards.
///
/// # Errors
/// A folder that cannot be read, or contains no record.
pub fn find(folder: &Path, tasks: bool) -> Result<Found, RunsError> {
    let mut found = Found::default();
    for entry in WalkDir::new(folder).sort_by_file_name() {
        let entry = entry.map_err(|error| RunsError::Folder {
            path: error.path().unwrap_or(folder).to_owned(),
            source: error.into_io_error().unwrap_or_else(|| std::io::Error::other("links in a circle")),
        })?;
        let file = entry.path();
        let Some(name) = name(folder, file, tasks).filter(|_| entry.file_type().is_file()) else { continue };
        match Record::load(file) {
            Ok(Some(record)) => found.runs.push(Run { name, file: file.to_owned(), record }),
            // It has been removed in the meantime.
            Ok(None) => {}
            Err(error) => found.damaged.push(format!("cannot read {}: {error}", file.display())),
        }
    }
    found.runs.sort_by_key(|run| run.record.began_s);
    if found.runs.is_empty() && found.damaged.is_empty() {
        return Err(RunsError::None(folder.to_owned()));
    }
    Ok(found)
}

/// Name of the run whose record a file is; none for other files.
fn name(folder: &Path, file: &Path, tasks: bool) -> Option<String> {
    let file = file.strip_prefix(folder).ok()?.to_str()?;
    let task = || file.strip_suffix(TASK).filter(|_| tasks);
    let name = file.strip_suffix(MADE_BY).or_else(task)?;
    match name.chars().last() {
        None => Some(".".to_owned()),
        // `a/made-by.json` or `a.made-by.json`.
        Some(last) if last == '.' || is_separator(last) => Some(name[..name.len() - 1].to_owned()),
        Some(_) => file.ends_with(TASK).then(|| name.to_owned()),
    }
}

impl Run {
    /// Name of the command.
    pub fn command(&self) -> &str {
        self.record.command.first().map_or("", String::as_str)
    }

    /// Value of an option.
    pub fn option(&self, name: &str) -> Option<&str> {
        self.record.options.get(name).map(String::as_str)
    }

    /// A figure, or the last value of a curve.
    pub fn figure(&self, name: &str) -> Option<f64> {
        let results = &self.record.results;
        let last = || results.curves.get(name)?.values.last().copied();
        results.figures.get(name).copied().or_else(last)
    }

    /// The number that is the value of an option, or a figure.
    fn number(&self, name: &str) -> Option<f64> {
        let option = self.option(name).and_then(|text| text.parse().ok());
        option.or_else(|| self.figure(name)).filter(|number| number.is_finite())
    }

    /// Where it ran: the machine, and the engine with its task if there is one.
    pub fn place(&self) -> String {
        let Record { host, engine, task, .. } = &self.record;
        match (engine, task) {
            (Some(engine), Some(task)) => format!("{host}, {engine} {task}"),
            (Some(engine), None) => format!("{host}, {engine}"),
            (None, _) => host.clone(),
        }
    }

    /// Whether an option has exactly this value (`seed=3`), or the text is part of name, command line, revision or place.
    pub fn matches(&self, text: &str) -> bool {
        let option = text.split_once('=').and_then(|(name, value)| Some(self.option(name)? == value));
        let texts =
            || [self.name.clone(), self.record.command.join(" "), self.record.revision.clone(), self.place()];
        option.unwrap_or_else(|| texts().iter().any(|part| part.contains(text)))
    }
}

/// Sorts runs by a figure or an option, numbers before texts; runs without it are last, in their order.
pub fn sort(runs: &mut [Run], by: &str) {
    runs.sort_by(|one, other| match (one.number(by), other.number(by)) {
        (Some(one), Some(other)) => one.total_cmp(&other),
        (Some(_), None) => Ordering::Less,
        (None, Some(_)) => Ordering::Greater,
        (None, None) => match (one.option(by), other.option(by)) {
            (Some(one), Some(other)) => one.cmp(other),
            (one, other) => other.is_some().cmp(&one.is_some()),
        },
    });
}

/// The run of that name, of the only name that ends so, or of that path; `folder` is the one that was searched.
///
/// # Errors
/// No such run, or several.
pub fn named<'a>(runs: &'a [Run], folder: &Path, name: &str) -> Result<&'a Run, RunsError> {
    let trimmed = name.trim_end_matches('/');
    let inside = Path::new(trimmed).strip_prefix(folder).ok().and_then(Path::to_str);
    let exact = |wanted: &str| runs.iter().find(|run| run.name == wanted);
    if let Some(run) = exact(trimmed).or_else(|| inside.and_then(exact)) {
        return Ok(run);
    }
    let ending: Vec<&Run> = runs.iter().filter(|run| Path::new(&run.name).ends_with(trimmed)).collect();
    match ending[..] {
        [run] => Ok(run),
        [] => Err(RunsError::NoRun {
            name: name.to_owned(),
            known: listed(runs.iter().map(|run| run.name.as_str())),
        }),
        _ => Err(RunsError::Several {
            name: name.to_owned(),
            known: listed(ending.iter().map(|run| run.name.as_str())),
        }),
    }
}

/// Names of all figures and curves of some runs, each once, in order.
pub fn figure_names(runs: &[Run]) -> Vec<&str> {
    let figures = runs.iter().flat_map(|run| run.record.results.figures.keys());
    let curves = runs.iter().flat_map(|run| run.record.results.curves.keys());
    let names: std::collections::BTreeSet<&str> = figures.chain(curves).map(String::as_str).collect();
    names.into_iter().collect()
}

/// Refuses a figure that no run has.
///
/// # Errors
/// The figure, with some that exist.
pub fn check_figure(runs: &[Run], name: &str) -> Result<(), RunsError> {
    let names = figure_names(runs);
    if names.contains(&name) || names.iter().any(|known| plots::is_of(known, name)) {
        return Ok(());
    }
    Err(RunsError::NoFigure { name: name.to_owned(), known: listed(names.into_iter()) })
}

/// The first of some names.
pub fn listed<'a>(names: impl ExactSizeIterator<Item = &'a str>) -> String {
    let rest = names.len().saturating_sub(NAMED);
    let text = names.take(NAMED).collect::<Vec<_>>().join(", ");
    if rest == 0 { text } else { format!("{text} and {rest} more") }
}
