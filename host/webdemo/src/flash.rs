//! Flashing a board from the page: the release file is verified here, and the page carries out the transfers by USB.

use dfu::{DfuError, Failed, Session, Transfer};
use firmware_file::{Package, ReleaseKey, read};
use thiserror::Error;

/// Why the page cannot flash.
#[derive(Debug, Error)]
pub enum FlashError {
    /// There is no key.
    #[error("name the public key of the release: 64 hexadecimal digits, published with it")]
    NoKey,
    /// No UTF-8, no release file, or no release file before a step that needs one.
    #[error("choose the file of a release first")]
    NoFile,
    /// A file that is refused.
    #[error(transparent)]
    File(#[from] firmware_file::PackageError),
    /// Flashing has failed.
    #[error(transparent)]
    Dfu(#[from] DfuError),
}

/// A release file, and the course of flashing it.
#[derive(Default)]
pub struct Flash {
    package: Option<Package>,
    session: Option<Session>,
}

impl Flash {
    /// Verifies a release file and describes its firmware as JSON. The input is the key, or nothing for the built-in one, then a line
    /// break, then the file.
    ///
    /// # Errors
    /// Why the file is refused; it is not flashed then.
    pub fn open(&mut self, input: &[u8]) -> Result<String, FlashError> {
        *self = Self::default();
        let line = input.iter().position(|byte| *byte == b'\n').ok_or(FlashError::NoFile)?;
        let (key, file) = (&input[..line], &input[line + 1..]);
        let key = std::str::from_utf8(key).ok().and_then(|key| key.parse().ok());
        let package = read(file, &key.or_else(built_in).ok_or(FlashError::NoKey)?)?;
        dfu::check_usb(&package.manifest.firmware)?;
        let firmware = serde_json::to_string(&package.manifest.firmware).map_err(|_| FlashError::NoFile)?;
        self.package = Some(package);
        Ok(firmware)
    }

    /// Begins to flash the chip whose boot loader's interface has this name.
    ///
    /// # Errors
    /// A firmware for another chip, or none.
    pub fn begin(&mut self, interface: &str) -> Result<(), FlashError> {
        let package = self.package.as_ref().ok_or(FlashError::NoFile)?;
        self.session = Some(Session::new(package, interface)?);
        Ok(())
    }

    /// The next transfer.
    pub fn due(&mut self) -> Transfer {
        self.session.as_mut().map_or(Transfer::Done, Session::due)
    }

    /// Takes the result of that transfer.
    ///
    /// # Errors
    /// Why flashing ends here.
    pub fn took(&mut self, result: Result<&[u8], Failed>) -> Result<(), FlashError> {
        Ok(self.session.as_mut().ok_or(FlashError::NoFile)?.took(result)?)
    }

    /// Share of the steps that are done, from 0 to 1.
    pub fn share(&self) -> f64 {
        self.session.as_ref().map_or(0.0, |session| {
            let (done, all) = session.progress();
            done as f64 / all as f64
        })
    }
}

/// The key built into the module, if there is one.
pub fn built_in() -> Option<ReleaseKey> {
    ReleaseKey::built_in().ok().flatten()
}
