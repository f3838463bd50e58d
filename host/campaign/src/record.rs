//! Records of runs: what made the files of a folder, when, where, and with which results.
//!
//! A command with an output folder keeps its record there as `made-by.json`; a task with a shard keeps one beside its shard. The record
//! is written when the run begins, so a run that was killed is one that never ended.

use std::collections::BTreeMap;
use std::io;
use std::path::{Path, PathBuf};
use std::time::{Instant, SystemTime, UNIX_EPOCH};

use serde::{Deserialize, Serialize};

use crate::engine::Engine;
use data::files::{read_json, write_json_indented};
use data::provenance::{build_id, git_revision};

mod results;

pub use results::{CURVE, Curve, Results};

/// File name of a run's record in its folder.
pub const MADE_BY: &str = "made-by.json";

/// Values of a command's options by name, defaults included. Several values are separated by blanks.
pub type Options = BTreeMap<String, String>;

/// How a run ended.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Ending {
    /// It is running, or was killed.
    Running,
    /// It is complete.
    Complete,
    /// It was stopped.
    Stopped,
    /// With this error.
    Failed(String),
}

/// The state of a run, as far as this machine knows.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum State {
    /// Its process runs on this machine.
    Running,
    /// Its process was on this machine and has disappeared.
    Killed,
    /// It has not ended, and ran on a different machine: running or killed.
    Unfinished,
    /// It is complete.
    Complete,
    /// It was stopped.
    Stopped,
    /// It failed.
    Failed,
}

/// What made a run.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Record {
    /// Arguments of the command.
    pub command: Vec<String>,
    /// The same as options with their values.
    pub options: Options,
    /// Revision of the program's source tree, see [`git_revision`].
    pub revision: String,
    /// The program itself, see [`build_id`].
    pub build: String,
    /// Name of the machine.
    pub host: String,
    /// Login name; none if the environment does not tell it.
    pub user: Option<String>,
    /// The engine that started it; none for a run that was started by hand.
    pub engine: Option<String>,
    /// Number of the engine's task.
    pub task: Option<u64>,
    /// Id of the process.
    pub process: u32,
    /// Number of threads.
    pub threads: usize,
    /// How many times it has begun; every field above is that of the last time.
    pub attempts: u32,
    /// When it began first, seconds since 1970.
    pub began_s: u64,
    /// When it ended; none while it runs, and if it was killed.
    pub ended_s: Option<u64>,
    /// Time that all attempts took which ended, seconds.
    pub spent_s: f64,
    /// How it ended.
    pub ending: Ending,
    /// The numbers among its results.
    #[serde(flatten)]
    pub results: Results,
}

impl Record {
    /// The record of a run that this process begins, of a command with these options.
    pub fn begin(options: &Options) -> Self {
        let engine = Engine::current();
        Self {
            command: std::env::args().skip(1).collect(),
            options: options.clone(),
            revision: git_revision(),
            build: build_id(),
            host: host(),
            user: ["USER", "LOGNAME", "USERNAME"].iter().find_map(|name| std::env::var(name).ok()),
            engine: engine.map(|engine| engine.name.to_owned()),
            task: engine.and_then(Engine::task),
            process: std::process::id(),
            threads: rayon::current_num_threads(),
            attempts: 1,
            began_s: now_s(),
            ended_s: None,
            spent_s: 0.0,
            ending: Ending::Running,
            results: Results::default(),
        }
    }

    /// The same as a further attempt of an earlier run.
    #[must_use]
    pub fn continuing(self, earlier: &Self) -> Self {
        let Self { attempts, began_s, spent_s, .. } = *earlier;
        Self { attempts: attempts + 1, began_s, spent_s, ..self }
    }

    /// Reads a record; none if there is no such file.
    ///
    /// # Errors
    /// A file that cannot be read or contains something else.
    pub fn load(file: &Path) -> io::Result<Option<Self>> {
        read_json(file)
    }

    /// Begins to measure the time of the run whose record this file is to be.
    pub fn running(self, file: &Path) -> Running {
        Running { file: file.to_owned(), record: self, began: Instant::now() }
    }

    /// Its state, as far as this machine knows.
    pub fn state(&self) -> State {
        match self.ending {
            Ending::Complete => State::Complete,
            Ending::Stopped => State::Stopped,
            Ending::Failed(_) => State::Failed,
            Ending::Running if self.host != host() => State::Unfinished,
            Ending::Running => match runs_here(self.process, &self.command) {
                Some(true) => State::Running,
                Some(false) => State::Killed,
                None => State::Unfinished,
            },
        }
    }
}

/// The record of a run of this process.
#[derive(Debug)]
pub struct Running {
    file: PathBuf,
    record: Record,
    began: Instant,
}

impl Running {
    /// Writes that the run has begun.
    ///
    /// # Errors
    /// A file that cannot be written.
    pub fn write(&self) -> io::Result<()> {
        write_json_indented(&self.file, &self.record)
    }

    /// Writes the end and the results.
    ///
    /// # Errors
    /// A file that cannot be written.
    pub fn end(self, ending: Ending, results: Results) -> io::Result<()> {
        let spent_s = self.record.spent_s + self.began.elapsed().as_secs_f64();
        let record = Record { ended_s: Some(now_s()), spent_s, ending, results, ..self.record };
        write_json_indented(&self.file, &record)
    }
}

fn now_s() -> u64 {
    SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |since| since.as_secs())
}

/// Name of this machine.
fn host() -> String {
    let name = std::fs::read_to_string("/proc/sys/kernel/hostname").ok();
    let name = name.or_else(|| std::env::var("HOSTNAME").ok());
    name.map_or_else(|| "unknown".to_owned(), |name| name.trim().to_owned())
}

/// Whether a process with this id and these arguments runs here: ids are used again. None where the system does not tell.
fn runs_here(process: u32, command: &[String]) -> Option<bool> {
    if !Path::new("/proc/self/cmdline").exists() {
        return None;
    }
    let Ok(line) = std::fs::read(format!("/proc/{process}/cmdline")) else { return Some(false) };
    let line = String::from_utf8_lossy(&line).into_owned();
    Some(line.split_terminator('\0').skip(1).eq(command.iter().map(String::as_str)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_run_that_was_killed_is_told_from_one_that_runs() {
        let running = Record::begin(&Options::default());
        assert_eq!(running.state(), State::Running);
        let reused = Record { command: vec!["another".into()], ..running.clone() };
        assert_eq!(reused.state(), State::Killed);
        assert_eq!(Record { process: u32::MAX, ..running.clone() }.state(), State::Killed);
        let elsewhere = Record { host: "another machine".into(), ..running };
        assert_eq!(elsewhere.state(), State::Unfinished);
    }

    #[test]
    fn a_further_attempt_keeps_the_beginning_and_adds_to_the_time() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join(MADE_BY);
        assert_eq!(Record::load(&file).unwrap(), None);
        let first = Record { began_s: 7, spent_s: 100.0, ..Record::begin(&Options::default()) };
        let results = Results::of(&serde_json::json!({ "mean": { "learned": 0.9 } }));
        let second = Record::begin(&Options::default()).continuing(&first).running(&file);
        second.write().unwrap();
        assert_eq!(Record::load(&file).unwrap().unwrap().state(), State::Running);
        second.end(Ending::Complete, results.clone()).unwrap();
        let record = Record::load(&file).unwrap().unwrap();
        assert_eq!((record.attempts, record.began_s, record.state()), (2, 7, State::Complete));
        assert!(record.spent_s >= 100.0 && record.ended_s.is_some() && record.results == results);
    }
}
