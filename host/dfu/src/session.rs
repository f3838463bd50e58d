//! The transfers that flash a firmware and read it back.
//!
//! First all sectors are erased, then written from the last block to the first: a chip in which flashing was interrupted has no vector
//! table and starts no half program. Before each block its address is set, so that nothing depends on the boot loader's own length of
//! blocks. The session does not start the program, which would inherit the boot loader's clocks and interrupts: a reset does.

use std::collections::{BTreeSet, VecDeque};
use std::ops::Range;

use firmware_file::{Firmware, Package};

use crate::error::DfuError;
use crate::layout::Layout;

/// Requests of the standard DFU 1.1, table 3.2.
const DOWNLOAD: u8 = 1;
const UPLOAD: u8 = 2;
const GET_STATUS: u8 = 3;
const CLEAR_STATUS: u8 = 4;
const ABORT: u8 = 6;
/// States of the standard, table A.2.
const IDLE: u8 = 2;
const DOWNLOAD_SYNC: u8 = 3;
const DOWNLOAD_BUSY: u8 = 4;
const DOWNLOAD_IDLE: u8 = 5;
const ERROR: u8 = 10;
/// Status that ST's boot loader has for a read-protected chip: errVENDOR.
const VENDOR_ERROR: u8 = 11;
/// Commands in block 0 of a download (AN3156, section 5).
const SET_ADDRESS: u8 = 0x21;
const ERASE: u8 = 0x41;
/// Number of a block of data at the set address.
const DATA: u16 = 2;
/// Most bytes in a block.
const BLOCK: usize = 2048;
/// Length of a status.
const STATUS_BYTES: u16 = 6;
/// Longest time for one erase or write, ms: a sector of 128 KiB takes at most 4 s (DS8626, table 40).
const LONGEST_MS: u32 = 30_000;
/// Attempts to get the boot loader ready.
const ATTEMPTS: u8 = 3;

/// What comes next: a control transfer of class and interface, or a pause.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Transfer {
    /// Bytes to the device.
    Out {
        /// Request.
        request: u8,
        /// Value.
        value: u16,
        /// Content.
        data: Vec<u8>,
    },
    /// Bytes from the device.
    In {
        /// Request.
        request: u8,
        /// Value.
        value: u16,
        /// Number of bytes wanted.
        length: u16,
    },
    /// A pause, ms.
    Wait(u32),
    /// Nothing: the firmware is flashed and read back.
    Done,
}

/// Why a transfer has no result.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Failed {
    /// The device refused it; its status tells why.
    Stalled,
    /// The device is gone.
    Gone,
}

#[derive(Clone, Debug)]
enum Step {
    /// Leads to the state idle, whatever was before.
    Settle,
    Command(u8, u32),
    Write(Block),
    Abort,
    Read(Block),
}

/// Part of a file, and its address.
#[derive(Clone, Debug)]
struct Block {
    address: u32,
    part: usize,
    range: Range<usize>,
}

/// What the current step waits for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Phase {
    Send,
    Status,
    Wait(u32),
    /// To lead from an error or a transfer to idle.
    Repair(u8),
}

/// The course of flashing one firmware.
#[derive(Clone, Debug)]
pub struct Session {
    parts: Vec<Vec<u8>>,
    steps: VecDeque<Step>,
    all: usize,
    phase: Phase,
    /// Time waited in this step, ms, and attempts to settle.
    waited_ms: u32,
    attempts: u8,
    /// Where the next or last command applies.
    address: u32,
}

impl Session {
    /// A session that flashes a release file into a chip whose boot loader's interface has this name.
    ///
    /// # Errors
    /// A board without USB, another chip, or a firmware that does not fit.
    pub fn new(package: &Package, interface: &str) -> Result<Self, DfuError> {
        let layout = Layout::parse(interface)?;
        check_usb(&package.manifest.firmware)?;
        check_chip(&package.manifest.firmware.chip, &layout)?;
        let mut blocks = Vec::new();
        let mut sectors = BTreeSet::new();
        for (index, (part, bytes)) in package.parts().enumerate() {
            sectors.extend(layout.sectors(part.address, part.bytes)?);
            blocks.extend((0..bytes.len()).step_by(BLOCK).map(|start| Block {
                address: part.address + start as u32,
                part: index,
                range: start..bytes.len().min(start + BLOCK),
            }));
        }
        blocks.sort_by_key(|block| block.address);
        let erase = sectors.into_iter().map(|sector| Step::Command(ERASE, sector));
        let write = blocks
            .iter()
            .rev()
            .flat_map(|block| [Step::Command(SET_ADDRESS, block.address), Step::Write(block.clone())]);
        let read = blocks.iter().flat_map(|block| {
            let set = Step::Command(SET_ADDRESS, block.address);
            [set, Step::Abort, Step::Read(block.clone()), Step::Abort]
        });
        let ready = [Step::Settle].into_iter();
        let steps: VecDeque<Step> =
            ready.chain(erase).chain(write).chain([Step::Abort]).chain(read).collect();
        Ok(Self {
            parts: package.parts().map(|(_, bytes)| bytes.to_vec()).collect(),
            all: steps.len(),
            steps,
            phase: Phase::Status,
            waited_ms: 0,
            attempts: 0,
            address: 0,
        })
    }

    /// Steps that are done, and all of them.
    pub fn progress(&self) -> (usize, usize) {
        (self.all - self.steps.len(), self.all)
    }

