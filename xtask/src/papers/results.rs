//! Results that commands have left for the papers: those of `lab`, each beside the record of its run (docs/RUNS.md), and those of CI's
//! steps.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::time::{SystemTime, UNIX_EPOCH};

use anyhow::{Context, Result};
use serde::{Deserialize, Serialize};
use serde_json::Value;
use xshell::{Shell, cmd};

use crate::firmware::cargo_folder;

/// An experiment of `lab`.
pub struct Experiment {
    /// Name of its files.
    pub name: &'static str,
    /// Its command line after `lab`.
    pub line: &'static str,
    /// Whether `cargo xtask faults` runs it.
    pub quick: bool,
}

const fn experiment(name: &'static str, line: &'static str, quick: bool) -> Experiment {
    Experiment { name, line, quick }
}

pub const TEST_TABLE: Experiment = experiment("test-table", "test-table", true);
pub const FAULTS: Experiment = experiment("faults", "faults", true);
pub const FAULTS_HIGH: Experiment = experiment("faults-70", "faults --limit 70 --seeds 1", true);
pub const TORTURE: Experiment = experiment("torture", "torture --breaths 20000", true);
pub const TORTURE_HIGH: Experiment = experiment("torture-70", "torture --breaths 2000 --limit 70", true);
pub const DRAWN: Experiment = experiment("drawn", "faults --draw 28053 --seed 20261202", false);
pub const ENDURE: Experiment = experiment("endure", "endure --patients 60 --seed 33", false);

/// All of them.
pub const EXPERIMENTS: [Experiment; 7] =
    [TEST_TABLE, FAULTS, FAULTS_HIGH, TORTURE, TORTURE_HIGH, DRAWN, ENDURE];

/// Folder of the papers.
pub fn papers(shell: &Shell) -> PathBuf {
    cargo_folder(shell).join("papers")
}

/// Folder of the results.
pub fn folder(shell: &Shell) -> PathBuf {
    papers(shell).join("results")
}

impl Experiment {
    /// File of its results.
    pub fn file(&self, folder: &Path) -> PathBuf {
        folder.join(format!("{}.json", self.name))
    }

    /// The last run that has ended; none if there is none.
    pub fn last(&self, folder: &Path) -> Result<Option<Run>> {
        let path = self.file(folder);
        let (Some(record), Some(value)) = (parse(&path.with_extension("made-by.json"))?, parse(&path)?)
        else {
            return Ok(None);
        };
        Ok(Some(Run { record: serde_json::from_value(record)?, value }))
    }
}

/// The content of a file; none if there is no such file.
fn parse(path: &Path) -> Result<Option<Value>> {
    match fs::read(path) {
        Ok(bytes) => serde_json::from_slice(&bytes).map(Some).with_context(|| path.display().to_string()),
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => Ok(None),
        Err(error) => Err(error).with_context(|| path.display().to_string()),
    }
}

/// A run of an experiment.
#[derive(Debug)]
pub struct Run {
    /// What made it.
    pub record: Record,
    /// The results.
    pub value: Value,
}

/// The fields of a run's record that the papers state.
#[derive(Debug, Deserialize)]
pub struct Record {
    /// Arguments.
    pub command: Vec<String>,
    /// Revision of the source tree.
    pub revision: String,
    /// Its end, seconds since 1970.
    pub ended_s: Option<u64>,
}

impl Record {
    /// The command line, without the file of the results.
    pub fn line(&self) -> String {
        let words: Vec<&str> = self.command.iter().map(String::as_str).collect();
        let file = words.iter().position(|word| *word == "--json").unwrap_or(words.len());
        words[..file].join(" ")
    }
}

/// Result of a step of CI.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Step {
    /// Whether it passed.
    pub passed: bool,
    /// Revision of the source tree.
    pub revision: String,
    /// Its end, seconds since 1970.
    pub ended_s: u64,
}

/// Last results of CI's steps, by name.
pub type Steps = BTreeMap<String, Step>;

