use std::vec::Vec;

use proptest::prelude::*;

use super::*;

/// Any frame without NaN, so that frames can be compared.
fn frame() -> impl Strategy<Value = PlantFrame> {
    let real = || -200.0f32..200.0;
    let message = prop_oneof![
        any::<u32>().prop_map(|period_us| PlantMessage::Reset { period_us }),
        any::<u64>().prop_map(|seed| PlantMessage::Seed { seed }),
        (real(), any::<bool>()).prop_map(|(u_in, u_out)| PlantMessage::Step { u_in, u_out }),
        real().prop_map(|pressure| PlantMessage::Ready { pressure }),
        real().prop_map(|pressure| PlantMessage::Pressure { pressure }),
        real().prop_map(|pressure| PlantMessage::Peep { pressure }),
        any::<u32>().prop_map(|version| PlantMessage::Hello { version }),
        (any::<u16>(), any::<u16>(), any::<u32>()).prop_map(|(version, highest, period_us)| {
            PlantMessage::Greeting { version, highest, period_us }
        }),
        (real(), real()).prop_map(|(pressure, airway)| PlantMessage::Truth { pressure, airway }),
    ];
    (any::<u16>(), message).prop_map(|(tick, message)| PlantFrame { tick, message })
}

fn feed(decoder: &mut PlantDecoder, bytes: &[u8]) -> Vec<PlantFrame> {
    bytes.iter().filter_map(|byte| decoder.push(*byte)).collect()
}

/// Made with Python: `struct.pack("<BBHfI", 0xA5, 2, 258, 37.5, 1)` and `zlib.crc32`.
const PYTHON_STEP: [u8; FRAME_BYTES] =
    [0xA5, 0x02, 0x02, 0x01, 0x00, 0x00, 0x16, 0x42, 0x01, 0x00, 0x00, 0x00, 0x12, 0xF5, 0x62, 0x9F];

#[test]
fn a_step_has_the_bytes_that_python_packs() {
    let frame = PlantFrame { tick: 258, message: PlantMessage::Step { u_in: 37.5, u_out: true } };
    assert_eq!(frame.encode(), PYTHON_STEP);
}

/// Made with Python: `struct.pack("<BBHHHI", 0xA5, 8, 1, 1, 120, 30000)` and `zlib.crc32`.
const PYTHON_GREETING: [u8; FRAME_BYTES] =
    [0xA5, 0x08, 0x01, 0x00, 0x01, 0x00, 0x78, 0x00, 0x30, 0x75, 0x00, 0x00, 0x34, 0x52, 0x4B, 0x47];

#[test]
fn a_greeting_has_the_bytes_that_python_packs() {
    let message = PlantMessage::Greeting { version: 1, highest: 120, period_us: 30_000 };
    assert_eq!(PlantFrame { tick: 1, message }.encode(), PYTHON_GREETING);
}

/// The document shows two frames as bytes.
#[test]
fn the_frames_of_the_document_are_these() {
    let document = include_str!("../../../../docs/PLANT_LINK.md");
    let hello = PlantMessage::Hello { version: VERSION.into() };
    let greeting = PlantMessage::Greeting { version: VERSION, highest: 150, period_us: 30_000 };
    for message in [hello, greeting] {
        let bytes = PlantFrame { tick: 1, message }.encode();
        let words =
            bytes.as_chunks::<4>().0.iter().map(|word| std::format!("{:08X}", u32::from_be_bytes(*word)));
        let shown = words.collect::<Vec<_>>().join(" ");
        assert!(document.contains(&shown), "{shown}");
    }
}

#[test]
fn values_outside_of_the_table_are_refused_in_spite_of_the_checksum() {
    let forged = |at: usize, value: u8| {
        let mut bytes = PYTHON_STEP;
        bytes[at] = value;
        let checksum = crc32(&bytes[..12]);
        bytes[12..].copy_from_slice(&checksum.to_le_bytes());
        PlantFrame::decode(&bytes)
    };
    assert!(forged(8, 0).is_some());
    for (at, value) in [(0, 0xA4), (1, 0), (1, 1), (1, 7), (1, 10), (8, 2), (11, 1)] {
        assert_eq!(forged(at, value), None, "byte {at} = {value}");
    }
}

#[test]
fn a_pressure_that_is_no_number_arrives_as_it_was_sent() {
    let message = PlantMessage::Pressure { pressure: f32::NAN };
    let back = PlantFrame::decode(&PlantFrame { tick: 0, message }.encode()).unwrap();
    assert!(matches!(back.message, PlantMessage::Pressure { pressure } if pressure.is_nan()));
}

/// A frame that begins with the last half of the one before it.
#[test]
fn the_bytes_of_a_frame_are_no_part_of_the_next() {
    let airway = f32::from_bits(u32::from_le_bytes([START, 9, 1, 2]));
    let first = PlantFrame { tick: 7, message: PlantMessage::Truth { pressure: 20.0, airway } };
    let sent = first.encode();
    let checksum = u32::from_le_bytes([sent[12], sent[13], sent[14], sent[15]]);
    let overlapping = PlantMessage::Truth { pressure: f32::from_bits(checksum), airway: 0.0 };
    let second = PlantFrame { tick: 0x0201, message: overlapping }.encode();
    assert_eq!(second[..8], sent[8..]);
    let mut decoder = PlantDecoder::default();
    assert_eq!(feed(&mut decoder, &sent).len(), 1);
    assert_eq!(feed(&mut decoder, &second[8..]).len(), 0);
}

proptest! {
    #[test]
    fn frames_come_back(frames in prop::collection::vec(frame(), 1..10)) {
        let mut decoder = PlantDecoder::default();
        let stream: Vec<u8> = frames.iter().flat_map(PlantFrame::encode).collect();
        prop_assert_eq!(feed(&mut decoder, &stream), frames);
        prop_assert_eq!(decoder.skipped(), 0);
    }

    #[test]
    fn no_flipped_bit_and_no_lost_byte_makes_another_frame(frame in frame(), next in frame()) {
        let bytes = frame.encode();
        for bit in 0..8 * FRAME_BYTES {
            let mut flipped = bytes;
            flipped[bit / 8] ^= 1 << (bit % 8);
            let stream = [flipped, next.encode()].concat();
            prop_assert_eq!(feed(&mut PlantDecoder::default(), &stream), std::vec![next]);
        }
        for lost in 0..FRAME_BYTES {
            let mut stream = [bytes, next.encode()].concat();
            stream.remove(lost);
            let good = feed(&mut PlantDecoder::default(), &stream);
            // A lost last byte of 0xA5 is replaced by the next frame's start byte, which costs that frame.
            prop_assert!(good == [next] || good == [frame]);
        }
    }

    #[test]
    fn after_any_garbage_the_next_frame_arrives(
        garbage in prop::collection::vec(prop_oneof![Just(START), any::<u8>()], 0..200), frame in frame(),
    ) {
        let mut decoder = PlantDecoder::default();
        let mut stream = garbage.clone();
        stream.extend(frame.encode());
        prop_assert_eq!(feed(&mut decoder, &stream), std::vec![frame]);
        prop_assert_eq!(decoder.skipped() as usize, garbage.len());
    }
}
