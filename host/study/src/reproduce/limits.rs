//! What no controller can beat on the lungs: how much of the way there a controller has gone.

use super::study::Study;
use crate::error::Result;
use judge::bound::{Bound, BoundConfig, bounds};

/// Searches the bound of every lung.
pub(super) fn limits(study: &Study<'_>) -> Result<Vec<Bound>> {
    study.keep("bound", || {
        let search = BoundConfig { seed: study.reproduction.seed, ..BoundConfig::default() };
        Ok(bounds(study.lungs(), &study.plan(), &search, &study.progress)?)
    })
}
