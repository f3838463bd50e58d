//! The plant link: a ventilator on one end (firmware or trainer), a lung simulator in any language on the other, in
//! lockstep. It takes the place of sensor and valves. `docs/PLANT_LINK.md` has the bytes of each
//! frame, for those who write a plant.
//!
//! Every frame has 16 bytes, little endian: start, kind, tick (u16), payload (8 bytes), CRC-32 of bytes 0..12.
//! The ventilator sends one frame and waits for its answer: Greeting to Hello, Ready to Reset, Peep and Seed, Pressure to
//! Step; a plant that knows the true pressure may answer Truth to Reset and Step. No answer in time on a line that may lose
//! bytes: it sends the same frame again. A plant that gets the tick of its last answer again repeats that answer and
//! does not step. Bytes that belong to no frame are skipped. The firmware, whose plant is wired to it, does not say Hello.

use crate::checksum::{crc32, verified};

/// Version of the protocol: changes whenever the bytes of an existing message change.
pub const VERSION: u16 = 1;
/// First byte of a frame.
pub const START: u8 = 0xA5;
/// Length of a frame.
pub const FRAME_BYTES: usize = 16;

/// Content of a frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum PlantMessage {
    /// Restart at rest.
    Reset {
        /// Control period, microseconds.
        period_us: u32,
    },
    /// One control period with these valves.
    Step {
        /// Inspiratory valve, percent of full opening.
        u_in: f32,
        /// Expiratory valve open?
        u_out: bool,
    },
    /// The knob of the mechanical PEEP valve is turned; time stands still.
    Peep {
        /// PEEP, cmH2O.
        pressure: f32,
    },
    /// The next Reset starts the plant's random numbers with this seed; without one it starts with the seed before.
    Seed {
        /// The seed.
        seed: u64,
    },
    /// The ventilator opens the link.
    Hello {
        /// [`VERSION`] of the one who asks.
        version: u32,
    },
    /// The plant describes itself.
    Greeting {
        /// Its [`VERSION`].
        version: u16,
        /// Highest magnitude of a pressure that it tells, cmH2O.
        highest: u16,
        /// The control period that it is made for, microseconds; 0 if it runs any.
        period_us: u32,
    },
    /// In the place of Ready and Pressure, from a plant that knows the truth.
    Truth {
        /// Pressure measured, cmH2O.
        pressure: f32,
        /// True airway pressure at the same instant, cmH2O.
        airway: f32,
    },
    /// The plant has restarted, its PEEP valve is set, or it has the seed.
    Ready {
        /// Pressure now, cmH2O.
        pressure: f32,
    },
    /// The plant has stepped.
    Pressure {
        /// Pressure after the step, cmH2O.
        pressure: f32,
    },
}

/// A message with its tick.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PlantFrame {
    /// Chosen by the ventilator, wrapping; repeated in the answer.
    pub tick: u16,
    /// Its content.
    pub message: PlantMessage,
}

impl PlantFrame {
    /// The frame's bytes.
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

    /// The frame in some bytes; none unless all of them are as `docs/PLANT_LINK.md` says.
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

/// Finds frames in a stream of bytes: a window over the last 16.
#[derive(Clone, Copy, Debug, Default)]
pub struct PlantDecoder {
    window: [u8; FRAME_BYTES],
    filled: usize,
    skipped: u32,
}

impl PlantDecoder {
    /// Takes in one byte; a frame when it completes one.
    pub fn push(&mut self, byte: u8) -> Option<PlantFrame> {
        if self.filled == FRAME_BYTES {
            self.filled -= 1;
            self.skipped = self.skipped.wrapping_add(1);
        }
        self.window.copy_within(1.., 0);
        self.window[FRAME_BYTES - 1] = byte;
        self.filled += 1;
        if self.filled < FRAME_BYTES || self.window[0] != START {
            return None;
        }
        let frame = PlantFrame::decode(&self.window)?;
        self.filled = 0;
        Some(frame)
    }

    /// Bytes that belonged to no frame.
    pub fn skipped(&self) -> u32 {
        self.skipped
    }
}

#[cfg(test)]
mod tests;
