//! Frames: `00, COBS(postcard bytes, CRC-32), 00`.
//!
//! COBS (consistent overhead byte stuffing) removes zeros from the content. [`FrameDecoder`] takes one byte at a time, from
//! any source; only the delimiter at the end of a frame costs more, since the checksum is computed there.

use core::ops::Range;

use serde::{Deserialize, Serialize};
use thiserror::Error;

use crate::checksum::{CHECKSUM_BYTES, crc32, verified};

/// Longest message, bytes.
pub const MESSAGE_BYTES: usize = 672;
/// Buffer size of the decoder for any message, bytes.
pub const DECODER_BYTES: usize = MESSAGE_BYTES + CHECKSUM_BYTES;
/// Buffer size of [`encode_frame`] for any message, bytes: COBS adds 1 byte, and 1 per 254; there are two delimiters.
pub const FRAME_BYTES: usize = DECODER_BYTES + DECODER_BYTES / BLOCK_BYTES + 1 + 2;

/// Separates frames and does not occur within them.
const DELIMITER: u8 = 0;
/// Most bytes in a block of COBS.
const BLOCK_BYTES: usize = 254;
/// COBS code of a full block, which no zero follows.
const FULL_BLOCK: u8 = 0xFF;

/// The buffer is too short for the message.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
#[error("the message does not fit into the buffer; use a buffer of FRAME_BYTES")]
pub struct FrameTooLong;

/// Writes a message as a frame and returns the bytes to send.
///
/// # Errors
/// [`FrameTooLong`], but never with a buffer of [`FRAME_BYTES`].
pub fn encode_frame<'a, M: Serialize>(message: &M, buffer: &'a mut [u8]) -> Result<&'a [u8], FrameTooLong> {
    // The whole content first, then its checksum, then COBS: byte by byte through all three takes a third longer.
    let start = 2 + buffer.len() / BLOCK_BYTES;
    let room = buffer.get_mut(start..).ok_or(FrameTooLong)?;
    let length = postcard::to_slice(message, room).map_err(|_| FrameTooLong)?.len();
    let (content, rest) = room.split_at_mut_checked(length).ok_or(FrameTooLong)?;
    *rest.first_chunk_mut().ok_or(FrameTooLong)? = crc32(content).to_le_bytes();
    let written = stuff(buffer, start..start + length + CHECKSUM_BYTES).ok_or(FrameTooLong)?;
    buffer.get(..written).ok_or(FrameTooLong)
}

/// Moves the content to the front of the buffer as a frame; before the content there is room for a delimiter and the codes of all
/// blocks. Returns the length of the frame; none without room for the last delimiter.
fn stuff(buffer: &mut [u8], content: Range<usize>) -> Option<usize> {
    *buffer.first_mut()? = DELIMITER;
    let (mut code, mut end) = (1, 2);
    for place in content {
        let byte = *buffer.get(place)?;
        if byte != 0 {
            *buffer.get_mut(end)? = byte;
            end += 1;
        }
        if byte == 0 || end - code > BLOCK_BYTES {
            *buffer.get_mut(code)? = (end - code) as u8;
            (code, end) = (end, end + 1);
        }
    }
    *buffer.get_mut(code)? = (end - code) as u8;
    *buffer.get_mut(end)? = DELIMITER;
    Some(end + 1)
}

/// Damage to a frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
pub enum Corrupt {
    /// The checksum does not match.
    #[error("frame with wrong checksum")]
    Checksum,
    /// The frame has more bytes than any message.
    #[error("frame longer than any message")]
    Overlong,
    /// The frame ends within a COBS block.
    #[error("frame cut short")]
    Cobs,
}

/// Numbers of good and corrupt frames.
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
    /// Number of all corrupt frames.
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

/// Result of decoding one byte.
#[derive(Debug, PartialEq, Eq)]
pub enum Poll<'a> {
    /// No frame ends here.
    Pending,
    /// A frame with the right checksum: the message's bytes.
    Frame(&'a [u8]),
    /// A damaged frame, which must be discarded.
    Corrupt(Corrupt),
}

/// Decodes frames from a stream of bytes; with `N` = [`DECODER_BYTES`] it accepts any message. Fulfils: frame-checks.
#[derive(Clone, Debug)]
pub struct FrameDecoder<const N: usize> {
    buffer: [u8; N],
    state: DecoderState,
    counters: FrameCounters,
}

/// State of the decoder within a frame.
#[derive(Clone, Copy, Debug, Default)]
struct DecoderState {
    started: bool,
    length: usize,
    /// Bytes left in the current COBS block.
    block: u8,
    /// Whether a zero follows the current block, unless the frame ends there.
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

    /// Counters since the decoder was made.
    pub fn counters(&self) -> &FrameCounters {
        &self.counters
    }

    /// Decodes one byte.
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
        debug_assert!(byte != DELIMITER && self.state.length <= N);
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
        debug_assert!(self.started && (!self.overlong || self.length == buffer.len()));
        if self.overlong {
            Err(Corrupt::Overlong)
        } else if self.block > 0 {
            Err(Corrupt::Cobs)
        } else {
            let frame = buffer.get(..self.length).unwrap_or(&[]);
            // The CRC of an empty message is zero, so four zero bytes would be accepted; no message is empty.
            verified(frame).filter(|content| !content.is_empty()).ok_or(Corrupt::Checksum)
        }
    }
}

#[cfg(test)]
mod tests;
