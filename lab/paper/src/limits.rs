//! Reference bounds of the lungs, to show which part of the gap between PID and bound a controller closes.

use super::study::Study;
use score::bound::{Bound, BoundConfig, bounds};
use study::Result;

/// Searches the reference bound of every lung.
pub(super) fn limits(study: &Study<'_>) -> Result<Vec<Bound>> {
    study.keep("bound", || {
        let search = BoundConfig { seed: study.reproduction.seed, ..BoundConfig::default() };
        Ok(bounds(study.lungs(), &study.plan(), &search, &study.progress)?)
    })
}