    /// What comes next.
    pub fn due(&mut self) -> Transfer {
        let out = |request, value, data: Vec<u8>| Transfer::Out { request, value, data };
        let Some(step) = self.steps.front() else { return Transfer::Done };
        match (self.phase, step) {
            (Phase::Wait(ms), _) => Transfer::Wait(ms),
            (Phase::Repair(request), _) => out(request, 0, vec![]),
            (Phase::Status, _) | (_, Step::Settle) => {
                Transfer::In { request: GET_STATUS, value: 0, length: STATUS_BYTES }
            }
            (Phase::Send, Step::Command(command, address)) => {
                self.address = *address;
                out(DOWNLOAD, 0, [&[*command][..], &address.to_le_bytes()].concat())
            }
            (Phase::Send, Step::Write(block)) => out(DOWNLOAD, DATA, self.bytes(block).to_vec()),
            (Phase::Send, Step::Abort) => out(ABORT, 0, vec![]),
            (Phase::Send, Step::Read(block)) => {
                Transfer::In { request: UPLOAD, value: DATA, length: block.range.len() as u16 }
            }
        }
    }

    /// Takes the result of the transfer that [`Self::due`] gave: what came from the device, empty for one to the device.
    ///
    /// # Errors
    /// Why flashing ends here.
    pub fn took(&mut self, result: Result<&[u8], Failed>) -> Result<(), DfuError> {
        let Some(step) = self.steps.front() else { return Ok(()) };
        let received = match result {
            Ok(received) => received,
            Err(Failed::Gone) => return Err(DfuError::Gone),
            // The status of a device that does not give one is no longer to be had.
            Err(Failed::Stalled) if self.phase == Phase::Status => return Err(DfuError::Gone),
            Err(Failed::Stalled) => {
                self.phase = Phase::Status;
                return Ok(());
            }
        };
        match (self.phase, step) {
            (Phase::Wait(_) | Phase::Repair(_), _) | (Phase::Send, Step::Command(..) | Step::Write(_)) => {
                self.phase = Phase::Status;
            }
            (Phase::Status, _) | (_, Step::Settle) => return self.status(received),
            (Phase::Send, Step::Abort) => self.step_done(),
            (Phase::Send, Step::Read(block)) => {
                let written = self.bytes(block);
                if received != written {
                    let same = received.iter().zip(written).take_while(|(read, wrote)| read == wrote).count();
                    return Err(DfuError::Differs(block.address + same as u32));
                }
                self.step_done();
            }
        }
        Ok(())
    }

    /// Goes on from a status: its code, the time until the next one (24 bits), the state.
    fn status(&mut self, received: &[u8]) -> Result<(), DfuError> {
        let [status, low, middle, high, state, _] = *received else { return Err(DfuError::Gone) };
        let wait_ms = u32::from_le_bytes([low, middle, high, 0]);
        match (state, self.steps.front()) {
            (DOWNLOAD_SYNC | DOWNLOAD_BUSY, _) if self.waited_ms < LONGEST_MS => {
                // A device that states no time must not be asked without end.
                let wait_ms = wait_ms.clamp(1, LONGEST_MS);
                self.waited_ms += wait_ms;
                self.phase = Phase::Wait(wait_ms);
            }
            (IDLE, Some(Step::Settle)) | (DOWNLOAD_IDLE, Some(Step::Command(..) | Step::Write(_))) => {
                self.step_done();
            }
            (_, Some(Step::Settle)) => {
                self.attempts += 1;
                if self.attempts > ATTEMPTS {
                    return Err(DfuError::State(state));
                }
                self.phase = Phase::Repair(if state == ERROR { CLEAR_STATUS } else { ABORT });
            }
            (ERROR, _) if status == VENDOR_ERROR => return Err(DfuError::ReadProtected),
            (ERROR, _) => return Err(DfuError::Refused { address: self.address, status }),
            _ => return Err(DfuError::State(state)),
        }
        Ok(())
    }

    fn step_done(&mut self) {
        self.steps.pop_front();
        self.phase = Phase::Send;
        self.waited_ms = 0;
    }

    fn bytes(&self, block: &Block) -> &[u8] {
        &self.parts[block.part][block.range.clone()]
    }
}

/// Runs a session to its end: `transfer` carries out one transfer or pause, `progress` is told done steps and all of them.
///
/// # Errors
/// Why flashing has ended.
pub fn run(
    mut session: Session,
    mut transfer: impl FnMut(&Transfer) -> Result<Vec<u8>, Failed>,
    mut progress: impl FnMut(usize, usize),
) -> Result<(), DfuError> {
    loop {
        let next = session.due();
        if next == Transfer::Done {
            return Ok(());
        }
        session.took(transfer(&next).as_deref().map_err(|failed| *failed))?;
        let (done, all) = session.progress();
        progress(done, all);
    }
}

/// Fails unless the firmware's board can be flashed by USB.
///
/// # Errors
/// [`DfuError::NoUsb`].
pub fn check_usb(firmware: &Firmware) -> Result<(), DfuError> {
    if firmware.usb_dfu { Ok(()) } else { Err(DfuError::NoUsb(firmware.board.clone())) }
}

/// Fails if the firmware is for another chip.
fn check_chip(chip: &str, layout: &Layout) -> Result<(), DfuError> {
    match flash_kib(chip) {
        Some(expected) if expected != layout.kib() => {
            Err(DfuError::OtherChip { chip: chip.to_owned(), expected, found: layout.kib() })
        }
        _ => Ok(()),
    }
}

/// Flash of a chip, by the letter of its name for it: `E` in `STM32F446RE` (DS8626, section 8); none for other families.
fn flash_kib(chip: &str) -> Option<u32> {
    let letter = chip.strip_prefix("STM32F4")?.chars().nth(3)?;
    let kib = [('B', 128), ('C', 256), ('E', 512), ('G', 1024), ('I', 2048)];
    kib.iter().find(|(code, _)| *code == letter).map(|(_, kib)| *kib)
}
