//! Frames: `00, COBS(postcard bytes, CRC-32), 00`.
//!
//! [`FrameDecoder`] takes one byte at a time in constant time and has no idea where the bytes come from.

use postcard::ser_flavors::crc::CrcModifier;
use postcard::ser_flavors::{Cobs, Slice};
use serde::{Deserialize, Serialize};
use thiserror::Error;

use crate::checksum::{CHECKSUM_BYTES, CRC_32, verified};

/// Longest message, bytes.
pub const MESSAGE_BYTES: usize = 512;
/// Room that the decoder needs for any message.
pub const DECODER_BYTES: usize = MESSAGE_BYTES + CHECKSUM_BYTES;
/// Room that [`encode_frame`] needs for any message: COBS adds one byte in 254, and there are two delimiters.
pub const FRAME_BYTES: usize = DECODER_BYTES + DECODER_BYTES / 254 + 1 + 2;

/// Separates frames and occurs nowhere within them.
const DELIMITER: u8 = 0;
/// Length code of a full block, which is not followed by a zero.
const FULL_BLOCK: u8 = 0xFF;

/// The buffer is too short for the message.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
#[error("message does not fit into the buffer; give one of FRAME_BYTES")]
pub struct FrameTooLong;

/// Writes a message as a frame and gives the bytes to send.
///
/// # Errors
/// [`FrameTooLong`], never with a buffer of [`FRAME_BYTES`].
pub fn encode_frame<'a, M: Serialize>(message: &M, buffer: &'a mut [u8]) -> Result<&'a [u8], FrameTooLong> {
    let (first, rest) = buffer.split_first_mut().ok_or(FrameTooLong)?;
    *first = DELIMITER;
    let cobs = Cobs::try_new(Slice::new(rest)).map_err(|_| FrameTooLong)?;
    let checked = CrcModifier::new(cobs, CRC_32.digest());
    let written = postcard::serialize_with_flavor(message, checked).map_err(|_| FrameTooLong)?.len();
    buffer.get(..=written).ok_or(FrameTooLong)
}

/// Damage of a frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
pub enum Corrupt {
    /// The checksum does not match.
    #[error("frame with a wrong checksum")]
    Checksum,
    /// More bytes than any message has.
    #[error("frame longer than any message")]
    Overlong,
    /// The frame ends within a COBS block.
    #[error("frame cut short")]
    Cobs,
}

/// Numbers of good and of refused frames.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct FrameCounters {
    /// Good frames.
    pub frames: u32,
    /// Frames with a wrong checksum.
    pub checksum: u32,
    /// Frames longer than any message.
    pub overlong: u32,
    /// Frames cut short.
    pub cobs: u32,
}

impl FrameCounters {
    /// All refused frames.
    pub fn corrupt(&self) -> u32 {
        self.checksum.wrapping_add(self.overlong).wrapping_add(self.cobs)
    }

    fn count(&mut self, result: Result<(), Corrupt>) {
        let counter = match result {
            Ok(()) => &mut self.frames,
            Err(Corrupt::Checksum) => &mut self.checksum,
            Err(Corrupt::Overlong) => &mut self.overlong,
            Err(Corrupt::Cobs) => &mut self.cobs,
        };
        *counter = counter.wrapping_add(1);
    }
}

/// Result of one byte.
#[derive(Debug, PartialEq, Eq)]
pub enum Poll<'a> {
    /// Nothing yet.
    Pending,
    /// A frame with a right checksum: the message's bytes.
    Frame(&'a [u8]),
    /// A frame that must be thrown away.
    Corrupt(Corrupt),
}

/// Finds frames in a stream of bytes; `N` is [`DECODER_BYTES`] to take any message.
#[derive(Clone, Debug)]
pub struct FrameDecoder<const N: usize> {
    buffer: [u8; N],
    state: DecoderState,
    counters: FrameCounters,
}

/// Position of the decoder within a frame.
#[derive(Clone, Copy, Debug, Default)]
struct DecoderState {
    started: bool,
    length: usize,
    /// Bytes left in the present COBS block.
    block: u8,
    /// The block stands for a zero at its end, unless the frame ends there.
    zero: bool,
    overlong: bool,
}

impl<const N: usize> FrameDecoder<N> {
    /// A decoder between frames.
    pub const fn new() -> Self {
        Self {
            buffer: [0; N],
            state: DecoderState { started: false, length: 0, block: 0, zero: false, overlong: false },
            counters: FrameCounters { frames: 0, checksum: 0, overlong: 0, cobs: 0 },
        }
    }

    /// Frames so far.
    pub fn counters(&self) -> &FrameCounters {
        &self.counters
    }

    /// Takes in one byte.
    pub fn push(&mut self, byte: u8) -> Poll<'_> {
        if byte != DELIMITER {
            self.take(byte);
            return Poll::Pending;
        }
        let state = core::mem::take(&mut self.state);
        if !state.started {
            return Poll::Pending;
        }
        let result = state.finish(&self.buffer);
        self.counters.count(result.map(|_| ()));
        match result {
            Ok(message) => Poll::Frame(message),
            Err(reason) => Poll::Corrupt(reason),
        }
    }

    fn take(&mut self, byte: u8) {
        self.state.started = true;
        if self.state.block > 0 {
            self.state.block -= 1;
            self.store(byte);
        } else {
            if self.state.zero {
                self.store(0);
            }
            self.state.block = byte - 1;
            self.state.zero = byte != FULL_BLOCK;
        }
    }

    fn store(&mut self, byte: u8) {
        match self.buffer.get_mut(self.state.length) {
            Some(place) => {
                *place = byte;
                self.state.length += 1;
            }
            None => self.state.overlong = true,
        }
    }
}

impl<const N: usize> Default for FrameDecoder<N> {
    fn default() -> Self {
        Self::new()
    }
}

impl DecoderState {
    fn finish(self, buffer: &[u8]) -> Result<&[u8], Corrupt> {
        if self.overlong {
            Err(Corrupt::Overlong)
        } else if self.block > 0 {
            Err(Corrupt::Cobs)
        } else {
            let frame = buffer.get(..self.length).unwrap_or(&[]);
            // The checksum of nothing is zero, which a run of zeros would pass for; nobody sends nothing.
            verified(frame).filter(|content| !content.is_empty()).ok_or(Corrupt::Checksum)
        }
    }
}

#[cfg(test)]
mod tests;
