//! Sessions with a unit: a unit that drops out is waited for, and continues where it was.

use std::time::{Duration, Instant};

use super::{FarmError, FarmRun, Worker};
use progress::Progress;
use ventilator::{PortSource, seeds};

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
        mut work: impl FnMut(&mut PortSource, u32) -> Result<T, FarmError>,
    ) -> Result<T, FarmError> {
        let (mut since, mut before) = (Instant::now(), steps());
        loop {
            if progress.stopped() {
                return Err(FarmError::Stopped);
            }
            let session = worker.folder.remember(|state| state.sessions += 1)?.sessions;
            let seed =
                seeds::collection(self.config.run.seed, self.number(worker) << 32 | u64::from(session));
            let done = worker.contact.source(worker.unit, seed).and_then(|mut source| {
                worker.recognise(source.calibration()?.as_ref())?;
                work(&mut source, session)
            });
            let error = match done {
                Err(error) if error.may_pass() => error,
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
