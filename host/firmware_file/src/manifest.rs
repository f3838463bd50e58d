//! What a release file says about itself.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use crate::error::PackageError;

/// The chips of the boards, as probe-rs names them. An image for the desk, `BOARD-desk`, has the chip of its board.
const CHIPS: [(&str, &str); 2] = [("stm32f405", "STM32F405RG"), ("stm32f446", "STM32F446RETx")];

/// The chip of a board, as probe-rs names it; none for an unknown board.
pub fn chip_of(board: &str) -> Option<&'static str> {
    let name = board.strip_suffix("-desk").unwrap_or(board);
    CHIPS.iter().find(|(board, _)| *board == name).map(|(_, chip)| *chip)
}

/// The entry `manifest.json`.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Manifest {
    /// Version of the format, [`FORMAT`](crate::FORMAT).
    pub format: u32,
    /// What the firmware is.
    pub firmware: Firmware,
    /// Length and checksum of every file, by name.
    pub files: BTreeMap<String, Stamp>,
}

/// What a firmware is, and where it goes.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Firmware {
    /// Version of the release.
    pub version: String,
    /// Revision of the source, as git names it.
    pub revision: String,
    /// Board and image, for example `stm32f405` or `stm32f446-desk`.
    pub board: String,
    /// The chip, as probe-rs names it.
    pub chip: String,
    /// What the image is, in a sentence for people.
    pub image: String,
    /// Whether the chip's boot loader takes the firmware by USB (DFU) on this board.
    pub usb_dfu: bool,
    /// What goes into flash, in the order in which it is written.
    pub parts: Vec<Part>,
}

/// A file that goes into flash as it is.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Part {
    /// What it is.
    pub content: Content,
    /// Name of the file.
    pub file: String,
    /// Where it begins in the chip's memory.
    pub address: u32,
    /// Its length.
    pub bytes: u32,
}

/// What a part is. A program with a gap, in which weights are, has a part before and one behind the gap.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Content {
    /// The program.
    Program,
    /// A weights slot.
    Weights,
}

/// Length and checksum of a file.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Stamp {
    /// Length in bytes.
    pub bytes: u64,
    /// SHA-256 in hexadecimal.
    pub sha256: String,
}

impl Manifest {
    /// Checks that the parts are whole files of the archive and do not overlap.
    pub(crate) fn check(&self) -> Result<(), PackageError> {
        let parts = &self.firmware.parts;
        let wrong = |part: &Part| PackageError::Part(part.file.clone());
        for part in parts {
            let stamp = self.files.get(&part.file).ok_or_else(|| PackageError::Missing(part.file.clone()))?;
            if part.bytes == 0 || stamp.bytes != u64::from(part.bytes) {
                return Err(wrong(part));
            }
        }
        let blocks: Vec<_> = parts.iter().map(|part| (part.address, part.bytes)).collect();
        match overlapping(&blocks) {
            Some(index) => Err(wrong(&parts[index])),
            None => Ok(()),
        }
    }
}

/// Index of a block of memory (address, bytes) that overlaps an earlier one or leaves the address space.
pub(crate) fn overlapping(blocks: &[(u32, u32)]) -> Option<usize> {
    let end = |(address, bytes): (u32, u32)| u64::from(address) + u64::from(bytes);
    let start = |block: (u32, u32)| u64::from(block.0);
    let overlap = |block, other| start(block) < end(other) && start(other) < end(block);
    blocks.iter().enumerate().position(|(index, block)| {
        end(*block) > u64::from(u32::MAX) || blocks[..index].iter().any(|other| overlap(*block, *other))
    })
}
