//! Flashing by USB: the protocol of the boot loader that every STM32 with USB has in ROM (DFU 1.1 with ST's extension, AN3156).
//!
//! A [`Session`] says which transfer comes next and takes its result. It touches no USB and no clock, so that the trainer runs it on
//! the machine's USB and the page, as WebAssembly, on the browser's.
#![forbid(unsafe_code)]

mod error;
mod layout;
mod session;

#[cfg(test)]
mod rom;

pub use error::DfuError;
pub use firmware_file::dfuse::{PRODUCT, VENDOR};
pub use layout::Layout;
pub use session::{Failed, Session, Transfer, check_usb, run};
