//! The file store of `MLflow`: a folder for each experiment, which is a command, and in it one for each run.
//!
//! | file | content |
//! |---|---|
//! | `<experiment>/meta.yaml` | name and times of the experiment |
//! | `<experiment>/<run>/meta.yaml` | name, user, times and status of the run |
//! | `<experiment>/<run>/params/<name>` | value of an option |
//! | `<experiment>/<run>/metrics/<name>` | for each step a line: time in milliseconds, value, step |
//! | `<experiment>/<run>/tags/<name>` | command line, revision, machine |
//! | `<experiment>/<run>/artifacts/` | the record, and the report if there is one |

use std::fmt::Write;
use std::fs;
use std::path::{Path, PathBuf};

use campaign::record::{MADE_BY, State};
use crc::{CRC_64_XZ, Crc};

use super::{Run, RunsError, id, known_s, title, write};

/// Name of the record among the artifacts: not that of a record, so that a search below the store does not find it.
const RECORD: &str = "record.json";
/// Report of a run, in its folder.
const REPORT: &str = "report.html";
/// Most characters of an option that `MLflow` reads.
const LONGEST_VALUE: usize = 6_000;

/// Writes runs into a file store, which may have other experiments. A run that was exported before is replaced.
///
/// # Errors
/// A file that cannot be written.
pub fn export(runs: &[Run], store: &Path) -> Result<(), RunsError> {
    for run in runs {
        let experiment = experiment_id(run.command());
        let folder = store.join(&experiment);
        let begun = runs.iter().filter(|other| other.command() == run.command());
        let created_s = begun.map(|run| run.record.began_s).min().unwrap_or_default();
        write(
            &folder.join("meta.yaml"),
            experiment_meta(&folder, &experiment, run.command(), created_s).as_bytes(),
        )?;
        export_run(run, &experiment, &folder.join(id(run)))?;
    }
    Ok(())
}

fn export_run(run: &Run, experiment: &str, folder: &Path) -> Result<(), RunsError> {
    let failed = |path: PathBuf| |source| RunsError::Write { path, source };
    if folder.exists() {
        // Figures that the run has no longer must not stay.
        fs::remove_dir_all(folder).map_err(failed(folder.to_owned()))?;
    }
    for part in ["params", "metrics", "tags", "artifacts"] {
        let part = folder.join(part);
        fs::create_dir_all(&part).map_err(failed(part))?;
    }
    for (name, value) in &run.record.options {
        let value: String = value.chars().take(LONGEST_VALUE).collect();
        write(&folder.join("params").join(key(name)), value.as_bytes())?;
    }
    for (name, value) in tags(run) {
        write(&folder.join("tags").join(name), value.as_bytes())?;
    }
    for (name, lines) in metrics(run) {
        write(&folder.join("metrics").join(key(name)), lines.as_bytes())?;
    }
    let report = run.file.with_file_name(REPORT);
    let own = run.file.file_name().is_some_and(|name| name == MADE_BY) && report.exists();
    for (file, name) in [(&run.file, RECORD)].into_iter().chain(own.then_some((&report, REPORT))) {
        let copy = folder.join("artifacts").join(name);
        fs::copy(file, &copy).map_err(failed(copy))?;
    }
    // Last: without it the reader ignores the folder.
    write(&folder.join("meta.yaml"), run_meta(run, experiment, folder).as_bytes())
}

/// Figures and curves, each with the lines of its file.
fn metrics(run: &Run) -> impl Iterator<Item = (&String, String)> {
    let time = 1000 * known_s(run);
    let results = &run.record.results;
    let figures = results.figures.iter().map(move |(name, value)| (name, format!("{time} {value} 0\n")));
    let curves = results.curves.iter().map(move |(name, curve)| {
        let mut lines = String::new();
        for (step, value) in curve.points() {
            let _ = writeln!(lines, "{time} {value} {step}");
        }
        (name, lines)
    });
    figures.chain(curves)
}

fn tags(run: &Run) -> Vec<(&'static str, String)> {
    let record = &run.record;
    let mut tags = vec![
        ("mlflow.runName", title(run)),
        ("mlflow.source.name", format!("trainer {}", record.command.join(" "))),
        ("mlflow.source.type", "LOCAL".to_owned()),
        ("mlflow.source.git.commit", record.revision.clone()),
        ("build", record.build.clone()),
        ("machine", run.place()),
        ("threads", record.threads.to_string()),
        ("attempts", record.attempts.to_string()),
    ];
    tags.extend(record.user.clone().map(|user| ("mlflow.user", user)));
    if let campaign::record::Ending::Failed(error) = &record.ending {
        tags.push(("error", error.clone()));
    }
    tags
}

/// Id of the experiment with the runs of a command: 18 digits, as `MLflow` gives them.
fn experiment_id(command: &str) -> String {
    let sum = Crc::<u64>::new(&CRC_64_XZ).checksum(format!("eupnea {command}").as_bytes());
    format!("{:018}", 100_000_000_000_000_000 + sum % 900_000_000_000_000_000)
}

fn experiment_meta(folder: &Path, id: &str, command: &str, created_s: u64) -> String {
    let created = (1000 * created_s).to_string();
    yaml(&[
        ("artifact_location", quoted(&uri(folder))),
        ("creation_time", created.clone()),
        ("experiment_id", quoted(id)),
        ("last_update_time", created),
        ("lifecycle_stage", "active".to_owned()),
        ("name", quoted(&format!("eupnea {command}"))),
    ])
}

fn run_meta(run: &Run, experiment: &str, folder: &Path) -> String {
    let record = &run.record;
    let id = quoted(&id(run));
    yaml(&[
        ("artifact_uri", quoted(&uri(&folder.join("artifacts")))),
        ("end_time", record.ended_s.map_or_else(|| "null".to_owned(), |end_s| (1000 * end_s).to_string())),
        ("entry_point_name", quoted("")),
        ("experiment_id", quoted(experiment)),
        ("lifecycle_stage", "active".to_owned()),
        ("run_id", id.clone()),
        ("run_name", quoted(&title(run))),
        ("run_uuid", id),
        ("source_name", quoted("")),
        // A local program.
        ("source_type", "4".to_owned()),
        ("source_version", quoted("")),
        ("start_time", (1000 * record.began_s).to_string()),
        ("status", status(record.state()).to_string()),
        ("tags", "[]".to_owned()),
        ("user_id", quoted(record.user.as_deref().unwrap_or_default())),
    ])
}

/// Number of a state in `MLflow`'s enumeration `RunStatus`.
fn status(state: State) -> u8 {
    match state {
        State::Running | State::Unfinished => 1,
        State::Complete => 3,
        State::Failed => 4,
        State::Killed | State::Stopped => 5,
    }
}

/// A mapping as YAML.
fn yaml(fields: &[(&str, String)]) -> String {
    fields.iter().flat_map(|(name, value)| [name, ": ", value, "\n"]).collect()
}

/// Text as a YAML scalar: that of JSON is one.
fn quoted(text: &str) -> String {
    serde_json::Value::from(text).to_string()
}

/// Address of a folder.
fn uri(folder: &Path) -> String {
    let folder = std::path::absolute(folder).unwrap_or_else(|_| folder.to_owned());
    format!("file://{}", folder.display())
}

/// A name that `MLflow` accepts, and that stays inside its folder.
fn key(name: &str) -> String {
    let allowed = |c: char| c.is_alphanumeric() || matches!(c, '_' | '-' | '.' | ' ');
    name.chars().map(|c| if allowed(c) { c } else { '_' }).collect()
}
