//! The frames of the policy link. `docs/POLICY_LINK.md` specifies every one of them for authors of a policy.
//!
//! Every frame has 32 bytes, little endian: start, kind, number (u16), payload (six words of 4 bytes), CRC-32 of bytes 0..28. Unused
//! words are zero.

use shared::checksum::{crc32, verified};
use shared::control::memory::Lesson;

/// Version of the protocol; it changes whenever the bytes of an existing message change.
pub const VERSION: u32 = 1;
/// First byte of a frame: not that of the plant link, so that a plant is never taken for a policy.
pub const START: u8 = 0xA6;
/// Length of a frame, bytes.
pub const FRAME_BYTES: usize = 32;
/// Bytes before the payload, and before the checksum.
const HEAD_BYTES: usize = 4;
const BODY_BYTES: usize = FRAME_BYTES - 4;
/// Words of the payload.
const WORDS: usize = (BODY_BYTES - HEAD_BYTES) / 4;

/// The lessons in the order of their numbers.
const LESSONS: [Lesson; 3] = [Lesson::Adopt, Lesson::Discard, Lesson::Forget];

/// Content of a frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum PolicyMessage {
    /// Open the link.
    Hello {
        /// [`VERSION`] of the ventilator.
        version: u32,
    },
    /// Description of the policy.
    Greeting {
        /// [`VERSION`] of the policy.
        version: u32,
        /// The only control period that it supports, microseconds; 0 for any.
        period_us: u32,
    },
    /// Forget everything: a ventilation begins, with the valve closed.
    Reset {
        /// Control period, microseconds.
        period_us: u32,
    },
    /// A breath begins.
    Start {
        /// Number of the breath since Reset, from 0.
        breath: u32,
        /// PIP of the breath, cmH2O.
        pip: f32,
        /// PEEP of the breath, cmH2O.
        peep: f32,
        /// Command that the valve had before it, percent.
        applied: f32,
        /// Length of the target's rise from PEEP to PIP, ticks.
        rise_ticks: u32,
    },
    /// An inspiration has ended, or the settings change.
    Learn {
        /// What to do with what earlier breaths and this one have taught.
        lesson: Lesson,
        /// Command that the valve had in the last tick of the inspiration, percent.
        applied: f32,
    },
    /// The policy has executed Reset, Start or Learn.
    Ready,
    /// A tick of the inspiration, which needs a command.
    Observe {
        /// Measured airway pressure, cmH2O.
        pressure: f32,
        /// Target pressure, cmH2O.
        target: f32,
        /// PIP, cmH2O.
        pip: f32,
        /// PEEP, cmH2O.
        peep: f32,
        /// Command that the valve had in the last tick, percent.
        applied: f32,
        /// Ticks since the breath began.
        tick: u32,
    },
    /// The answer to Observe.
    Command {
        /// Inspiratory valve, percent of full opening.
        u_in: f32,
    },
}

impl PolicyMessage {
    /// Name in errors and in the document.
    pub fn name(&self) -> &'static str {
        match self {
            Self::Hello { .. } => "Hello",
            Self::Greeting { .. } => "Greeting",
            Self::Reset { .. } => "Reset",
            Self::Start { .. } => "Start",
            Self::Learn { .. } => "Learn",
            Self::Ready => "Ready",
            Self::Observe { .. } => "Observe",
            Self::Command { .. } => "Command",
        }
    }

    /// Kind and payload.
    fn parts(&self) -> (u8, [u32; WORDS]) {
        match *self {
            Self::Hello { version } => (1, [version, 0, 0, 0, 0, 0]),
            Self::Greeting { version, period_us } => (2, [version, period_us, 0, 0, 0, 0]),
            Self::Reset { period_us } => (3, [period_us, 0, 0, 0, 0, 0]),
            Self::Start { breath, pip, peep, applied, rise_ticks } => {
                (4, [breath, pip.to_bits(), peep.to_bits(), applied.to_bits(), rise_ticks, 0])
            }
            Self::Ready => (5, [0; WORDS]),
            Self::Observe { pressure, target, pip, peep, applied, tick } => {
                let [pressure, target, pip, peep, applied] =
                    [pressure, target, pip, peep, applied].map(f32::to_bits);
                (6, [pressure, target, pip, peep, applied, tick])
            }
            Self::Command { u_in } => (7, [u_in.to_bits(), 0, 0, 0, 0, 0]),
            Self::Learn { lesson, applied } => {
                let place = LESSONS.iter().position(|listed| *listed == lesson);
                (8, [place.unwrap_or_default() as u32, applied.to_bits(), 0, 0, 0, 0])
            }
        }
    }

    /// The message of these parts, if there is one.
    fn of(kind: u8, words: [u32; WORDS]) -> Option<Self> {
        let real = words.map(f32::from_bits);
        Some(match (kind, words) {
            (1, [version, 0, 0, 0, 0, 0]) => Self::Hello { version },
            (2, [version, period_us, 0, 0, 0, 0]) => Self::Greeting { version, period_us },
            (3, [period_us, 0, 0, 0, 0, 0]) => Self::Reset { period_us },
            (4, [breath, _, _, _, rise_ticks, 0]) => {
                Self::Start { breath, pip: real[1], peep: real[2], applied: real[3], rise_ticks }
            }
            (5, [0, 0, 0, 0, 0, 0]) => Self::Ready,
            (6, [.., tick]) => {
                let [pressure, target, pip, peep, applied, _] = real;
                Self::Observe { pressure, target, pip, peep, applied, tick }
            }
            (7, [_, 0, 0, 0, 0, 0]) => Self::Command { u_in: real[0] },
            (8, [lesson, _, 0, 0, 0, 0]) => {
                Self::Learn { lesson: *LESSONS.get(lesson as usize)?, applied: real[1] }
            }
            _ => return None,
        })
    }
}

