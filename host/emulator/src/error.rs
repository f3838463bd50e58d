//! Errors of the virtual board.

use std::io;
use std::net::SocketAddr;
use std::path::PathBuf;
use std::process::ExitStatus;

use thiserror::Error;

/// Number of bytes of the changeable sectors of the flash: the calibrations, both copies of the
/// flight recorder, then both weights slots.
pub const FLASH_BYTES: usize = shim::flash::SLOTS_BYTES as usize;
/// Name of the program.
pub(crate) const PROGRAM: &str = "qemu-system-arm";
/// Older versions lack the core-coupled memory and the serial port's interrupts.
pub(crate) const LEAST_VERSION: u32 = 10;

/// Why a virtual board does not run.
#[derive(Debug, Error)]
#[expect(missing_docs, reason = "the message names every field")]
pub enum EmulatorError {
    /// QEMU is not installed.
    #[error("{program} is not installed; run: cargo xtask setup", program = PROGRAM)]
    QemuMissing,
    /// QEMU is too old.
    #[error("{program} has version {0} but must be {least} or newer; run: cargo xtask setup", program = PROGRAM, least = LEAST_VERSION)]
    QemuTooOld(String),
    /// An image is missing, or not an ELF file.
    #[error("{} is missing or not an ELF image; run: cargo xtask firmware", .0.display())]
    ImageMissing(PathBuf),
    /// The flash content has the wrong size.
    #[error("the initial flash has {0} bytes; it must have {FLASH_BYTES}, all changeable sectors together")]
    FlashSize(usize),
    /// Another board runs in the folder.
    #[error("a board is already running in {}: give each board its own folder", .0.display())]
    FolderInUse(PathBuf),
    /// The link's address is in use, or none of this machine.
    #[error("cannot listen at {address} ({error}): choose another port, or 0 for any free one")]
    Listen { address: SocketAddr, error: io::Error },
    /// QEMU ended before the firmware was started.
    #[error("QEMU ended during its start with {status}:\n{log}")]
    Ended { status: ExitStatus, log: String },
    /// The shim did not report its start.
    #[error("the shim did not start: check that {} and {} were built together. QEMU's output:\n{log}", firmware.display(), shim.display())]
    Silent { firmware: PathBuf, shim: PathBuf, log: String },
    /// An operation on files, pipes or processes failed.
    #[error("{what}: {error}")]
    Io { what: &'static str, error: io::Error },
}

/// Wraps an I/O error with the operation that failed.
pub(crate) fn tried(what: &'static str) -> impl FnOnce(io::Error) -> EmulatorError {
    move |error| EmulatorError::Io { what, error }
}
