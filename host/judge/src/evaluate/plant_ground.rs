//! A plant behind the plant link as a ground for tuning.

use std::sync::{Mutex, MutexGuard, PoisonError};

use plant::link::PlantError;
use progress::Watch;
use shared::control::Controller;
use ventilator::{PlantSource, Source, SourceError};

use super::{Evaluation, Ground, Plan, evaluate_source};

/// A plant that is tuned on: one evaluation after the other, each from rest.
pub struct PlantGround(Mutex<PlantSource>);

impl PlantGround {
    /// All evaluations run at the source's control period.
    pub fn new(source: PlantSource) -> Self {
        Self(Mutex::new(source))
    }

    fn source(&self) -> MutexGuard<'_, PlantSource> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Ground for PlantGround {
    fn name(&self) -> String {
        self.source().plant()
    }

    fn evaluate(&self, controller: &Controller, plan: &Plan) -> Result<Evaluation, SourceError> {
        let mut source = self.source();
        let own = source.period_us();
        if own != plan.period_us {
            return Err(PlantError::other_period(plan.period_us, own).into());
        }
        evaluate_source(&mut *source, controller, plan, &Watch::silent())
    }
}
