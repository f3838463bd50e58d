//! Claims on pieces of work that tasks share: files that a task renews every few seconds while it works on a piece.
//!
//! The claim of a task that was killed grows old, and another task takes the piece. A piece that two tasks take all the same, because
//! the first was only slow, is done twice, to the same result.

use std::collections::BTreeMap;
use std::fs::{self, File};
use std::hash::{BuildHasher, Hasher, RandomState};
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use crate::WorkspaceError;
use crate::threads::locked;
use data::files::write_atomically;

/// Time between two renewals of a claim.
const RENEW_EVERY: Duration = Duration::from_secs(5);
/// Time without a change after which the task of a claim is taken for dead.
const DEAD_AFTER: Duration = Duration::from_mins(1);

/// Who has a piece.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum State {
    /// It is done.
    Done,
    /// Another task works on it.
    Elsewhere,
    /// It was open, and is now claimed.
    Mine,
}

/// The claims of a task. The file of a claim contains who holds it and how often it was renewed. The clocks of two machines may differ,
/// so a claim counts as old when it has not changed for a while by the clock of the one who looks.
pub struct Claims {
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
    /// Time to wait before a piece that another task works on is looked at again.
    pub const LOOK_EVERY: Duration = Duration::from_millis(200);

    /// The claims in a folder, by a new owner.
    pub fn new(folder: &Path) -> Self {
        Self::with_patience(folder, DEAD_AFTER)
    }

    fn with_patience(folder: &Path, dead_after: Duration) -> Self {
        let owner = RandomState::new().build_hasher().finish();
        let (held, seen) = (Mutex::default(), Mutex::default());
        Self { folder: folder.to_owned(), owner, held, seen, dead_after }
    }

    /// Mark of a piece that is done, with a line for each time that it was worked on.
    fn done(&self, piece: &str) -> PathBuf {
        self.folder.join(format!("{piece}.done"))
    }

    /// Claims a piece if it is open.
    ///
    /// # Errors
    /// A folder that cannot be used.
    pub fn take(&self, piece: &str) -> Result<State, WorkspaceError> {
        let path = self.folder.join(piece);
        if self.done(piece).exists() {
            return Ok(State::Done);
        }
        fs::create_dir_all(&self.folder).map_err(WorkspaceError::file(&self.folder))?;
        match File::create_new(&path) {
            Ok(_) => {}
            Err(error) if error.kind() == io::ErrorKind::AlreadyExists => {
                if !self.is_old(&path)? {
                    return Ok(State::Elsewhere);
                }
            }
            Err(error) => return Err(WorkspaceError::file(&path)(error)),
        }
        self.write(&path, 0).map_err(WorkspaceError::file(&path))?;
        if !self.is_mine(&path) {
            // Another task has taken the same old claim.
            return Ok(State::Elsewhere);
        }
        locked(&self.held).insert(path, 0);
        if self.done(piece).exists() {
            // Its task has released it since the first look.
            self.release(piece, false)?;
            return Ok(State::Done);
        }
        Ok(State::Mine)
    }

    /// Whether the claim of another task has not changed for long.
    fn is_old(&self, path: &Path) -> Result<bool, WorkspaceError> {
        let now = match fs::read_to_string(path) {
            Ok(text) => text,
            // It was released just now: the next look finds the piece done or open.
            Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(false),
            Err(error) => return Err(WorkspaceError::file(path)(error)),
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
    ///
    /// # Errors
    /// A folder that cannot be used.
    pub fn release(&self, piece: &str, done: bool) -> Result<(), WorkspaceError> {
        let (path, mark) = (self.folder.join(piece), self.done(piece));
        locked(&self.held).remove(&path);
        if done {
            self.count(&mark).map_err(WorkspaceError::file(&mark))?;
        }
        if self.is_mine(&path) {
            // A claim that stays grows old.
            let _ = fs::remove_file(path);
        }
        Ok(())
    }

    /// Adds a line with the owner.
    fn count(&self, mark: &Path) -> io::Result<()> {
        let mut file = File::options().create(true).append(true).open(mark)?;
        file.write_all(format!("{:016x}\n", self.owner).as_bytes())?;
        file.sync_all()
    }

    /// Does some work, and renews the claims that are held meanwhile.
    pub fn renewed<T>(&self, work: impl FnOnce() -> T) -> T {
        let ended = AtomicBool::new(false);
        std::thread::scope(|scope| {
            scope.spawn(|| self.renew_until(&ended));
            let _ends = Ends(&ended);
            work()
        })
    }

    /// Renews the claims until the work ends.
    fn renew_until(&self, ended: &AtomicBool) {
        let mut renewed = Instant::now();
        while !ended.load(Ordering::Relaxed) {
            std::thread::sleep(Self::LOOK_EVERY);
            if renewed.elapsed() >= RENEW_EVERY {
                renewed = Instant::now();
                let mut held = locked(&self.held);
                // Another task may have taken a claim that was renewed too late.
                held.retain(|path, _| self.is_mine(path));
                for (path, renewals) in held.iter_mut() {
                    *renewals += 1;
                    // Without it the claim grows old and the piece is run twice, to the same result.
                    let _ = self.write(path, *renewals);
                }
            }
        }
    }
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
        let claims = |dead_after| Claims::with_patience(folder.path(), dead_after);
        let [one, other] = [claims(DEAD_AFTER), claims(DEAD_AFTER)];
        assert_eq!(
            (one.take("iso-0").unwrap(), other.take("iso-0").unwrap()),
            (State::Mine, State::Elsewhere)
        );
        assert_eq!(other.take("iso-0").unwrap(), State::Elsewhere);
        one.release("iso-0", false).unwrap();
        assert_eq!(other.take("iso-0").unwrap(), State::Mine);
        let impatient = claims(Duration::ZERO);
        assert_eq!(impatient.take("iso-0").unwrap(), State::Elsewhere, "it is seen for the first time");
        assert_eq!(impatient.take("iso-0").unwrap(), State::Mine, "it has not changed: its task was killed");
        other.release("iso-0", false).unwrap();
        assert_eq!(one.take("iso-0").unwrap(), State::Elsewhere, "nobody releases the claim of another");
        impatient.release("iso-0", true).unwrap();
        assert_eq!((one.take("iso-0").unwrap(), other.take("iso-0").unwrap()), (State::Done, State::Done));
        assert_eq!(fs::read_to_string(one.done("iso-0")).unwrap().lines().count(), 1, "it was done once");
    }

    #[test]
    fn the_claim_of_a_running_piece_changes() {
        let folder = tempfile::tempdir().unwrap();
        let claims = Claims::new(folder.path());
        assert_eq!(claims.take("iso-0").unwrap(), State::Mine);
        let text = || fs::read_to_string(folder.path().join("iso-0")).unwrap();
        let before = text();
        claims.renewed(|| std::thread::sleep(RENEW_EVERY + 3 * Claims::LOOK_EVERY));
        assert_ne!(text(), before);
    }
}
