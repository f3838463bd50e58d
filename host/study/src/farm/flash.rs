//! Each unit gets a controller, which is read back.

use super::folder::Flashed;
use super::{FarmRun, Worker};
use crate::error::{Result, StudyError};
use learn::controller::learned::LearnedError;
use progress::Progress;
use shared::weights::{ImageId, decode};

impl FarmRun<'_> {
    /// Uploads the image that the crosswise evaluation has found best for this unit, restarts the device, and checks which weights it
    /// has loaded from its flash.
    pub(super) fn flash(
        &self,
        worker: &Worker<'_>,
        images: &[Option<Vec<u8>>],
        progress: &Progress<'_>,
    ) -> Result<()> {
        let Some(Some(image)) = images.get(self.number(worker) as usize) else { return Ok(()) };
        let trained = id_of(image)?;
        let mut device = worker.recognised()?;
        device.stop()?;
        let running = device.identify()?.running_id().map(|id| ImageId(id).to_string());
        let known = worker.state()?.weights;
        if known.is_some_and(|known| known.trained == trained && Some(known.stored) == running) {
            return Ok(());
        }
        let image = self.signed(image)?;
        let stored = id_of(&image)?;
        if running.as_ref() != Some(&stored) {
            device.upload(&image, &progress.of(worker.unit.name.as_str()))?;
            if device.restart()?.running_id().map(|id| ImageId(id).to_string()) != Some(stored.clone()) {
                return Err(StudyError::NotStored("weights"));
            }
        }
        worker.remember(|state| state.weights = Some(Flashed { trained, stored }))?;
        Ok(())
    }

    /// A signed image. Each upload needs its own, because a device with a key stores only newer ones.
    pub(super) fn signed(&self, image: &[u8]) -> Result<Vec<u8>> {
        (self.sign)(image.to_vec()).map_err(StudyError::Sign)
    }
}

/// The id of an image, as text.
pub(super) fn id_of(image: &[u8]) -> Result<String> {
    Ok(ImageId(decode(image).map_err(LearnedError::from)?.id).to_string())
}
