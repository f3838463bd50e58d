//! Measures a unit that this program runs, as a [`Source`].

use progress::{Progress, Stage};
use thiserror::Error;
use ventilator::{Source, SourceError};

use super::measurement::{Ended, Measured, Measurement, Plan, PlanError};

/// Measuring a loop: breaths.
pub const BREATHS: Stage = Stage("measure the loop, breaths");

/// Why a loop cannot be measured.
#[derive(Debug, Error)]
pub enum MeasureError {
    /// The plan is refused.
    #[error(transparent)]
    Plan(#[from] PlanError),
    /// The source failed before a frequency was complete.
    #[error(transparent)]
    Source(#[from] SourceError),
}

/// Measures a source under the controller that it runs. A request to stop takes effect after a breath.
///
/// # Errors
/// A plan that is refused, or a source that fails before a frequency is complete.
pub fn measure<C>(
    source: &mut dyn Source<C>,
    plan: &Plan,
    progress: &Progress<'_>,
) -> Result<Measured, MeasureError> {
    let mut measurement = Measurement::new(*plan, source.period_us())?;
    source.sweep(Some(measurement.sweep_from(0)))?;
    source.upcoming(&vec![plan.settings; plan.breaths() as usize])?;
    let task = progress.task(BREATHS, plan.breaths() as usize);
    let mut ended = None;
    while ended.is_none() && !measurement.is_complete() {
        if task.stopped() {
            ended = Some(Ended::Stopped);
            break;
        }
        let mut samples = Vec::new();
        ended = match source.breath(&plan.settings, &mut |tick| samples.push(tick.sample)) {
            Ok(()) => match measurement.take(samples) {
                Ok(ended) => ended,
                Err(refused) => {
                    source.sweep(None)?;
                    return Err(refused.into());
                }
            },
            Err(SourceError::Fault { fault, .. }) => Some(Ended::Alarm(format!("{fault:?}"))),
            Err(error) if !measurement.has_result() => return Err(error.into()),
            Err(error) => Some(Ended::Failed(error.to_string())),
        };
        if ended.is_none() {
            task.advance(1);
        }
    }
    // Of a source that has failed, nothing can be asked.
    if !matches!(ended, Some(Ended::Failed(_))) {
        source.sweep(None)?;
    }
    Ok(measurement.finished(ended))
}
