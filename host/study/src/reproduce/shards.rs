//! A reproduction divided among tasks that share its folder.
//!
//! The units are the experiments' pieces. A piece needs the results of all earlier groups. So before a task runs its own piece, it runs
//! whatever is open in those groups, and waits for what others are running. Others tell by *claims*: files that a task renews every few
//! seconds while it runs a piece. The claim of a task that was killed grows old, and another task takes the piece.

use std::collections::{BTreeMap, BTreeSet};
use std::fs::{self, File};
use std::hash::{BuildHasher, Hasher, RandomState};
use std::io;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use campaign::{Sums, Work};
use serde::{Deserialize, Serialize};

use super::study::Study;
use super::{Budget, Experiment, Reproduction};
use crate::error::{Result, StudyError};
use data::files::write_atomically;
use plant::bench::BenchConfig;
use progress::{Progress, Stage, Task};

/// Time between two renewals of a claim.
const RENEW_EVERY: Duration = Duration::from_secs(5);
/// Time without a change after which the task of a claim is taken for dead.
const DEAD_AFTER: Duration = Duration::from_mins(1);
/// Time between two looks at pieces that others run.
const LOOK_EVERY: Duration = Duration::from_millis(200);

/// A reproduction as the work of a campaign.
#[derive(Clone, Debug)]
pub struct Shards<'a>(pub &'a Reproduction);

/// What the pieces are about.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Question {
    seed: u64,
    budget: Budget,
    lungs: Vec<BenchConfig>,
    only: Vec<Experiment>,
}

/// The pieces that are done; their results are in the reproduction's folder.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(transparent)]
pub struct Pieces(BTreeSet<u64>);

impl Sums for Pieces {
    type Unit = ();

    fn add(&mut self, number: u64, (): ()) {
        self.0.insert(number);
    }

    fn absorb(&mut self, other: Self) {
        self.0.extend(other.0);
    }
}

impl Shards<'_> {
    /// Number of pieces.
    pub fn pieces(&self) -> u64 {
        self.places(&Study::unclaimed(self.0, &Progress::silent())).len() as u64
    }

    /// Group, experiment and number within the experiment of every piece, in order.
    fn places(&self, study: &Study<'_>) -> Vec<(usize, Experiment, usize)> {
        let groups = Experiment::GROUPS.iter().enumerate();
        let experiments =
            groups.flat_map(|(group, list)| list.iter().map(move |experiment| (group, *experiment)));
        let chosen = experiments.filter(|(_, experiment)| experiment.runs_for(&self.0.only));
        chosen
            .flat_map(|(group, experiment)| {
                (0..experiment.count(study)).map(move |number| (group, experiment, number))
            })
            .collect()
    }

    /// Runs a piece, unless it is done, once all earlier groups are done.
    fn run(&self, number: usize, study: &Study<'_>, claims: &Claims) -> Result<()> {
        let places = self.places(study);
        let (own_group, ..) = places[number];
        let earlier = |group: usize| (0..places.len()).filter(|other| places[*other].0 == group).collect();
        for group in 0..own_group {
            complete(earlier(group), &places, study, claims)?;
        }
        complete(vec![number], &places, study, claims)
    }
}

/// Runs the pieces with these numbers, and waits for those that others run.
fn complete(
    mut open: Vec<usize>,
    places: &[(usize, Experiment, usize)],
    study: &Study<'_>,
    claims: &Claims,
) -> Result<()> {
    loop {
        let mut waiting = Vec::new();
        for number in open {
            if study.progress.stopped() {
                return Err(StudyError::Stopped);
            }
            let (_, experiment, place) = places[number];
            let name = format!("{experiment:?}-{place}").to_lowercase();
            match claims.take(&name)? {
                State::Done => {}
                State::Others => waiting.push(number),
                State::Mine => {
                    let outcome = experiment.pieces(study).and_then(|pieces| pieces[place]());
                    claims.release(&name, outcome.is_ok())?;
                    outcome?;
                }
            }
        }
        if waiting.is_empty() {
            return Ok(());
        }
        open = waiting;
        std::thread::sleep(LOOK_EVERY);
    }
}

impl Work for Shards<'_> {
    type Question = Question;
    type Sums = Pieces;
    type Error = StudyError;

    fn question(&self) -> Question {
        let Reproduction { seed, budget, lungs, only, .. } = self.0;
        Question { seed: *seed, budget: budget.clone(), lungs: lungs.clone(), only: only.clone() }
    }

    fn nothing(&self) -> Pieces {
        Pieces::default()
    }

    fn stage(&self) -> (Stage, f64) {
        (Stage::Pieces, 1.0)
    }

    fn unit(&self, number: u64, task: &Task<'_>) -> Result<Option<()>> {
        let progress = task.quiet();
        let study = Study::new(self.0, &progress)?;
        let claims = Claims::new(&self.0.out.join("shards/claims"), DEAD_AFTER);
        let ended = AtomicBool::new(false);
        let outcome = std::thread::scope(|scope| {
            scope.spawn(|| claims.renew_until(&ended));
            let _ends = Ends(&ended);
            self.run(number as usize, &study, &claims)
        });
        match outcome {
            Err(StudyError::Stopped) => Ok(None),
            outcome => {
                outcome?;
                task.advance(1);
                Ok(Some(()))
            }
        }
    }
}

/// Who has a piece.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum State {
    Done,
    /// Another task runs it.
    Others,
    /// It was open, and is now claimed.
    Mine,
}

