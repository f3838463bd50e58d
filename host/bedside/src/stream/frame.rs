//! A binary message: consecutive samples of one device, little endian.
//!
//! | bytes | content |
//! |---|---|
//! | 1 | kind, [`KIND`] |
//! | 1 | device |
//! | 2 | number of samples, `n` |
//! | 4 | samples of this device that this page has lost so far |
//! | 8 | tick of the first sample, f64 |
//! | 8 | when the last sample came, ms since 1970, f64 |
//! | 7 x 4 n | columns of f32: pressure, target, `u_in`, `u_out`, learned, flow, volume |
//! | n | phase: 0 inspiration, 1 fall, 2 expiration; padded to 4 bytes |

use shared::breath::Phase;

/// Kind of this message.
pub const KIND: u8 = 1;
/// Length of the part before the columns, bytes.
pub const HEADER_BYTES: usize = 24;
/// Most samples in a message.
pub const SAMPLES_MAX: usize = 256;
/// Place of the counter that differs from page to page.
const DROPPED_AT: usize = 4;
/// Number of columns.
const COLUMNS: usize = 7;

/// A sample as a page gets it; NaN marks what is not known.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Point {
    /// Pressure, cmH2O.
    pub pressure: f32,
    /// Target, cmH2O.
    pub target: f32,
    /// Command of the inspiratory valve, percent.
    pub u_in: f32,
    /// Command of the expiratory valve: 0 or 100 percent.
    pub u_out: f32,
    /// Part of the command that is learned, percent.
    pub learned: f32,
    /// Flow into the lung, L/s.
    pub flow: f32,
    /// Volume since the start of the breath, mL.
    pub volume: f32,
    /// Phase of the breath.
    pub phase: Phase,
}

impl Point {
    fn columns(&self) -> [f32; COLUMNS] {
        let Self { pressure, target, u_in, u_out, learned, flow, volume, .. } = *self;
        [pressure, target, u_in, u_out, learned, flow, volume]
    }
}

/// An encoded message, without the counter of losses.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Frame {
    device: u8,
    samples: u16,
    bytes: Vec<u8>,
}

impl Frame {
    /// Encodes at most [`SAMPLES_MAX`] samples of consecutive ticks; further ones are left out.
    pub fn new(device: u8, first_tick: u64, time_ms: f64, points: &[Point]) -> Self {
        let points = &points[..points.len().min(SAMPLES_MAX)];
        let samples = points.len() as u16;
        let mut bytes = Vec::with_capacity(HEADER_BYTES + points.len() * (4 * COLUMNS + 1) + 3);
        bytes.extend([KIND, device]);
        bytes.extend(samples.to_le_bytes());
        bytes.extend(0_u32.to_le_bytes());
        bytes.extend((first_tick as f64).to_le_bytes());
        bytes.extend(time_ms.to_le_bytes());
        for column in 0..COLUMNS {
            bytes.extend(points.iter().flat_map(|point| point.columns()[column].to_le_bytes()));
        }
        bytes.extend(points.iter().map(|point| number(point.phase)));
        bytes.resize(bytes.len().next_multiple_of(4), 0);
        Self { device, samples, bytes }
    }

    /// The device.
    pub fn device(&self) -> u8 {
        self.device
    }

    /// Number of samples.
    pub fn samples(&self) -> u32 {
        self.samples.into()
    }

    /// The message for a page that has lost this many samples of the device.
    pub fn bytes(&self, dropped: u32) -> Vec<u8> {
        let mut bytes = self.bytes.clone();
        bytes[DROPPED_AT..][..4].copy_from_slice(&dropped.to_le_bytes());
        bytes
    }
}

/// A phase as the message numbers it.
fn number(phase: Phase) -> u8 {
    match phase {
        Phase::Inspiration => 0,
        Phase::Fall => 1,
        Phase::Expiration => 2,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn point(pressure: f32) -> Point {
        Point {
            pressure,
            target: 20.0,
            u_in: 30.0,
            u_out: 100.0,
            learned: f32::NAN,
            flow: 0.5,
            volume: 250.0,
            phase: Phase::Expiration,
        }
    }

    fn f32_at(bytes: &[u8], at: usize) -> f32 {
        f32::from_le_bytes(bytes[at..][..4].try_into().unwrap())
    }

    #[test]
    fn the_bytes_are_those_of_the_description() {
        let bytes = Frame::new(3, 70_000, 1.5, &[point(12.5), point(13.5)]).bytes(9);
        assert_eq!(bytes[..8], [1, 3, 2, 0, 9, 0, 0, 0]);
        assert_eq!(bytes[8..16], 70_000_f64.to_le_bytes());
        assert_eq!(bytes[16..24], 1.5_f64.to_le_bytes());
        let columns: Vec<f32> = (0..14).map(|place| f32_at(&bytes, HEADER_BYTES + 4 * place)).collect();
        assert_eq!(columns[..8], [12.5, 13.5, 20.0, 20.0, 30.0, 30.0, 100.0, 100.0]);
        assert!(columns[8].is_nan() && columns[9].is_nan());
        assert_eq!(columns[10..], [0.5, 0.5, 250.0, 250.0]);
        assert_eq!(bytes[80..], [2, 2, 0, 0], "phases, padded");
    }

    /// The page's decoder is tested on these bytes.
    #[test]
    fn the_page_is_tested_on_real_bytes() {
        let rows = [
            ([1.5, 20.0, 30.0, 0.0, 5.25, 0.5, 6.0], Phase::Inspiration),
            ([-11.0, 12.25, 13.0, 100.0, f32::NAN, -16.0, 250.0], Phase::Fall),
            ([21.0, 22.0, 23.0, 100.0, 25.0, 26.0, 27.0], Phase::Expiration),
        ];
        let points = rows.map(|([pressure, target, u_in, u_out, learned, flow, volume], phase)| Point {
            pressure,
            target,
            u_in,
            u_out,
            learned,
            flow,
            volume,
            phase,
        });
        let bytes = Frame::new(3, (1 << 40) + 5, 1_700_000_000_000.5, &points).bytes(9);
        let lines: Vec<String> = bytes
            .chunks(32)
            .map(|line| line.iter().fold(String::new(), |text, byte| format!("{text}{byte:02x}")))
            .collect();
        assert_eq!(include_str!("../../web/test/samples.hex").trim(), lines.join("\n"));
    }

    proptest! {
        #[test]
        fn the_length_follows_from_the_number_of_samples(count in 0_usize..300) {
            let frame = Frame::new(0, 0, 0.0, &vec![point(5.0); count]);
            let sent = count.min(SAMPLES_MAX);
            prop_assert_eq!(frame.samples() as usize, sent);
            prop_assert_eq!(frame.bytes(0).len(), HEADER_BYTES + 28 * sent + sent.next_multiple_of(4));
        }
    }
}
