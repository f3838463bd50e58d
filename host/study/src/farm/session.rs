//! Sessions with a unit: a unit that drops out is waited for, and continues where it was.

use std::time::{Duration, Instant};

use super::{FarmRun, Worker};
use crate::error::{Result, StudyError};
use device::DeviceError;
use device::upload::UploadError;
use progress::Progress;
use shared::link::refusal::Refusal;
use ventilator::collect::CollectError;
use ventilator::{PortSource, SourceError, seeds};

/// Pause before the next attempt to reach a unit.
const PAUSE: Duration = Duration::from_millis(500);

impl FarmRun<'_> {
    /// Connects to a unit and works with it until the work is done. If the unit drops out, connects again, for at most
    /// [`FarmRun::patience`] without any progress of the work; `steps` counts that.
    pub(super) fn persist<T>(
        &self,
        worker: &Worker<'_>,
        progress: &Progress<'_>,
        steps: &dyn Fn() -> usize,
        mut work: impl FnMut(&mut PortSource, u32) -> Result<T>,
    ) -> Result<T> {
        let (mut since, mut before) = (Instant::now(), steps());
        loop {
            if progress.stopped() {
                return Err(StudyError::Stopped);
            }
            let session = worker.remember(|state| state.sessions += 1)?.sessions;
            let seed =
                seeds::collection(self.config.run.seed, self.number(worker) << 32 | u64::from(session));
            let done = worker.contact.source(worker.unit, seed).and_then(|mut source| {
                worker.recognise(source.calibration()?.as_ref())?;
                work(&mut source, session)
            });
            let error = match done {
                Err(error) if may_pass(&error) => error,
                done => return done,
            };
            if steps() > before {
                (since, before) = (Instant::now(), steps());
            }
            if since.elapsed() >= self.patience {
                return Err(error);
            }
            (self.tell)(&worker.unit.name, &format!("{error}; waiting for it"));
            std::thread::sleep(PAUSE);
        }
    }

    /// The number of a unit in the farm, from 0.
    pub(super) fn number(&self, worker: &Worker<'_>) -> u64 {
        self.farm.units.iter().take_while(|unit| unit.name != worker.unit.name).count() as u64
    }
}

/// Whether the unit may come back by itself, as after a loose plug.
fn may_pass(error: &StudyError) -> bool {
    let source = match error {
        StudyError::Source(source) | StudyError::Collect(CollectError::Source(source)) => source,
        StudyError::Upload(UploadError::Device(device)) | StudyError::Device(device) => {
            return device_may_return(device);
        }
        _ => return false,
    };
    match source {
        SourceError::Device(device) | SourceError::Upload(UploadError::Device(device)) => {
            device_may_return(device)
        }
        SourceError::Lost { .. } | SourceError::Silent { .. } => true,
        _ => false,
    }
}

/// Whether a device that failed so may come back by itself. The lease of a connection that broke lapses.
fn device_may_return(error: &DeviceError) -> bool {
    match error {
        DeviceError::Port(_)
        | DeviceError::Silent(_)
        | DeviceError::Babbles { .. }
        | DeviceError::Gone(_) => true,
        DeviceError::Refused(refusal) => matches!(refusal, Refusal::Lease { .. } | Refusal::NoLease),
        _ => false,
    }
}
