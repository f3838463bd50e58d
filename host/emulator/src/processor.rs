//! The processor of a board: both threads of QEMU run on one.
//!
//! QEMU's threads hand a lock to each other several times per byte on the link. On two processors each handover wakes a
//! processor, and a board takes half as much time again.

use std::sync::atomic::{AtomicUsize, Ordering};

/// Counts the boards of this process, so that each next one gets another processor.
static BOARDS: AtomicUsize = AtomicUsize::new(0);

/// Number of the processor for the next board, from those on which this process may run.
#[cfg(target_os = "linux")]
pub(super) fn next() -> usize {
    use nix::sched::{CpuSet, sched_getaffinity};
    use nix::unistd::Pid;

    let allowed = sched_getaffinity(Pid::from_raw(0)).unwrap_or_default();
    let allowed: Vec<_> =
        (0..CpuSet::count()).filter(|number| allowed.is_set(*number).unwrap_or(false)).collect();
    // Several processes do not begin with the same processor.
    let board = BOARDS.fetch_add(1, Ordering::Relaxed).wrapping_add(std::process::id() as usize);
    allowed.get(board % allowed.len().max(1)).copied().unwrap_or(0)
}

/// Number of the processor for the next board. Other systems have no command that would use it.
#[cfg(not(target_os = "linux"))]
pub(super) fn next() -> usize {
    BOARDS.fetch_add(1, Ordering::Relaxed)
}

#[cfg(all(test, target_os = "linux"))]
mod tests {
    use super::*;
    use nix::sched::{CpuSet, sched_getaffinity, sched_setaffinity};
    use nix::unistd::Pid;

    #[test]
    fn a_board_runs_where_its_process_may_run() {
        let before = sched_getaffinity(Pid::from_raw(0)).unwrap();
        let last = (0..CpuSet::count()).rfind(|number| before.is_set(*number).unwrap()).unwrap();
        let mut one = CpuSet::new();
        one.set(last).unwrap();
        sched_setaffinity(Pid::from_raw(0), &one).unwrap();
        assert_eq!([next(), next(), next()], [last; 3]);
    }

    #[test]
    fn all_processors_are_used_in_turn() {
        let allowed = sched_getaffinity(Pid::from_raw(0)).unwrap();
        let count = (0..CpuSet::count()).filter(|number| allowed.is_set(*number).unwrap()).count();
        // Other tests start boards in between.
        let used: std::collections::BTreeSet<_> = (0..100 * count).map(|_| next()).collect();
        assert_eq!(used.len(), count);
    }
}
