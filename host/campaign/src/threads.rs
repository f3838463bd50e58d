//! Independent pieces of work on several threads.

use std::sync::{Mutex, MutexGuard, PoisonError};

/// Does all pieces of work on this number of threads. The pieces begin in their order.
///
/// # Errors
/// That of the first piece, in their order, that failed: it is the same on any number of threads. No further piece begins after a
/// failure, and those under way are completed.
pub fn on_threads<P: Send, E: Send>(
    threads: usize,
    pieces: impl Iterator<Item = P> + Send,
    work: impl Fn(P) -> Result<(), E> + Sync,
) -> Result<(), E> {
    let (pieces, failure) = (Mutex::new(pieces.enumerate()), Mutex::new(None::<(usize, E)>));
    let worker = || {
        while locked(&failure).is_none() {
            let Some((place, piece)) = locked(&pieces).next() else { break };
            if let Err(error) = work(piece) {
                let mut failure = locked(&failure);
                if failure.as_ref().is_none_or(|(first, _)| place < *first) {
                    *failure = Some((place, error));
                }
            }
        }
    };
    // Threads of their own: one of rayon's pool would begin another piece while it waits for parts of its own.
    std::thread::scope(|scope| {
        for _ in 0..threads {
            scope.spawn(worker);
        }
    });
    failure.into_inner().unwrap_or_else(PoisonError::into_inner).map_or(Ok(()), |(_, error)| Err(error))
}

/// Locks data that stays whole even if another thread has panicked.
pub(crate) fn locked<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

#[cfg(test)]
mod tests;
