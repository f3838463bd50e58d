//! Signing of weights images.

use std::path::PathBuf;
use std::time::{SystemTime, UNIX_EPOCH};

use anyhow::Context;
use device::keys::PrivateKey;
use shared::weights::IMAGE_BYTES;

/// The choice of a key.
#[derive(Debug, clap::Args)]
pub struct KeyArgs {
    /// Sign the weights image with this private key, made by `trainer keys`
    #[arg(long, value_name = "FILE")]
    pub key: Option<PathBuf>,
}

impl KeyArgs {
    /// Checks, before the work begins, that the key can be read.
    ///
    /// # Errors
    /// A key that cannot be read.
    pub fn check(&self) -> anyhow::Result<()> {
        self.key.as_deref().map_or(Ok(()), |file| Ok(PrivateKey::load(file).map(drop)?))
    }

    /// The image, signed if there is a key; its version is the time, so that a device takes it for newer than any before.
    ///
    /// # Errors
    /// A key that cannot be read, or no version for the image.
    pub fn signed(&self, image: Vec<u8>) -> anyhow::Result<Vec<u8>> {
        self.signed_as(image, None)
    }

    /// The same, with this version if there is one.
    ///
    /// # Errors
    /// The same.
    pub fn signed_as(&self, mut image: Vec<u8>, version: Option<u32>) -> anyhow::Result<Vec<u8>> {
        let Some(file) = &self.key else { return Ok(image) };
        let key = PrivateKey::load(file)?;
        let image_bytes: &mut [u8; IMAGE_BYTES] =
            image.first_chunk_mut().context("the weights image is too short to sign")?;
        key.sign(image_bytes, version.map_or_else(seconds_since_1970, Ok)?);
        Ok(image)
    }
}

fn seconds_since_1970() -> anyhow::Result<u32> {
    let now = SystemTime::now().duration_since(UNIX_EPOCH).context("the clock is before 1970")?;
    u32::try_from(now.as_secs()).context("the clock is beyond the year 2106")
}
