//! Dividing the work of a command among many tasks, and merging what they have found.

use std::path::{Path, PathBuf};
use std::str::FromStr;

use campaign::shards::RunFolder;
use campaign::{Campaign, CampaignOf, Share, Work, WorkspaceError, engine};
use progress::Progress;
use serde::Serialize;
use serde::de::DeserializeOwned;

use crate::command::{Context, Makes};

/// Dividing the work among tasks; `lab submit` does it with an engine.
#[derive(Debug, clap::Args)]
pub struct ShardArgs {
    /// Run shard i of n and keep it in --out. i counts from 0 or from 1; 0 and n are the same. auto/n takes i from the engine's task
    /// number (Slurm, GNU parallel, AWS Batch, hq); auto takes n too, where the engine provides it
    #[arg(long, value_name = "i/n", requires = "out", conflicts_with = "merge")]
    shard: Option<Choice>,
    /// Merge the shards in --out, when all are complete, into the results of the whole
    #[arg(long, requires = "out")]
    merge: bool,
}

/// Dividing the work of a command that has no folder otherwise.
#[derive(Debug, clap::Args)]
pub struct ShardFolderArgs {
    #[command(flatten)]
    shards: ShardArgs,
    /// Folder of the shards; without --shard and --merge the same as with --shard auto
    #[arg(long, value_name = "PATH")]
    out: Option<PathBuf>,
}

/// Which shard.
#[derive(Clone, Copy, Debug)]
enum Choice {
    This(Share),
    /// That of the engine's task, of so many shards.
    Auto(Option<u64>),
}

impl FromStr for Choice {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        match text.strip_prefix("auto") {
            Some("") => Ok(Self::Auto(None)),
            Some(rest) => {
                let of = rest.strip_prefix('/').and_then(|of| of.parse().ok());
                of.map(|of| Self::Auto(Some(of)))
                    .ok_or_else(|| format!("'{text}': write auto or auto/n, as in auto/40"))
            }
            None => text.parse().map(Self::This),
        }
    }
}

impl ShardFolderArgs {
    /// What a command makes whose work is divided or, without a folder, an experiment.
    pub fn makes(&self) -> Makes<'_> {
        match &self.out {
            Some(out) if self.shards.merge => Makes::Folder(out),
            Some(_) => Makes::Shard,
            None => Makes::Experiment,
        }
    }

    /// Runs the units of some work: all of them, kept in a file if there is one, or a shard; or merges shards. None after a shard: it
    /// has nothing to show but that it is complete.
    ///
    /// # Errors
    /// Files of another run or that cannot be used, or a unit that fails.
    pub fn run<W: Work>(
        &self,
        work: &W,
        units: u64,
        keep: Option<&Path>,
        context: &Context<'_>,
    ) -> anyhow::Result<Option<CampaignOf<W>>>
    where
        W::Question: Sync,
        W::Error: std::error::Error + Send + Sync + 'static,
    {
        if let Some(out) = &self.out {
            return self.shards.divided(work, units, out, context);
        }
        let mut campaign = Campaign::new(work);
        if let Some(file) = keep {
            campaign = campaign.resumed(file)?;
        }
        context.progress(|progress| campaign.advance(work, units, keep, progress))?;
        Ok(Some(campaign))
    }

    /// A value that every task needs before it begins: if the work is divided, the first task computes and keeps it in the folder. None
    /// if it was stopped.
    ///
    /// # Errors
    /// Files of another run or that cannot be used, or a computation that fails.
    pub fn once<Q: Serialize, T: Serialize + DeserializeOwned, E>(
        &self,
        name: &str,
        question: &Q,
        compute: impl Fn(&Progress<'_>) -> Result<T, E>,
        context: &Context<'_>,
    ) -> Result<Option<T>, E>
    where
        E: From<WorkspaceError>,
    {
        context.progress(|progress| {
            if let Some(folder) = self.out.as_deref().map(RunFolder::new) {
                if !self.shards.merge {
                    return folder.once(name, question, progress, || compute(progress));
                }
                // A merge must not write into a folder without shards.
                if let Some(found) = folder.found(name, question)? {
                    return Ok(Some(found));
                }
            }
            let value = compute(progress)?;
            Ok((!progress.stopped()).then_some(value))
        })
    }

    /// The folder of the shards and how to use it, if the work is divided.
    pub fn folder(&self) -> Option<(&Path, &ShardArgs)> {
        Some((self.out.as_deref()?, &self.shards))
    }
}

impl ShardArgs {
    /// What a command with a folder of its own makes.
    pub fn makes<'a>(&self, folder: &'a Path) -> Makes<'a> {
        if self.shard.is_some() { Makes::Shard } else { Makes::Folder(folder) }
    }

    /// Whether the work is divided, for a command with a folder of its own.
    pub fn divides(&self) -> bool {
        self.merge || self.shard.is_some()
    }

    /// Runs a shard, or merges all: see [`ShardFolderArgs::run`].
    ///
    /// # Errors
    /// The same.
    pub fn divided<W: Work>(
        &self,
        work: &W,
        units: u64,
        out: &Path,
        context: &Context<'_>,
    ) -> anyhow::Result<Option<CampaignOf<W>>>
    where
        W::Question: Sync,
        W::Error: std::error::Error + Send + Sync + 'static,
    {
        let folder = RunFolder::new(out);
        if self.merge {
            return Ok(Some(folder.merged(work, units)?));
        }
        let share = self.share()?;
        let complete =
            context.progress(|progress| folder.run(work, units, share, context.options(), progress))?;
        context.line(&if complete {
            format!("shard {share} is complete: {}", folder.shard_file(share).display())
        } else {
            format!("shard {share} was stopped; the same command continues")
        });
        Ok(None)
    }

    fn share(&self) -> anyhow::Result<Share> {
        let share = match self.shard {
            Some(Choice::This(share)) => Ok(share),
            Some(Choice::Auto(of)) => engine::share(of),
            None => engine::share(None),
        };
        share.map_err(anyhow::Error::msg)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_shard_is_named_by_its_number_or_left_to_the_engine() {
        assert!(matches!("3/40".parse(), Ok(Choice::This(share)) if share == Share::new(3, 40).unwrap()));
        assert!(matches!("auto".parse(), Ok(Choice::Auto(None))));
        assert!(matches!("auto/40".parse(), Ok(Choice::Auto(Some(40)))));
        for wrong in ["auto40", "auto/", "auto/x", "41/40", "3"] {
            assert!(wrong.parse::<Choice>().is_err(), "{wrong}");
        }
    }
}
