//! Submitting the shards of a command to an engine, and watching them until they are merged.
//!
//! Progress and failures are read from the run's folder alone, so every engine is watched in the same way. Shards that have failed, or
//! whose tasks were killed, are submitted again; complete ones never are. So the same command, given again, does what is left.

pub mod parallel;
pub mod slurm;

use std::io;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};
use std::time::{Duration, Instant};

use progress::{Progress, Stage};
use thiserror::Error;

use campaign::WorkspaceError;
use campaign::record::Ending;
use campaign::shards::{RunFolder, ShardState};
use campaign::shell::quoted;
use data::files::write_atomically;

/// Tasks of an engine: shards.
pub const SHARDS: Stage = Stage("run shards");

/// Time between the first two looks at the engine and the run's folder, and the longest one.
const LOOK_AFTER: Duration = Duration::from_millis(200);
const LOOK_AFTER_AT_MOST: Duration = Duration::from_secs(15);
/// Variable with the number of threads of a task, which a user may have set.
const THREADS: &str = "RAYON_NUM_THREADS";
/// Most failures that an error names.
const NAMED: usize = 5;

/// Why a command could not be submitted or did not end well.
#[derive(Debug, Error)]
#[expect(missing_docs, reason = "the messages name every field")]
pub enum SubmitError {
    /// The folder cannot be used.
    #[error(transparent)]
    Workspace(#[from] WorkspaceError),
    /// A program of the engine cannot be started.
    #[error("cannot run {program}: {source}; {hint}")]
    Program { program: &'static str, source: io::Error, hint: &'static str },
    /// A program of the engine has refused.
    #[error("{program}: {message}")]
    Refused { program: &'static str, message: String },
    /// The folder is divided into another number of shards.
    #[error("{} is divided into {there} shards, not {here}: give --shards {there}, or choose another folder", path.display())]
    OtherDivision { path: PathBuf, there: u64, here: u64 },
    /// The merge has failed, or what it has found is a failure.
    #[error("the merge ended with status {status}; what it has printed is in {}", log.display())]
    Merge { status: i32, log: PathBuf },
    /// Shards are not complete after all attempts.
    #[error("{} of {of} shards are not complete: {}; the same command submits just these again", failures.len(), listed(failures))]
    Incomplete { of: u64, failures: Vec<String> },
}

fn listed(failures: &[String]) -> String {
    let more = failures.len().saturating_sub(NAMED);
    let named = failures[..failures.len() - more].join("; ");
    if more == 0 { named } else { format!("{named}; and {more} more") }
}

/// A command whose work is divided into shards.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Job {
    /// The program.
    pub program: PathBuf,
    /// Arguments of the whole command, without those that divide it, and without the folder.
    pub arguments: Vec<String>,
    /// Folder of the run, absolute.
    pub out: PathBuf,
    /// Number of shards.
    pub shards: u64,
}

impl Job {
    /// Command line of a shard; `index` is a number, or a variable of the engine's.
    fn shard_line(&self, index: &str) -> String {
        format!("{} --shard {index}/{}", self.line(), self.shards)
    }

    /// Command line that merges the shards.
    fn merge_line(&self) -> String {
        format!("{} --merge", self.line())
    }

    fn line(&self) -> String {
        let program = self.program.to_string_lossy();
        let out = self.out.to_string_lossy();
        let words = [&*program].into_iter().chain(self.arguments.iter().map(String::as_str));
        words.chain(["--out", &*out]).map(quoted).collect::<Vec<_>>().join(" ")
    }

    /// Folder of the scripts and of what tasks print.
    pub fn log(&self) -> PathBuf {
        self.out.join("log")
    }

    /// What the merge has printed, results and errors.
    pub fn merge_log(&self) -> PathBuf {
        self.log().join("merge.txt")
    }

    /// Exit status of the merge.
    fn merge_status(&self) -> PathBuf {
        self.log().join("merge.status")
    }

    fn folder(&self) -> RunFolder {
        RunFolder::new(&self.out)
    }

    /// Writes a script into the folder.
    fn write(&self, name: &str, script: &str) -> Result<PathBuf, SubmitError> {
        let path = self.log().join(name);
        write_atomically(&path, script.as_bytes()).map_err(WorkspaceError::file(&path))?;
        Ok(path)
    }

    /// The shards that are not complete.
    fn open(&self) -> Result<Vec<u64>, SubmitError> {
        if let Some(there) = self.folder().shards()?.filter(|there| *there != self.shards) {
            return Err(SubmitError::OtherDivision { path: self.out.clone(), there, here: self.shards });
        }
        let states = self.folder().states()?;
        if states.is_empty() {
            return Ok((0..self.shards).collect());
        }
        Ok(states.iter().filter(|state| !state.complete).map(|state| state.share.index()).collect())
    }

    /// Reports progress until `ended` says that the engine has nothing left to run, or it is stopped.
    fn watch(
        &self,
        progress: &Progress<'_>,
        mut ended: impl FnMut() -> Result<bool, SubmitError>,
    ) -> Result<(), SubmitError> {
        let task = progress.task(SHARDS, self.shards as usize);
        let mut pause = LOOK_AFTER;
        loop {
            let over = ended()?;
            task.reach(self.folder().complete(self.shards) as usize);
            if over {
                return Ok(());
            }
            let slept = Instant::now();
            while slept.elapsed() < pause {
                if task.stopped() {
                    return Ok(());
                }
                std::thread::sleep(LOOK_AFTER.min(pause));
            }
            // Short work is watched closely; long work must not burden the engine or the file system.
            pause = pause.mul_f64(1.3).min(LOOK_AFTER_AT_MOST);
        }
    }

    /// An error that names the shards that are not complete, and why.
    fn incomplete(&self) -> Result<(), SubmitError> {
        let states = self.folder().states()?;
        let failures: Vec<_> = if states.is_empty() {
            vec![format!("none has begun; see {}", self.log().display())]
        } else {
            states.iter().filter(|state| !state.complete).map(|state| self.failure(state)).collect()
        };
        if failures.is_empty() { Ok(()) } else { Err(SubmitError::Incomplete { of: self.shards, failures }) }
    }

    fn failure(&self, state: &ShardState) -> String {
        let (shard, log) = (state.share.index(), self.log());
        match state.record.as_ref().map(|record| (&record.ending, &record.host)) {
            None => format!("shard {shard} has not begun (see {})", log.display()),
            Some((Ending::Failed(error), host)) => format!("shard {shard} failed on {host}: {error}"),
            Some((Ending::Stopped, host)) => format!("shard {shard} was stopped on {host}"),
            Some((_, host)) => format!("shard {shard} was killed on {host} (see {})", log.display()),
        }
    }
}

/// Runs a program of the engine.
fn run(program: &'static str, arguments: &[&str], hint: &'static str) -> Result<Output, SubmitError> {
    Command::new(program).args(arguments).output().map_err(|source| SubmitError::Program {
        program,
        source,
        hint,
    })
}

/// Standard output of a program that must succeed.
fn answer(program: &'static str, arguments: &[&str], hint: &'static str) -> Result<String, SubmitError> {
    let output = run(program, arguments, hint)?;
    if output.status.success() {
        return Ok(String::from_utf8_lossy(&output.stdout).trim().to_owned());
    }
    let message = String::from_utf8_lossy(&output.stderr).trim().replace('\n', "; ");
    Err(SubmitError::Refused { program, message })
}

/// A path as text.
fn text(path: &Path) -> String {
    path.to_string_lossy().into_owned()
}