/// The claims of a task. The file of a claim contains who holds it and how often it was renewed. The clocks of two machines may differ,
/// so a claim counts as old when it has not changed for a while by the clock of the one who looks.
struct Claims {
    folder: PathBuf,
    /// Distinguishes this task from all others.
    owner: u64,
    held: Mutex<BTreeMap<PathBuf, u64>>,
    /// Content of each claim that another task holds, and when it was first seen.
    seen: Mutex<BTreeMap<PathBuf, (String, Instant)>>,
    /// Age at which the task of a claim is taken for dead.
    dead_after: Duration,
}

impl Claims {
    fn new(folder: &Path, dead_after: Duration) -> Self {
        let owner = RandomState::new().build_hasher().finish();
        let (held, seen) = (Mutex::default(), Mutex::default());
        Self { folder: folder.to_owned(), owner, held, seen, dead_after }
    }

    fn done(&self, piece: &str) -> PathBuf {
        self.folder.join(format!("{piece}.done"))
    }

    /// Claims a piece if it is open.
    fn take(&self, piece: &str) -> Result<State> {
        let path = self.folder.join(piece);
        if self.done(piece).exists() {
            return Ok(State::Done);
        }
        fs::create_dir_all(&self.folder).map_err(StudyError::file(&self.folder))?;
        match File::create_new(&path) {
            Ok(_) => {}
            Err(error) if error.kind() == io::ErrorKind::AlreadyExists => {
                if !self.is_old(&path)? {
                    return Ok(State::Others);
                }
            }
            Err(error) => return Err(StudyError::file(&path)(error)),
        }
        self.write(&path, 0).map_err(StudyError::file(&path))?;
        if !self.is_mine(&path) {
            // Another task has taken the same old claim.
            return Ok(State::Others);
        }
        locked(&self.held).insert(path, 0);
        Ok(State::Mine)
    }

    /// Whether the claim of another task has not changed for long.
    fn is_old(&self, path: &Path) -> Result<bool> {
        let now = match fs::read_to_string(path) {
            Ok(text) => text,
            // It was released just now: the next look finds the piece done or open.
            Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(false),
            Err(error) => return Err(StudyError::file(path)(error)),
        };
        let mut seen = locked(&self.seen);
        match seen.get(path) {
            Some((before, since)) if *before == now => Ok(since.elapsed() >= self.dead_after),
            _ => {
                seen.insert(path.to_owned(), (now, Instant::now()));
                Ok(false)
            }
        }
    }

    fn write(&self, path: &Path, renewals: u64) -> io::Result<()> {
        write_atomically(path, format!("{:016x} {renewals}", self.owner).as_bytes())
    }

    fn is_mine(&self, path: &Path) -> bool {
        let owner = format!("{:016x} ", self.owner);
        fs::read_to_string(path).is_ok_and(|text| text.starts_with(&owner))
    }

    /// Marks a piece as done, if it is, and gives its claim back.
    fn release(&self, piece: &str, done: bool) -> Result<()> {
        let (path, mark) = (self.folder.join(piece), self.done(piece));
        locked(&self.held).remove(&path);
        if done {
            write_atomically(&mark, b"").map_err(StudyError::file(&mark))?;
        }
        if self.is_mine(&path) {
            // A claim that stays grows old.
            let _ = fs::remove_file(path);
        }
        Ok(())
    }

    /// Renews the claims until the work ends.
    fn renew_until(&self, ended: &AtomicBool) {
        let mut renewed = Instant::now();
        while !ended.load(Ordering::Relaxed) {
            std::thread::sleep(LOOK_EVERY);
            if renewed.elapsed() >= RENEW_EVERY {
                renewed = Instant::now();
                for (path, renewals) in locked(&self.held).iter_mut() {
                    *renewals += 1;
                    // Without it the claim grows old and the piece is run twice, to the same result.
                    let _ = self.write(path, *renewals);
                }
            }
        }
    }
}

fn locked<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Says that work has ended, even if it has panicked.
struct Ends<'a>(&'a AtomicBool);

impl Drop for Ends<'_> {
    fn drop(&mut self) {
        self.0.store(true, Ordering::Relaxed);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_piece_has_one_task_until_it_is_released_or_its_claim_is_old() {
        let folder = tempfile::tempdir().unwrap();
        let claims = |dead_after| Claims::new(folder.path(), dead_after);
        let [one, other] = [claims(DEAD_AFTER), claims(DEAD_AFTER)];
        assert_eq!((one.take("iso-0").unwrap(), other.take("iso-0").unwrap()), (State::Mine, State::Others));
        assert_eq!(other.take("iso-0").unwrap(), State::Others);
        one.release("iso-0", false).unwrap();
        assert_eq!(other.take("iso-0").unwrap(), State::Mine);
        let impatient = claims(Duration::ZERO);
        assert_eq!(impatient.take("iso-0").unwrap(), State::Others, "it is seen for the first time");
        assert_eq!(impatient.take("iso-0").unwrap(), State::Mine, "it has not changed: its task was killed");
        other.release("iso-0", false).unwrap();
        assert_eq!(one.take("iso-0").unwrap(), State::Others, "nobody releases the claim of another");
        impatient.release("iso-0", true).unwrap();
        assert_eq!((one.take("iso-0").unwrap(), other.take("iso-0").unwrap()), (State::Done, State::Done));
    }

    #[test]
    fn the_claim_of_a_running_piece_changes() {
        let folder = tempfile::tempdir().unwrap();
        let claims = Claims::new(folder.path(), DEAD_AFTER);
        assert_eq!(claims.take("iso-0").unwrap(), State::Mine);
        let text = || fs::read_to_string(folder.path().join("iso-0")).unwrap();
        let (before, ended) = (text(), AtomicBool::new(false));
        std::thread::scope(|scope| {
            scope.spawn(|| claims.renew_until(&ended));
            std::thread::sleep(RENEW_EVERY + 3 * LOOK_EVERY);
            ended.store(true, Ordering::Relaxed);
        });
        assert_ne!(text(), before);
    }
}
