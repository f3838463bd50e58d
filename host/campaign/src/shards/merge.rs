//! Merging the shards of a run.

use std::path::PathBuf;

use thiserror::Error;

use super::{PartOf, Run, RunFolder};
use crate::done::Done;
use crate::{Campaign, CampaignOf, Share, Sums, Work, WorkspaceError};
use data::difference;
use data::files::read_json;

/// Most problems that an error names.
const NAMED: usize = 10;

/// Why the shards of a folder cannot be merged.
#[derive(Debug, Error)]
#[expect(missing_docs, reason = "the messages name every field")]
pub enum MergeError {
    /// The folder cannot be used.
    #[error(transparent)]
    Workspace(#[from] WorkspaceError),
    /// No shard has begun there.
    #[error("{} contains no sharded run: run its shards first, with --shard i/n", .0.display())]
    NoRun(PathBuf),
    /// Some shards cannot be merged; nothing was written.
    #[error("cannot merge {}: {}", path.display(), listed(problems))]
    Problems { path: PathBuf, problems: Vec<String> },
}

fn listed(problems: &[String]) -> String {
    let (named, more) = problems.split_at(problems.len().min(NAMED));
    let text = named.join("; ");
    if more.is_empty() { text } else { format!("{text}; and {} more", more.len()) }
}

/// What is in the folder in place of a shard.
enum Shard<S> {
    Complete(S),
    Missing,
    /// Something that cannot be merged.
    Other(String),
}

/// Why shards cannot be merged.
#[derive(Default)]
struct Problems {
    missing: Vec<u64>,
    others: Vec<String>,
}

impl Problems {
    fn in_words(self, shards: u64) -> Vec<String> {
        let missing = self.missing.iter().take(NAMED).map(u64::to_string).collect::<Vec<_>>().join(", ");
        let missing = match self.missing.len() {
            0 => None,
            1 => Some(format!("shard {missing} of {shards} is not complete")),
            n if n > NAMED => Some(format!("{n} of {shards} shards are not complete, such as {missing}")),
            _ => Some(format!("shards {missing} of {shards} are not complete")),
        };
        missing.into_iter().chain(self.others).collect()
    }
}

impl RunFolder {
    /// The whole campaign, from all shards.
    ///
    /// # Errors
    /// A shard that is missing, not complete, a copy of another one, or of a different run or build.
    pub fn merged<W: Work>(&self, work: &W, units: u64) -> Result<CampaignOf<W>, MergeError>
    where
        W::Question: Sync,
    {
        let Some(shards) = self.shards()? else { return Err(MergeError::NoRun(self.path.clone())) };
        let part = PartOf::new(work, units, shards);
        self.shards.claim(&part.run)?;
        let mut sums = work.nothing();
        let mut problems = Problems::default();
        for share in Share::all(shards) {
            match self.shard(&part, share) {
                Ok(Shard::Complete(found)) => sums.absorb(found),
                Ok(Shard::Missing) => problems.missing.push(share.index()),
                Ok(Shard::Other(problem)) => problems.others.push(problem),
                Err(error) => problems.others.push(error.to_string()),
            }
        }
        let problems = problems.in_words(shards);
        if !problems.is_empty() {
            return Err(MergeError::Problems { path: self.path.clone(), problems });
        }
        Ok(Campaign { question: part.run.question, share: Share::WHOLE, done: Done::below(units), sums })
    }

    /// What is there of a shard.
    fn shard<W: Work>(&self, part: &PartOf<'_, W>, share: Share) -> Result<Shard<W::Sums>, WorkspaceError>
    where
        W::Question: Sync,
    {
        type Found<W> = Campaign<Run<<W as Work>::Question>, <W as Work>::Sums>;
        let file = self.shard_file(share);
        let Some(found) = read_json::<Found<W>>(&file).map_err(WorkspaceError::file(&file))? else {
            return Ok(Shard::Missing);
        };
        Ok(if found.share != share {
            Shard::Other(format!("{} is a copy of shard {}", file.display(), found.share))
        } else if let Some(difference) = difference::between(&found.question, &part.run) {
            Shard::Other(format!("shard {share} belongs to another run: {difference}"))
        } else if found.units() != share.count(part.run.units) {
            Shard::Missing
        } else {
            Shard::Complete(found.sums)
        })
    }
}
