//! What an FMU runs: a bench and a controller, and where its library finds them.

use std::path::{Path, PathBuf};
use std::{fs, io};

use plant::bench::{BenchConfig, BenchError};
use shared::checksum::crc32;
use shared::weights::{Image, ImageId, WeightsError, decode};
use thiserror::Error;

/// Names of the resources.
pub const BENCH: &str = "bench.toml";
/// See [`BENCH`].
pub const CONTROLLER: &str = "controller.bin";

/// Why the resources of an FMU cannot be used.
#[derive(Debug, Error)]
pub enum ResourceError {
    /// The simulator gave no address of a folder.
    #[error(
        "{0} is no address of a folder: a simulator unpacks an FMU and gives a file: address of its resources"
    )]
    Address(String),
    /// A file cannot be read.
    #[error("cannot read {0}: {1}")]
    File(PathBuf, io::Error),
    /// The bench is not valid.
    #[error(transparent)]
    Bench(#[from] BenchError),
    /// The controller is not valid.
    #[error(transparent)]
    Weights(#[from] WeightsError),
}

/// Bench and controller.
#[derive(Clone, Debug)]
pub struct Resources {
    pub(crate) bench: BenchConfig,
    pub(crate) bench_text: String,
    pub(crate) image: Image,
    pub(crate) image_bytes: Vec<u8>,
}

impl Resources {
    /// Of a bench and a weights image.
    ///
    /// # Errors
    /// A weights image that is not valid.
    pub fn new(bench: &BenchConfig, image: &[u8]) -> Result<Self, ResourceError> {
        let bench_text = bench.to_toml();
        Ok(Self { bench: bench.clone(), bench_text, image: decode(image)?, image_bytes: image.to_vec() })
    }

    /// Of the folder at a `file:` address.
    ///
    /// # Errors
    /// Files that cannot be read or are not valid.
    pub fn at(address: &str) -> Result<Self, ResourceError> {
        let folder = folder(address).ok_or_else(|| ResourceError::Address(address.to_owned()))?;
        let read = |name: &str| {
            let path = folder.join(name);
            fs::read(&path).map_err(|error| ResourceError::File(path, error))
        };
        let bench_text = String::from_utf8_lossy(&read(BENCH)?).into_owned();
        let image_bytes = read(CONTROLLER)?;
        let (bench, image) = (BenchConfig::from_toml(&bench_text)?, decode(&image_bytes)?);
        Ok(Self { bench, bench_text, image, image_bytes })
    }

    /// The id of the controller's weights image.
    pub fn image_id(&self) -> u32 {
        self.image.id
    }

    /// Identifies the content, as the `guid` of the description.
    pub fn guid(&self) -> String {
        format!("{{eupnea-{}-{:08x}}}", ImageId(self.image.id), crc32(self.bench_text.as_bytes()))
    }
}

/// The folder at a `file:` address.
fn folder(address: &str) -> Option<PathBuf> {
    let path = address.strip_prefix("file:")?;
    // The name of a host, mostly empty.
    let path = path.strip_prefix("//").map_or(path, |rest| &rest[rest.find('/').unwrap_or(rest.len())..]);
    let path = decoded(path)?;
    let drive = path.strip_prefix('/').filter(|rest| rest.get(1..2) == Some(":"));
    let path = Path::new(drive.unwrap_or(&path)).to_owned();
    (!path.as_os_str().is_empty()).then_some(path)
}

/// Text without percent encoding.
fn decoded(text: &str) -> Option<String> {
    let mut pieces = text.split('%');
    let mut bytes = pieces.next().unwrap_or_default().as_bytes().to_vec();
    for piece in pieces {
        bytes.push(u8::from_str_radix(piece.get(..2)?, 16).ok()?);
        bytes.extend(piece[2..].bytes());
    }
    String::from_utf8(bytes).ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_address_of_any_form_leads_to_its_folder() {
        for (address, path) in [
            ("file:///data/a/resources", "/data/a/resources"),
            ("file:/data/a", "/data/a"),
            ("file://localhost/data/a", "/data/a"),
            ("file:///data/with%20blank/%C3%A9", "/data/with blank/é"),
            ("file:///C:/temp/a", "C:/temp/a"),
        ] {
            assert_eq!(folder(address), Some(PathBuf::from(path)), "{address}");
        }
        for address in
            ["http://example/a", "/data/a", "", "file:", "file:///a%2", "file:///a%zz", "file:///%ff"]
        {
            assert_eq!(folder(address), None, "{address}");
        }
    }
}
