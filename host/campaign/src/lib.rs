//! Campaigns: work that consists of many independent units, such as the plants of a robustness test.
//!
//! [`Work`] computes one unit; its [`Sums`] add results up, in any order, to the same bits. So a [`Campaign`] can run on any number of
//! threads, stop and continue, and be divided into [`Share`]s that different machines run; merged ([`shards`]), they equal the whole
//! run byte for byte.
#![forbid(unsafe_code)]

pub mod claims;
mod difference;
mod done;
pub mod engine;
mod exact;
pub mod record;
pub mod shards;
mod share;
#[cfg(test)]
mod tests;

use std::io;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use thiserror::Error;

use data::files::{read_json, write_json};
use done::Done;
use progress::{Progress, Stage, Task};

pub use exact::ExactSum;
pub use share::Share;

/// Time between two saves. A process that is killed loses the units since then, and those under way.
const SAVE_EVERY: Duration = Duration::from_secs(2);

/// Why a campaign cannot begin or continue.
#[derive(Debug, Error)]
#[expect(missing_docs, reason = "the messages name every field")]
pub enum CampaignError {
    /// A file could not be used.
    #[error("cannot use {}: {source}", path.display())]
    File { path: PathBuf, source: io::Error },
    /// The file belongs to a different campaign.
    #[error("{} belongs to another run: {difference}; choose another file or folder, or use the same options", path.display())]
    OtherRun { path: PathBuf, difference: String },
}

impl CampaignError {
    /// Wraps an error of a file with its path.
    pub fn file(path: &Path) -> impl FnOnce(io::Error) -> Self + use<> {
        let path = path.to_owned();
        move |source| Self::File { path, source }
    }
}

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
    type Error: From<CampaignError> + Send;

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
    pub fn resumed(self, file: &Path) -> Result<Self, CampaignError> {
        let Some(kept) = read_json::<Self>(file).map_err(CampaignError::file(file))? else { return Ok(self) };
        match difference::between(&(&kept.question, kept.share), &(&self.question, self.share)) {
            None => Ok(kept),
            Some(difference) => Err(CampaignError::OtherRun { path: file.to_owned(), difference }),
        }
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
        let (next, failed) = (AtomicU64::new(0), AtomicBool::new(false));
        let running = Mutex::new(Running { campaign: self, saved: Instant::now(), failure: None });
        let unit = |place: u64| -> Result<(), W::Error> {
            let number = share.unit(place);
            let Some(result) = work.unit(number, &task)? else { return Ok(()) };
            let mut running = running.lock().unwrap_or_else(PoisonError::into_inner);
            running.campaign.sums.add(number, result);
            running.campaign.done.insert(place);
            if running.saved.elapsed() > SAVE_EVERY {
                running.campaign.save(keep)?;
                running.saved = Instant::now();
            }
            Ok(())
        };
        let worker = || {
            while !task.stopped() && !failed.load(Ordering::Relaxed) {
                let place = next.fetch_add(1, Ordering::Relaxed);
                if place >= count {
                    break;
                }
                if !before.contains(place)
                    && let Err(error) = unit(place)
                {
                    failed.store(true, Ordering::Relaxed);
                    running.lock().unwrap_or_else(PoisonError::into_inner).fail(place, error);
                }
            }
        };
        // Threads of their own: one of the pool's would begin another unit while it waits for parts of its own.
        std::thread::scope(|scope| {
            for _ in 0..(rayon::current_num_threads() as u64).min(count) {
                scope.spawn(worker);
            }
        });
        let Running { campaign, failure, .. } = running.into_inner().unwrap_or_else(PoisonError::into_inner);
        let saved = campaign.save(keep);
        failure.map_or(Ok(()), |(_, error)| Err(error))?;
        Ok(saved?)
    }

    fn save(&self, keep: Option<&Path>) -> Result<(), CampaignError> {
        let Some(file) = keep else { return Ok(()) };
        write_json(file, self).map_err(CampaignError::file(file))
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

/// A campaign that several threads advance.
struct Running<'a, Q, S, E> {
    campaign: &'a mut Campaign<Q, S>,
    saved: Instant,
    /// The failure of the first place, and this place.
    failure: Option<(u64, E)>,
}

impl<Q, S, E> Running<'_, Q, S, E> {
    /// Keeps the failure of the first place. Units begin in order, so it is the same on any number of threads.
    fn fail(&mut self, place: u64, error: E) {
        if self.failure.as_ref().is_none_or(|(first, _)| place < *first) {
            self.failure = Some((place, error));
        }
    }
}
