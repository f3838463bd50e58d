//! Each unit gets a controller, which is read back.

use super::{FarmError, FarmRun, Worker};
use learn::controller::learned::LearnedError;
use progress::Progress;
use shared::weights::decode;

impl FarmRun<'_> {
    /// Uploads the image that the crosswise evaluation has found best for this unit, restarts the device, and checks which weights it
    /// has loaded from its flash.
    pub(super) fn flash(
        &self,
        worker: &Worker<'_>,
        images: &[Option<Vec<u8>>],
        progress: &Progress<'_>,
    ) -> Result<(), FarmError> {
        let Some(Some(image)) = images.get(self.number(worker) as usize) else { return Ok(()) };
        let image = self.signed(image)?;
        let id = decode(&image).map_err(LearnedError::from)?.id;
        let mut device = worker.contact.device()?;
        device.stop()?;
        if device.identify()?.running_id() != Some(id) {
            device.upload(&image, &progress.of(worker.unit.name.as_str()))?;
            if device.restart()?.running_id() != Some(id) {
                return Err(FarmError::NotStored("weights"));
            }
        }
        worker.folder.remember(|state| state.weights_id = Some(format!("{id:08x}")))?;
        Ok(())
    }

    /// A signed image. Each upload needs its own, because a device with a key stores only newer ones.
    pub(super) fn signed(&self, image: &[u8]) -> Result<Vec<u8>, FarmError> {
        (self.sign)(image.to_vec()).map_err(FarmError::Sign)
    }
}