/// A frame: a message with its number.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PolicyFrame {
    /// Chosen by the ventilator, wrapping; repeated in the answer.
    pub number: u16,
    /// The message.
    pub message: PolicyMessage,
}

impl PolicyFrame {
    /// Encodes the frame.
    pub fn encode(&self) -> [u8; FRAME_BYTES] {
        let (kind, words) = self.message.parts();
        let mut bytes = [0; FRAME_BYTES];
        (bytes[0], bytes[1]) = (START, kind);
        bytes[2..HEAD_BYTES].copy_from_slice(&self.number.to_le_bytes());
        for (place, word) in bytes[HEAD_BYTES..BODY_BYTES].chunks_exact_mut(4).zip(words) {
            place.copy_from_slice(&word.to_le_bytes());
        }
        let checksum = crc32(&bytes[..BODY_BYTES]);
        bytes[BODY_BYTES..].copy_from_slice(&checksum.to_le_bytes());
        bytes
    }

    /// Decodes a frame; none unless every byte is as specified in `docs/POLICY_LINK.md`.
    pub fn decode(bytes: &[u8; FRAME_BYTES]) -> Option<Self> {
        verified(bytes)?;
        let [start, kind, low, high, ..] = *bytes;
        let mut words = [0; WORDS];
        for (word, place) in words.iter_mut().zip(bytes[HEAD_BYTES..BODY_BYTES].as_chunks().0) {
            *word = u32::from_le_bytes(*place);
        }
        let message = PolicyMessage::of(kind, words).filter(|_| start == START)?;
        Some(Self { number: u16::from_le_bytes([low, high]), message })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Any message without NaN, so that messages can be compared.
    fn message() -> impl Strategy<Value = PolicyMessage> {
        let real = || -200.0f32..200.0;
        prop_oneof![
            any::<u32>().prop_map(|version| PolicyMessage::Hello { version }),
            (any::<u32>(), any::<u32>())
                .prop_map(|(version, period_us)| PolicyMessage::Greeting { version, period_us }),
            any::<u32>().prop_map(|period_us| PolicyMessage::Reset { period_us }),
            (any::<u32>(), real(), real(), real(), any::<u32>()).prop_map(
                |(breath, pip, peep, applied, rise_ticks)| PolicyMessage::Start {
                    breath,
                    pip,
                    peep,
                    applied,
                    rise_ticks
                }
            ),
            Just(PolicyMessage::Ready),
            (real(), real(), real(), real(), real(), any::<u32>()).prop_map(
                |(pressure, target, pip, peep, applied, tick)| PolicyMessage::Observe {
                    pressure,
                    target,
                    pip,
                    peep,
                    applied,
                    tick
                }
            ),
            real().prop_map(|u_in| PolicyMessage::Command { u_in }),
            (0..LESSONS.len(), real())
                .prop_map(|(lesson, applied)| PolicyMessage::Learn { lesson: LESSONS[lesson], applied }),
        ]
    }

    proptest! {
        #[test]
        fn a_frame_comes_back_and_no_flipped_bit_is_accepted(number: u16, message in message()) {
            let frame = PolicyFrame { number, message };
            let bytes = frame.encode();
            prop_assert_eq!(PolicyFrame::decode(&bytes), Some(frame));
            for bit in 0..8 * FRAME_BYTES {
                let mut flipped = bytes;
                flipped[bit / 8] ^= 1 << (bit % 8);
                prop_assert_eq!(PolicyFrame::decode(&flipped), None);
            }
        }

        #[test]
        fn any_bytes_are_a_frame_only_if_they_are_its_encoding(bytes: [u8; FRAME_BYTES], kind in 0u8..10) {
            let mut forged = bytes;
            (forged[0], forged[1]) = (START, kind);
            forged[BODY_BYTES - 8..BODY_BYTES].fill(0);
            let checksum = crc32(&forged[..BODY_BYTES]);
            forged[BODY_BYTES..].copy_from_slice(&checksum.to_le_bytes());
            for bytes in [bytes, forged] {
                if let Some(frame) = PolicyFrame::decode(&bytes) {
                    prop_assert_eq!(frame.encode(), bytes);
                }
            }
        }
    }

    #[test]
    fn a_command_that_is_no_number_arrives_as_it_was_sent() {
        let message = PolicyMessage::Command { u_in: f32::NAN };
        let back = PolicyFrame::decode(&PolicyFrame { number: 0, message }.encode()).unwrap();
        assert!(matches!(back.message, PolicyMessage::Command { u_in } if u_in.is_nan()));
    }

    /// The document shows two frames as bytes.
    #[test]
    fn the_frames_of_the_document_are_these() {
        let document = include_str!("../../../../docs/POLICY_LINK.md");
        let observe = PolicyMessage::Observe {
            pressure: 12.5,
            target: 20.0,
            pip: 20.0,
            peep: 5.0,
            applied: 37.5,
            tick: 42,
        };
        for message in [observe, PolicyMessage::Command { u_in: 40.0 }] {
            let bytes = PolicyFrame { number: 258, message }.encode();
            let words =
                bytes.as_chunks::<4>().0.iter().map(|word| format!("{:08X}", u32::from_be_bytes(*word)));
            let shown = words.collect::<Vec<_>>().join(" ");
            assert!(document.contains(&shown), "{shown}");
        }
    }
}
