//! Why a virtual board does not run.

use std::io;
use std::path::PathBuf;
use std::process::ExitStatus;

use thiserror::Error;

/// Bytes of both weights slots together.
pub const FLASH_BYTES: usize = shim::flash::SLOTS_BYTES as usize;
/// Name of the program.
pub(crate) const PROGRAM: &str = "qemu-system-arm";
/// Older ones lack the core-coupled memory and the serial port's interrupts.
pub(crate) const LEAST_VERSION: u32 = 10;

/// Why a virtual board does not run.
#[derive(Debug, Error)]
#[expect(missing_docs, reason = "the message names every field")]
pub enum EmulatorError {
    /// QEMU is not there.
    #[error("{program} is missing; run: cargo xtask setup", program = PROGRAM)]
    QemuMissing,
    /// QEMU is too old.
    #[error("{program} is {0}, it must be {least} or newer; run: cargo xtask setup", program = PROGRAM, least = LEAST_VERSION)]
    QemuTooOld(String),
    /// An image is not there, or is none.
    #[error("{} is no ELF image; run: cargo xtask firmware", .0.display())]
    ImageMissing(PathBuf),
    /// The flash has the wrong size.
    #[error("the initial flash has {0} bytes; both slots together have {FLASH_BYTES}")]
    FlashSize(usize),
    /// Another board runs in the folder.
    #[error("a board is running in {} already; give each its own folder", .0.display())]
    FolderInUse(PathBuf),
    /// The link's port is taken.
    #[error("port {port} cannot be opened for the link ({error}); choose another, or 0 for any")]
    Port { port: u16, error: io::Error },
    /// QEMU ended before the firmware was started.
    #[error("QEMU ended at its start, {status}:\n{log}")]
    Ended { status: ExitStatus, log: String },
    /// The shim did not report.
    #[error("the shim did not start; are {} and {} made for each other? QEMU said:\n{log}", firmware.display(), shim.display())]
    Silent { firmware: PathBuf, shim: PathBuf, log: String },
    /// Files, pipes or processes.
    #[error("{what}: {error}")]
    Io { what: &'static str, error: io::Error },
}

/// Names what was tried when it failed.
pub(crate) fn tried(what: &'static str) -> impl FnOnce(io::Error) -> EmulatorError {
    move |error| EmulatorError::Io { what, error }
}
