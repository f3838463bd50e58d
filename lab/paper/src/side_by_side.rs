//! Runs independent pieces of work side by side.
//!
//! Collecting, reinforcement learning and much of training run on one thread, and only part of the rest on all. With one piece for each
//! thread, all are busy.

use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Mutex, PoisonError};

use crate::error::Result;

/// A piece of work that uses the result of no other piece and keeps its own in the study's folder.
pub(super) type Piece<'a> = Box<dyn Fn() -> Result<()> + Send + Sync + 'a>;

/// A piece of work whose result is needed only in the folder.
pub(super) fn piece<'a, T>(work: impl Fn() -> Result<T> + Send + Sync + 'a) -> Piece<'a> {
    Box::new(move || work().map(drop))
}

/// Runs all pieces, as many at a time as there are threads, beginning in their order.
///
/// # Errors
/// That of the piece that failed first; no further piece is begun then, and those under way are completed.
pub(super) fn side_by_side(pieces: &[Piece<'_>]) -> Result<()> {
    let (next, failure) = (AtomicUsize::new(0), Mutex::new(None));
    let work = || {
        while let Some(piece) = pieces.get(next.fetch_add(1, Ordering::Relaxed)) {
            if let Err(error) = piece() {
                next.store(pieces.len(), Ordering::Relaxed);
                failure.lock().unwrap_or_else(PoisonError::into_inner).get_or_insert(error);
            }
        }
    };
    // Threads of their own: one of the pool's would begin another piece while it waits for parts of its own.
    std::thread::scope(|scope| {
        for _ in 0..rayon::current_num_threads().min(pieces.len()) {
            scope.spawn(work);
        }
    });
    failure.into_inner().unwrap_or_else(PoisonError::into_inner).map_or(Ok(()), Err)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::PaperError;

    #[test]
    fn every_piece_runs_once() {
        let runs: Vec<AtomicUsize> = (0..20).map(|_| AtomicUsize::new(0)).collect();
        let pieces: Vec<Piece<'_>> =
            runs.iter().map(|run| piece(|| Ok(run.fetch_add(1, Ordering::Relaxed)))).collect();
        side_by_side(&pieces).unwrap();
        assert!(runs.iter().all(|run| run.load(Ordering::Relaxed) == 1));
    }

    #[test]
    fn no_piece_is_begun_after_a_failure() {
        let begun = AtomicUsize::new(0);
        let pieces: Vec<Piece<'_>> = (0..100)
            .map(|_| {
                piece(|| {
                    begun.fetch_add(1, Ordering::Relaxed);
                    Err::<(), _>(PaperError::Stopped)
                })
            })
            .collect();
        assert!(matches!(side_by_side(&pieces), Err(PaperError::Stopped)));
        assert!(begun.load(Ordering::Relaxed) <= rayon::current_num_threads());
    }
}
