//! Who ran a shard, when and how it ended.

use std::path::{Path, PathBuf};
use std::time::{SystemTime, UNIX_EPOCH};

use serde::{Deserialize, Serialize};

use crate::CampaignError;
use crate::engine::Engine;
use data::files::{read_json, write_json_indented};
use data::provenance::git_revision;

/// How a task ended.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Ending {
    /// It is running, or was killed.
    Running,
    /// The shard is complete.
    Complete,
    /// It was stopped.
    Stopped,
    /// With this error.
    Failed(String),
}

/// A task with a shard.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct TaskRecord {
    /// Name of the machine.
    pub host: String,
    /// Revision of the program's source tree.
    pub revision: String,
    /// The engine that started it; none for one that was started by hand.
    pub engine: Option<String>,
    /// Arguments of the command.
    pub command: Vec<String>,
    /// How many tasks have begun with this shard.
    pub attempts: u32,
    /// When it began, seconds since 1970.
    pub began_s: u64,
    /// When it ended; none while it runs, and if it was killed.
    pub ended_s: Option<u64>,
    /// How it ended.
    pub ending: Ending,
}

/// The record of a running task.
pub(super) struct Running {
    file: PathBuf,
    record: TaskRecord,
}

impl TaskRecord {
    /// Records the beginning of a task.
    pub(super) fn begin(file: &Path) -> Result<Running, CampaignError> {
        // A record that cannot be read is replaced: nothing depends on it.
        let earlier = read_json::<Self>(file).ok().flatten();
        let record = Self {
            host: host(),
            revision: git_revision(),
            engine: Engine::current().map(|engine| engine.name.to_owned()),
            command: std::env::args().skip(1).collect(),
            attempts: earlier.map_or(0, |record| record.attempts) + 1,
            began_s: now_s(),
            ended_s: None,
            ending: Ending::Running,
        };
        write_json_indented(file, &record).map_err(CampaignError::file(file))?;
        Ok(Running { file: file.to_owned(), record })
    }
}

impl Running {
    /// Records the end.
    pub(super) fn end(self, ending: Ending) {
        let record = TaskRecord { ended_s: Some(now_s()), ending, ..self.record };
        // The command itself reports its error; a folder that cannot be written must not hide it.
        let _ = write_json_indented(&self.file, &record);
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
