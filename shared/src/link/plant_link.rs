//! The plant link: it connects a ventilator (firmware or trainer) in lockstep with a lung simulator in any language, in
//! place of sensor and valves. `docs/PLANT_LINK.md` specifies every frame for authors of a plant.
//!
//! Every frame has 16 bytes, little endian: start, kind, tick (u16), payload (8 bytes), CRC-32 of bytes 0..12.
//! The ventilator sends one frame and waits for its answer: Greeting to Hello, Ready to Reset, Peep and Seed, Pressure to
//! Step. A plant that knows the true pressure may answer Reset and Step with Truth. On a line that can lose bytes, the
//! ventilator repeats a frame that gets no answer in time; a plant that receives the tick of its last answer again repeats
//! that answer without a step. Bytes outside frames are skipped. The firmware sends no Hello and does not accept Truth.

use crate::checksum::{crc32, verified};

/// Version of the protocol; it changes whenever the bytes of an existing message change.
pub const VERSION: u16 = 1;
/// First byte of a frame.
pub const START: u8 = 0xA5;
/// Length of a frame, bytes.
pub const FRAME_BYTES: usize = 16;

/// Content of a frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum PlantMessage {
    /// Restart the plant at rest.
    Reset {
        /// Control period, microseconds.
        period_us: u32,
    },
    /// Simulate one control period with these valve commands.
    Step {
        /// Inspiratory valve, percent of full opening.
        u_in: f32,
        /// Whether the expiratory valve is open.
        u_out: bool,
    },
    /// Set the mechanical PEEP valve; no time passes.
    Peep {
        /// PEEP, cmH2O.
        pressure: f32,
    },
    /// Set the random seed that the next Reset uses; without one it uses the previous seed again.
    Seed {
        /// Random seed.
        seed: u64,
    },
    /// Open the link.
    Hello {
        /// [`VERSION`] of the ventilator.
        version: u32,
    },
    /// Description of the plant.
    Greeting {
        /// [`VERSION`] of the plant.
        version: u16,
        /// Largest magnitude of the pressures that it sends, cmH2O.
        highest: u16,
        /// The only control period that it supports, microseconds; 0 for any.
        period_us: u32,
    },
    /// Replaces Ready and Pressure for a plant that knows the true pressure.
    Truth {
        /// Measured pressure, cmH2O.
        pressure: f32,
        /// True airway pressure at the same instant, cmH2O.
        airway: f32,
    },
    /// The plant has executed Reset, Peep or Seed.
    Ready {
        /// Current pressure, cmH2O.
        pressure: f32,
    },
    /// The plant has executed Step.
    Pressure {
        /// Pressure after the step, cmH2O.
        pressure: f32,
    },
}

/// A frame: a message with its tick.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PlantFrame {
    /// Chosen by the ventilator, wrapping; repeated in the answer.
    pub tick: u16,
    /// The message.
    pub message: PlantMessage,
}

impl PlantFrame {
    /// Encodes the frame.
    pub fn encode(&self) -> [u8; FRAME_BYTES] {
        let (kind, first, second) = match self.message {
            PlantMessage::Reset { period_us } => (1, period_us, 0),
            PlantMessage::Step { u_in, u_out } => (2, u_in.to_bits(), u32::from(u_out)),
            PlantMessage::Ready { pressure } => (3, pressure.to_bits(), 0),
            PlantMessage::Pressure { pressure } => (4, pressure.to_bits(), 0),
            PlantMessage::Peep { pressure } => (5, pressure.to_bits(), 0),
            PlantMessage::Seed { seed } => (6, seed as u32, (seed >> 32) as u32),
            PlantMessage::Hello { version } => (7, version, 0),
            PlantMessage::Greeting { version, highest, period_us } => {
                (8, u32::from(highest) << 16 | u32::from(version), period_us)
            }
            PlantMessage::Truth { pressure, airway } => (9, pressure.to_bits(), airway.to_bits()),
        };
        let mut bytes = [0; FRAME_BYTES];
        (bytes[0], bytes[1]) = (START, kind);
        bytes[2..4].copy_from_slice(&self.tick.to_le_bytes());
        bytes[4..8].copy_from_slice(&first.to_le_bytes());
        bytes[8..12].copy_from_slice(&second.to_le_bytes());
        let checksum = crc32(&bytes[..12]);
        bytes[12..].copy_from_slice(&checksum.to_le_bytes());
        bytes
    }

    /// Decodes a frame; none unless every byte is as specified in `docs/PLANT_LINK.md`.
    pub fn decode(bytes: &[u8; FRAME_BYTES]) -> Option<Self> {
        verified(bytes)?;
        let [start, kind, t0, t1, a0, a1, a2, a3, b0, b1, b2, b3, ..] = *bytes;
        let first = u32::from_le_bytes([a0, a1, a2, a3]);
        let second = u32::from_le_bytes([b0, b1, b2, b3]);
        let real = f32::from_bits(first);
        let message = match (start, kind, second) {
            (START, 1, 0) => PlantMessage::Reset { period_us: first },
            (START, 2, 0 | 1) => PlantMessage::Step { u_in: real, u_out: second == 1 },
            (START, 3, 0) => PlantMessage::Ready { pressure: real },
            (START, 4, 0) => PlantMessage::Pressure { pressure: real },
            (START, 5, 0) => PlantMessage::Peep { pressure: real },
            (START, 6, high) => PlantMessage::Seed { seed: u64::from(high) << 32 | u64::from(first) },
            (START, 7, 0) => PlantMessage::Hello { version: first },
            (START, 8, period_us) => {
                PlantMessage::Greeting { version: first as u16, highest: (first >> 16) as u16, period_us }
            }
            (START, 9, second) => PlantMessage::Truth { pressure: real, airway: f32::from_bits(second) },
            _ => return None,
        };
        Some(Self { tick: u16::from_le_bytes([t0, t1]), message })
    }
}

/// Finds frames in a stream of bytes, in a window of the last 16.
#[derive(Clone, Copy, Debug, Default)]
pub struct PlantDecoder {
    window: [u8; FRAME_BYTES],
    filled: usize,
    skipped: u32,
}

impl PlantDecoder {
    /// Takes one byte; returns a frame if it completes one.
    pub fn push(&mut self, byte: u8) -> Option<PlantFrame> {
        if self.filled == FRAME_BYTES {
            self.filled -= 1;
            self.skipped = self.skipped.wrapping_add(1);
        }
        debug_assert!(self.filled < FRAME_BYTES);
        self.window.copy_within(1.., 0);
        self.window[FRAME_BYTES - 1] = byte;
        self.filled += 1;
        debug_assert!((1..=FRAME_BYTES).contains(&self.filled));
        if self.filled < FRAME_BYTES || self.window[0] != START {
            return None;
        }
        let frame = PlantFrame::decode(&self.window)?;
        self.filled = 0;
        Some(frame)
    }

    /// Number of bytes outside frames.
    pub fn skipped(&self) -> u32 {
        self.skipped
    }
}

#[cfg(test)]
mod tests;
