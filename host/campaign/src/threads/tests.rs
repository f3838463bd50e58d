//! Pieces of work, counted.

use super::*;
use std::sync::atomic::{AtomicUsize, Ordering};

#[test]
fn every_piece_runs_once_and_may_change_what_it_works_on() {
    let mut runs = [0; 20];
    on_threads(3, runs.iter_mut(), |run| {
        *run += 1;
        Ok::<_, ()>(())
    })
    .unwrap();
    assert_eq!(runs, [1; 20]);
}

#[test]
fn no_piece_is_begun_after_a_failure_and_the_first_one_is_told() {
    let begun = AtomicUsize::new(0);
    let failed = on_threads(4, 0..100, |piece| {
        begun.fetch_add(1, Ordering::Relaxed);
        Err::<(), _>(piece)
    });
    assert_eq!(failed, Err(0));
    assert!(begun.load(Ordering::Relaxed) <= 4);
}
