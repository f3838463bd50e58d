//! The folder of a run that is divided into shards, which any machines with access to the folder run.
//!
//! What they share is files alone, each written whole and renamed, so a task that is killed leaves nothing half written, and two tasks
//! with the same shard do no harm: they write the same.
//!
//! | file | content |
//! |---|---|
//! | `shards/run.json` | what the run computes: build of the program, question, number of units and of shards |
//! | `shards/3-of-40.part.json` | the campaign of shard 3 so far, saved every few seconds |
//! | `shards/3-of-40.json` | the same when it is complete |
//! | `shards/3-of-40.task.json` | the last task with that shard: host, engine, times and how it ended ([`Record`]) |
//! | `shards/NAME.json` | a value that every task needs, computed by the first ([`RunFolder::once`]) |

use std::path::{Path, PathBuf};

use progress::{Progress, Stage, Task};
use serde::{Deserialize, Serialize};

use crate::record::{Ending, Options, Record, Results};
use crate::{Campaign, CampaignOf, Share, UnitOf, Work, WorkspaceError};
use data::provenance::build_id;
use data::workspace::Workspace;

mod merge;
mod once;
mod state;

pub use merge::MergeError;
pub use state::ShardState;

/// What a run computes, with all that its shards must have in common.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Run<Q> {
    /// The program, see [`build_id`].
    pub build: String,
    /// Number of units.
    pub units: u64,
    /// Number of shards.
    pub shards: u64,
    /// What the units are about.
    pub question: Q,
}

/// Work as part of a run.
struct PartOf<'a, W: Work> {
    work: &'a W,
    run: Run<W::Question>,
}

impl<'a, W: Work> PartOf<'a, W> {
    fn new(work: &'a W, units: u64, shards: u64) -> Self {
        Self { work, run: Run { build: build_id(), units, shards, question: work.question() } }
    }
}

impl<W: Work> Work for PartOf<'_, W>
where
    W::Question: Sync,
{
    type Question = Run<W::Question>;
    type Sums = W::Sums;
    type Error = W::Error;

    fn question(&self) -> Self::Question {
        self.run.clone()
    }

    fn nothing(&self) -> Self::Sums {
        self.work.nothing()
    }

    fn stage(&self) -> (Stage, f64) {
        self.work.stage()
    }

    fn unit(&self, number: u64, task: &Task<'_>) -> Result<Option<UnitOf<Self>>, Self::Error> {
        self.work.unit(number, task)
    }
}

/// The files of a run.
#[derive(Clone, Debug)]
pub struct RunFolder {
    path: PathBuf,
    /// `shards/` in it.
    shards: Workspace,
}

impl RunFolder {
    /// The run in this folder.
    pub fn new(path: &Path) -> Self {
        Self { path: path.to_owned(), shards: Workspace::new(path.join("shards")) }
    }

    fn record_file(&self, share: Share) -> PathBuf {
        self.shards.path(&format!("{}-of-{}.task.json", share.index(), share.of()))
    }

    /// Folder of the claims on work that tasks share.
    pub fn claims_folder(&self) -> PathBuf {
        self.shards.path("claims")
    }

    /// The campaign of a shard that is not complete. It has a file of its own, so that a task cannot replace the complete campaign of
    /// another one with the same shard.
    fn part_file(&self, share: Share) -> PathBuf {
        self.shards.path(&format!("{}-of-{}.part.json", share.index(), share.of()))
    }

    /// The complete campaign of a shard.
    pub fn shard_file(&self, share: Share) -> PathBuf {
        self.shards.path(&format!("{}-of-{}.json", share.index(), share.of()))
    }

    /// Runs a shard of the first `units` units of some work, or continues it, and saves it in the folder, with a record that has the
    /// options of the command. True if it is complete, false if it was stopped.
    ///
    /// # Errors
    /// A folder that belongs to a different run or cannot be written, or a unit that fails, which the task's record names.
    pub fn run<W: Work>(
        &self,
        work: &W,
        units: u64,
        share: Share,
        options: &Options,
        progress: &Progress<'_>,
    ) -> Result<bool, W::Error>
    where
        W::Question: Sync,
        W::Error: std::fmt::Display,
    {
        if progress.stopped() {
            return Ok(false);
        }
        let part = PartOf::new(work, units, share.of());
        self.shards.claim(&part.run)?;
        let file = self.record_file(share);
        // A record that cannot be read is replaced: nothing depends on it.
        let earlier = Record::load(&file).ok().flatten();
        let record = earlier.iter().fold(Record::begin(options), Record::continuing).running(&file);
        record.write().map_err(WorkspaceError::file(&file))?;
        let outcome = self.advance(&part, share, progress);
        let ending = match &outcome {
            Ok(true) => Ending::Complete,
            Ok(false) => Ending::Stopped,
            Err(error) => Ending::Failed(error.to_string()),
        };
        // The command itself reports its error; a folder that cannot be written must not hide it.
        let _ = record.end(ending, Results::default());
        outcome
    }

    fn advance<W: Work>(
        &self,
        part: &PartOf<'_, W>,
        share: Share,
        progress: &Progress<'_>,
    ) -> Result<bool, W::Error>
    where
        W::Question: Sync,
    {
        let (file, kept) = (self.shard_file(share), self.part_file(share));
        let units = part.run.units;
        let complete = |campaign: &CampaignOf<PartOf<'_, W>>| campaign.units() == share.count(units);
        let new = || Campaign { share, ..Campaign::new(part) };
        if file.exists() {
            // It is only written when it is complete; it may belong to a different run.
            new().resumed(&file)?;
            return Ok(true);
        }
        let mut campaign = new().resumed(&kept)?;
        campaign.advance(part, units, Some(&kept), progress)?;
        if !complete(&campaign) {
            return Ok(false);
        }
        campaign.save(Some(&file))?;
        // Nothing reads it any more.
        let _ = std::fs::remove_file(kept);
        Ok(true)
    }

    /// Number of shards of the run in the folder; none without a run.
    ///
    /// # Errors
    /// A file that cannot be read.
    pub fn shards(&self) -> Result<Option<u64>, WorkspaceError> {
        let run = self.shards.recipe::<Run<serde_json::Value>>()?;
        Ok(run.map(|run| run.shards))
    }
}
