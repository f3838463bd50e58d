//! Campaigns: work that consists of many independent units, such as the plants of a robustness test.
//!
//! [`Work`] computes one unit; its [`Sums`] add results up, in any order, to the same bits. So a [`Campaign`] can run on any number of
//! threads, stop and continue, and be divided into [`Share`]s that different machines run; merged ([`shards`]), they equal the whole
//! run byte for byte.
#![forbid(unsafe_code)]

pub mod claims;
mod done;
pub mod engine;
mod exact;
pub mod record;
pub mod shards;
mod share;
pub mod shell;
#[cfg(test)]
mod tests;
mod threads;

use std::path::Path;
use std::sync::Mutex;
use std::time::{Duration, Instant};

use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};

use data::files::{read_json, write_json};
use data::workspace::same;
use done::Done;
use progress::{Progress, Stage, Task};
use threads::locked;

pub use data::workspace::WorkspaceError;
pub use exact::ExactSum;
pub use share::Share;
pub use threads::on_threads;

/// Time between two saves. A process that is killed loses the units since then, and those under way.
const SAVE_EVERY: Duration = Duration::from_secs(2);

/// What a campaign adds up.
pub trait Sums: Serialize + DeserializeOwned + Send {
    /// Result of a unit.
    type Unit: Send;

    /// Adds the result of a unit. The order must not matter, to the last bit: see [`ExactSum`].
    fn add(&mut self, number: u64, result: Self::Unit);

    /// Adds the sums over other units.
    fn absorb(&mut self, other: Self);
}

/// What a campaign computes.
pub trait Work: Sync {
    /// Everything that determines the results: those of different questions are never added up.
    type Question: Serialize + DeserializeOwned + Clone + Send;
    /// What is added up.
    type Sums: Sums;
    /// Why a unit failed.
    type Error: From<WorkspaceError> + Send;

    /// Its question.
    fn question(&self) -> Self::Question;

    /// Sums of no unit.
    fn nothing(&self) -> Self::Sums;

    /// The stage to report, and its steps per unit.
    fn stage(&self) -> (Stage, f64);

    /// Computes a unit, and advances the task by its steps; none if it was stopped.
    ///
    /// # Errors
    /// The unit cannot be computed; the campaign ends.
    fn unit(&self, number: u64, task: &Task<'_>) -> Result<Option<UnitOf<Self>>, Self::Error>;
}

/// Result of a unit of some work.
pub type UnitOf<W> = <<W as Work>::Sums as Sums>::Unit;
/// The campaign of some work.
pub type CampaignOf<W> = Campaign<<W as Work>::Question, <W as Work>::Sums>;

/// A campaign: its question, and the sums so far. When saved, it can continue later.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Campaign<Q, S> {
    question: Q,
    share: Share,
    /// Places of the share whose units are done.
    done: Done,
    sums: S,
}

impl<Q, S: Sums> Campaign<Q, S>
where
    Q: Serialize + DeserializeOwned + Clone + Send,
{
    /// A campaign at its beginning.
    pub fn new<W: Work<Question = Q, Sums = S>>(work: &W) -> Self {
        Self { question: work.question(), share: Share::WHOLE, done: Done::default(), sums: work.nothing() }
    }

    /// The same campaign as a file has kept it, or unchanged if there is no such file.
    ///
    /// # Errors
    /// A file that cannot be read, or that belongs to a different campaign.
    pub fn resumed(self, file: &Path) -> Result<Self, WorkspaceError> {
        let Some(kept) = read_json::<Self>(file).map_err(WorkspaceError::file(file))? else {
            return Ok(self);
        };
        same(file, &(&kept.question, kept.share), &(&self.question, self.share))?;
        Ok(kept)
    }

    /// Continues until all units of the campaign's share of the first `units` are done or it is stopped, on all threads. If a file is
    /// given, it saves the campaign there every few seconds and at the end.
    ///
    /// # Errors
    /// That of the first unit that failed, or a file that cannot be written. Units under way are completed and saved.
    pub fn advance<W: Work<Question = Q, Sums = S>>(
        &mut self,
        work: &W,
        units: u64,
        keep: Option<&Path>,
        progress: &Progress<'_>,
    ) -> Result<(), W::Error> {
        let (stage, steps) = work.stage();
        let steps = |units: u64| (units as f64 * steps).round() as usize;
        let (share, count, before) = (self.share, self.share.count(units), self.done.clone());
        let task = progress.task(stage, steps(count));
        task.reach(steps(before.count().min(count)));
        let running = Mutex::new((&mut *self, Instant::now()));
        let unit = |place: u64| -> Result<(), W::Error> {
            let number = share.unit(place);
            let Some(result) = work.unit(number, &task)? else { return Ok(()) };
            let mut running = locked(&running);
            let (campaign, saved) = &mut *running;
            campaign.sums.add(number, result);
            campaign.done.insert(place);
            if saved.elapsed() > SAVE_EVERY {
                campaign.save(keep)?;
                *saved = Instant::now();
            }
            Ok(())
        };
        let open = (0..count).filter(|place| !before.contains(*place)).take_while(|_| !task.stopped());
        let outcome = on_threads(rayon::current_num_threads(), open, unit);
        let saved = self.save(keep);
        outcome?;
        Ok(saved?)
    }

    fn save(&self, keep: Option<&Path>) -> Result<(), WorkspaceError> {
        let Some(file) = keep else { return Ok(()) };
        write_json(file, self).map_err(WorkspaceError::file(file))
    }

    /// What it is about.
    pub fn question(&self) -> &Q {
        &self.question
    }

    /// Number of units that are done.
    pub fn units(&self) -> u64 {
        self.done.count()
    }

    /// The sums over these units.
    pub fn sums(&self) -> &S {
        &self.sums
    }
}