/// The last results of CI's steps.
pub fn steps(folder: &Path) -> Result<Steps> {
    Ok(parse(&folder.join("ci.json"))?.map(serde_json::from_value).transpose()?.unwrap_or_default())
}

/// Notes the result of a step of CI.
pub fn note_step(folder: &Path, name: &str, revision: &str, passed: bool) -> Result<()> {
    let mut steps = steps(folder)?;
    steps.insert(name.to_owned(), Step { passed, revision: revision.to_owned(), ended_s: now() });
    fs::create_dir_all(folder)?;
    fs::write(folder.join("ci.json"), serde_json::to_string_pretty(&steps)? + "\n")?;
    Ok(())
}

/// Seconds since 1970.
pub fn now() -> u64 {
    SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |time| time.as_secs())
}

/// Revision of the source tree, with `-dirty` if a file differs from it; `unknown` without a repository.
pub fn revision(shell: &Shell) -> String {
    let git = |line: &str| {
        let words = line.split(' ');
        cmd!(shell, "git {words...}").quiet().ignore_stderr().read().ok()
    };
    let Some(revision) = git("rev-parse --short=12 HEAD") else { return "unknown".into() };
    let clean = git("status --porcelain").is_some_and(|changes| changes.is_empty());
    if clean { revision } else { format!("{revision}-dirty") }
}

/// A day in UTC, as in 2026-11-29.
pub fn date(seconds: u64) -> String {
    // Days of the calendar's cycle of 400 years, which begins with March of the year 0.
    let days = seconds / 86_400 + 719_468;
    let (era, day) = (days / 146_097, days % 146_097);
    let year = (day - day / 1460 + day / 36_524 - day / 146_096) / 365;
    let of_year = day - (365 * year + year / 4 - year / 100);
    let month = (5 * of_year + 2) / 153;
    let of_month = of_year - (153 * month + 2) / 5 + 1;
    let (month, next) = if month < 10 { (month + 3, 0) } else { (month - 9, 1) };
    format!("{:04}-{month:02}-{of_month:02}", era * 400 + year + next)
}

/// The same with the time of day, as in 2026-11-29T08:27:43Z.
pub fn time(seconds: u64) -> String {
    let [hours, minutes] = [3600, 60].map(|unit| seconds / unit);
    format!("{}T{:02}:{:02}:{:02}Z", date(seconds), hours % 24, minutes % 60, seconds % 60)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_run_is_read_with_its_record() {
        let folder = tempfile::tempdir().unwrap();
        assert!(FAULTS.last(folder.path()).unwrap().is_none(), "not run");
        let record = r#"{"command": ["faults", "--limit", "70", "--json", "x"], "revision": "abc", "ended_s": 86400, "user": null}"#;
        fs::write(folder.path().join("faults.made-by.json"), record).unwrap();
        assert!(FAULTS.last(folder.path()).unwrap().is_none(), "begun and not ended");
        fs::write(FAULTS.file(folder.path()), "[]").unwrap();
        let run = FAULTS.last(folder.path()).unwrap().unwrap();
        assert_eq!((run.record.line(), &*run.record.revision), ("faults --limit 70".into(), "abc"));
    }

    #[test]
    fn a_step_replaces_its_own_last_result_alone() {
        let folder = tempfile::tempdir().unwrap();
        for (name, passed) in [("test", true), ("cost", true), ("test", false)] {
            note_step(folder.path(), name, "abc", passed).unwrap();
        }
        let steps = steps(folder.path()).unwrap();
        let results: Vec<_> = steps.iter().map(|(name, step)| (&**name, step.passed)).collect();
        assert_eq!(results, [("cost", true), ("test", false)]);
    }

    #[test]
    fn days_are_those_of_the_calendar() {
        let days = [(0, "1970-01-01"), (951_782_399, "2000-02-28"), (951_782_400, "2000-02-29")];
        for (seconds, day) in
            days.into_iter().chain([(1_795_940_863, "2026-11-29"), (1_798_761_600, "2027-01-01")])
        {
            assert_eq!(date(seconds), day);
        }
        assert_eq!(time(1_795_940_863), "2026-11-29T08:27:43Z");
    }
}
