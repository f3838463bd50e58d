//! What no controller can beat on the lungs: how much of the way there a controller has gone.

use std::sync::atomic::Ordering;

use super::study::Study;
use crate::StudyError;
use judge::bound::{Bound, BoundConfig, bounds};
use progress::Watch;

/// Searches the bound of every lung.
pub(super) fn limits(study: &Study<'_>) -> Result<Vec<Bound>, StudyError> {
    study.keep("bound", || {
        let progress = |done, total| (study.observer)("search the bound", done as usize, total as usize);
        let search = BoundConfig { seed: study.reproduction.seed, ..BoundConfig::default() };
        let watch = Watch::new(&progress, study.stop);
        let found = bounds(study.lungs(), &study.plan(), &search, &watch)?;
        if study.stop.load(Ordering::Relaxed) { Err(StudyError::Stopped) } else { Ok(found) }
    })
}

/// What the folder holds.
pub(super) fn kept(study: &Study<'_>) -> Result<Option<Vec<Bound>>, StudyError> {
    study.kept("bound")
}
