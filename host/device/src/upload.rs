//! Uploads a weights image, or the description of a bench to a device that simulates one.

use progress::{Progress, Stage};
use shared::checksum::crc32;
use shared::link::messages::{CHUNK_BYTES, Request, Response};
use shared::link::refusal::Refusal;
use shared::weights::slots::Slot;
use shared::weights::{IMAGE_BYTES, WeightsError, decode};
use thiserror::Error;

use super::answers::unexpected;
use super::{Device, DeviceError};

/// Sending weights: bytes.
pub const UPLOAD: Stage = Stage("send weights, bytes");

/// Number of chunks in a row that may leave an upload where it is, for example after a reconnection.
const STANDSTILLS: usize = 8;

/// Why an upload failed.
#[derive(Debug, Error)]
pub enum UploadError {
    /// The image is not valid; nothing was sent.
    #[error(transparent)]
    Image(#[from] WeightsError),
    /// The device did not accept the image.
    #[error(transparent)]
    Device(#[from] DeviceError),
}

/// Weights stored on a device.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Uploaded {
    /// The image's id.
    pub id: u32,
    /// The slot that contains it.
    pub slot: Slot,
}

impl Device {
    /// Uploads and stores an image; it runs after the next restart. An upload that was interrupted or stopped continues
    /// where it stopped: the device collects the bytes in memory and writes a slot only when it has all of them.
    ///
    /// # Errors
    /// [`UploadError`]; the running weights stay. A request to stop is [`DeviceError::Stopped`].
    pub fn upload(&mut self, image: &[u8], progress: &Progress<'_>) -> Result<Uploaded, UploadError> {
        let id = decode(image)?.id;
        self.transfer(&image[..IMAGE_BYTES], id, progress)?;
        match self.request(&Request::CommitWeights)? {
            Response::Weights { id: stored, slot } if stored == id => Ok(Uploaded { id, slot }),
            other => Err(unexpected(&Request::CommitWeights, &other).into()),
        }
    }

    /// Makes a device on the desk simulate the bench of this description (`BenchConfig::to_bytes` in the crate `bench`) from now on.
    ///
    /// # Errors
    /// A device that refuses it, or cannot be reached.
    pub fn set_bench(&mut self, description: &[u8]) -> Result<(), DeviceError> {
        self.transfer(description, crc32(description), &Progress::silent())?;
        match self.request(&Request::CommitBench)? {
            Response::Done => Ok(()),
            other => Err(unexpected(&Request::CommitBench, &other)),
        }
    }

    /// Sends the bytes of an upload with this id.
    fn transfer(&mut self, content: &[u8], id: u32, progress: &Progress<'_>) -> Result<(), DeviceError> {
        let begin = Request::BeginWeights { length: content.len() as u32, id };
        let mut offset = self.progress_of(&begin)?;
        let task = progress.task(UPLOAD, content.len());
        let (mut farthest, mut standstills) = (offset, 0);
        while offset < content.len() {
            task.reach(offset);
            if task.stopped() {
                return Err(DeviceError::Stopped);
            }
            let end = content.len().min(offset + CHUNK_BYTES);
            let bytes = content[offset..end].iter().copied().collect();
            let chunk = Request::WeightsChunk { offset: offset as u32, bytes };
            offset = match self.progress_of(&chunk) {
                // The device knows what it has received, for example after a reconnection.
                Err(DeviceError::Refused(Refusal::WrongOffset { expected })) => expected as usize,
                other => other?,
            };
            standstills = if offset > farthest { 0 } else { standstills + 1 };
            if standstills > STANDSTILLS {
                return Err(DeviceError::Stuck(offset));
            }
            farthest = farthest.max(offset);
        }
        task.reach(offset);
        Ok(())
    }

    fn progress_of(&mut self, request: &Request) -> Result<usize, DeviceError> {
        match self.request(request)? {
            Response::Progress { offset } => Ok(offset as usize),
            other => Err(unexpected(request, &other)),
        }
    }
}
