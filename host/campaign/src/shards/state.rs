//! How far each shard of a run is.

use serde::Deserialize;

use super::RunFolder;
use crate::done::Done;
use crate::record::Record;
use crate::{Share, WorkspaceError};
use data::files::read_json;

/// How far a shard is.
#[derive(Clone, Debug, PartialEq)]
pub struct ShardState {
    /// The shard.
    pub share: Share,
    /// Units that are done and saved.
    pub done: u64,
    /// Its units.
    pub units: u64,
    /// Whether all its units are done and can be merged; a shard without units needs a task too.
    pub complete: bool,
    /// Its last task; none before the first.
    pub record: Option<Record>,
}

/// What is read of a shard's campaign and of the run.
#[derive(Deserialize)]
struct Campaign {
    done: Done,
}

#[derive(Deserialize)]
struct Run {
    units: u64,
    shards: u64,
}

impl RunFolder {
    /// Number of complete shards, which takes no reading.
    pub fn complete(&self, shards: u64) -> u64 {
        Share::all(shards).filter(|share| self.shard_file(*share).exists()).count() as u64
    }

    /// How far each shard is; empty before the first has begun.
    ///
    /// # Errors
    /// A file that cannot be read.
    pub fn states(&self) -> Result<Vec<ShardState>, WorkspaceError> {
        let Some(run) = self.shards.recipe::<Run>()? else { return Ok(Vec::new()) };
        let state = |share: Share| {
            let (file, record) = (self.shard_file(share), self.record_file(share));
            let complete = file.exists();
            let file = if complete { file } else { self.part_file(share) };
            let campaign = read_json::<Campaign>(&file).map_err(WorkspaceError::file(&file))?;
            Ok(ShardState {
                share,
                done: campaign.map_or(0, |campaign| campaign.done.count()),
                units: share.count(run.units),
                complete,
                record: read_json(&record).map_err(WorkspaceError::file(&record))?,
            })
        };
        Share::all(run.shards).map(state).collect()
    }
}
