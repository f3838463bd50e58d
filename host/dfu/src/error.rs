//! Why a board cannot be flashed by USB, and what to do.

use thiserror::Error;

/// Why flashing by USB has ended.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum DfuError {
    /// The release says that the board has no USB.
    #[error("the board {0} has no USB: flash it with a debug probe (docs/HARDWARE.md)")]
    NoUsb(String),
    /// The device is no boot loader for a chip's flash.
    #[error("the USB device describes no flash ({0:?}): hold BOOT0 high while you reset the board")]
    NoFlash(String),
    /// The chip has another flash than the firmware's.
    #[error(
        "this is the firmware of another board: its chip {chip} has {expected} KiB of flash, the connected one {found}. Take the file of the connected board"
    )]
    OtherChip {
        /// The firmware's chip.
        chip: String,
        /// Its flash.
        expected: u32,
        /// The flash of the connected chip.
        found: u32,
    },
    /// A part of the firmware is outside the flash.
    #[error(
        "the firmware does not fit: the chip has no flash at {0:#010x}. Take the file of the connected board"
    )]
    Outside(u32),
    /// The USB device is gone.
    #[error(
        "the board does not answer any more: connect it again with BOOT0 high and repeat. Its boot loader is in ROM and cannot be damaged"
    )]
    Gone,
    /// The chip is read-protected.
    #[error("the chip is read-protected: set RDP to 0xAA, which erases it (docs/HARDWARE.md), and repeat")]
    ReadProtected,
    /// The boot loader refuses to erase or write.
    #[error(
        "the chip refuses address {address:#010x} (DFU status {status}): set all bits of nWRP to 1 (docs/HARDWARE.md) and repeat"
    )]
    Refused {
        /// Where.
        address: u32,
        /// The status of the standard DFU.
        status: u8,
    },
    /// Flash does not have what was written.
    #[error(
        "flash at {0:#010x} is not what was written: set all bits of nWRP to 1 (docs/HARDWARE.md) and repeat; if that does not help, its flash is worn out"
    )]
    Differs(u32),
    /// The device does not keep to the protocol.
    #[error("the boot loader does not get ready (DFU state {0}): reset the board with BOOT0 high and repeat")]
    State(u8),
}
