//! Why a device did not carry out a request.

use shared::breath::PERIOD_BOUNDS_US;
use shared::link::PROTOCOL;
use shared::link::refusal::Refusal;
use shared::settings::SettingsError;
use thiserror::Error;

use super::line::Heard;
use super::port::{Address, PortError};

/// Shortest and longest control period, microseconds.
pub(super) const SHORTEST_US: u32 = PERIOD_BOUNDS_US.0;
pub(super) const LONGEST_US: u32 = PERIOD_BOUNDS_US.1;

/// Why a device did not carry out a request.
#[derive(Debug, Error)]
pub enum DeviceError {
    /// The port cannot be opened.
    #[error(transparent)]
    Port(#[from] PortError),
    /// The device does not answer.
    #[error("{0} does not answer: check cable, power and firmware (`trainer flash board.elf` loads it)")]
    Silent(Address),
    /// The device sends, but no answer to what was asked.
    #[error(
        "{address} sends, but does not answer: {heard}; check the line's speed, and compare the device with docs/DEVICE_LINK.md"
    )]
    Babbles {
        /// The address.
        address: Address,
        /// What it has sent.
        heard: Heard,
    },
    /// The line broke.
    #[error("the connection to {0} was lost: reconnect the device and repeat the command")]
    Gone(Address),
    /// The device uses another version of the protocol.
    #[error("the device uses protocol {0}, but this program uses {PROTOCOL}: update the older side")]
    Protocol(u16),
    /// The device refused the request.
    #[error("the device refused: {0}")]
    Refused(#[from] Refusal),
    /// The user asked to stop.
    #[error("stopped; nothing on the device has changed: repeat the command to continue")]
    Stopped,
    /// The device does not know the request.
    #[error(
        "the device does not know the request {0}: update its firmware, or do without (docs/DEVICE_LINK.md lists what a small device leaves out)"
    )]
    Unknown(String),
    /// The answer does not belong to the request.
    #[error(
        "the device answers {request} with {response}: update the older side, or compare the device with docs/DEVICE_LINK.md"
    )]
    Unexpected {
        /// Name of the request.
        request: String,
        /// Name of the response.
        response: String,
    },
    /// An upload makes no progress.
    #[error(
        "the device asks for offset {0} of the image again and again: update its firmware, or compare the device with docs/DEVICE_LINK.md"
    )]
    Stuck(usize),
    /// The greeting has a control period that no ventilator of this project can have.
    #[error(
        "the device gives its control period as {0} us, allowed are {SHORTEST_US} to {LONGEST_US}: correct period_us in its greeting (docs/DEVICE_LINK.md)"
    )]
    Period(u32),
    /// The device reports settings that no ventilator of this project accepts.
    #[error(
        "the device reports impossible settings: {0}; compare their order and units with docs/DEVICE_LINK.md"
    )]
    Settings(SettingsError),
}
