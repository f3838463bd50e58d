use std::vec::Vec;

use postcard::ser_flavors::crc::CrcModifier;
use postcard::ser_flavors::{Cobs, Slice};

use proptest::prelude::*;

use super::*;
use crate::checksum::CRC_32;

type Decoder = FrameDecoder<DECODER_BYTES>;

/// Any message as a frame: a list of bytes, full of zeros and long runs without them.
fn frame(content: &[u8]) -> Vec<u8> {
    let mut buffer = [0; FRAME_BYTES];
    encode_frame(&content, &mut buffer).unwrap().to_vec()
}

fn content() -> impl Strategy<Value = Vec<u8>> {
    let byte = prop_oneof![Just(0u8), Just(255), any::<u8>(), 1u8..=255];
    prop_oneof![prop::collection::vec(byte, 0..300), prop::collection::vec(1u8..=255, 240..500),]
}

/// Decodes bytes; returns the contents of the good frames and the number of corrupt ones.
fn feed(decoder: &mut Decoder, bytes: &[u8]) -> (Vec<Vec<u8>>, u32) {
    let (mut good, mut bad) = (Vec::new(), 0);
    for byte in bytes {
        match decoder.push(*byte) {
            Poll::Pending => {}
            Poll::Frame(message) => good.push(postcard::from_bytes::<&[u8]>(message).unwrap().to_vec()),
            Poll::Corrupt(_) => bad += 1,
        }
    }
    (good, bad)
}

/// Asserts that the damaged frame is lost or decoded unchanged, and that the next frame is decoded.
fn survives(damaged: &[u8], original: &[u8]) {
    let next = b"the frame after it".to_vec();
    let mut stream = damaged.to_vec();
    stream.extend(frame(&next));
    let (good, _) = feed(&mut Decoder::new(), &stream);
    assert!(good.iter().all(|c| c == original || *c == next), "a different message was accepted");
    assert_eq!(good.last(), Some(&next));
}

#[test]
fn a_frame_is_cobs_of_message_and_checksum_between_zeros() {
    let mut buffer = [9; FRAME_BYTES];
    let checksum = [0x2c, 0x62, 0x2d, 0x39]; // of 0x12, 0x00, by Python's zlib.crc32
    let expected = [&[0, 2, 0x12, 5], &checksum[..], &[0]].concat();
    assert_eq!(encode_frame(&[0x12_u8, 0], &mut buffer).unwrap(), expected);
}

#[test]
fn full_blocks_have_the_bytes_that_postcards_cobs_gives_them() {
    for length in [253, 254, 255, 506, 507, 508, 509, 600, MESSAGE_BYTES - 2] {
        let content = std::vec![7; length];
        let mut expected = [0; FRAME_BYTES];
        let cobs = Cobs::try_new(Slice::new(&mut expected[1..])).unwrap();
        let checked = CrcModifier::new(cobs, CRC_32.digest());
        let written = postcard::serialize_with_flavor(&content, checked).unwrap().len();
        assert_eq!(frame(&content), expected[..=written], "{length}");
    }
}

#[test]
fn silence_between_frames_is_no_frame() {
    let mut decoder = Decoder::new();
    assert_eq!(feed(&mut decoder, &[0; 100]), (Vec::new(), 0));
    assert_eq!(*decoder.counters(), FrameCounters::default());
}

#[test]
fn a_frame_without_content_is_none_although_the_checksum_of_nothing_is_zero() {
    let mut decoder = Decoder::new();
    assert_eq!(feed(&mut decoder, &[1, 1, 1, 1, 1, 0]), (Vec::new(), 1));
    assert_eq!(decoder.counters().checksum, 1);
}

#[test]
fn each_kind_of_damage_is_counted_as_what_it_is() {
    let mut decoder = Decoder::new();
    let good = frame(b"hello");
    let mut wrong = good.clone();
    wrong[3] ^= 0x20;
    feed(&mut decoder, &good);
    feed(&mut decoder, &wrong);
    feed(&mut decoder, &[5, 1, 2, 0]);
    feed(&mut decoder, &[1; 2 * DECODER_BYTES]);
    feed(&mut decoder, &good);
    let expected = FrameCounters { frames: 2, checksum: 1, overlong: 1, cobs: 1 };
    assert_eq!(*decoder.counters(), expected);
}

#[test]
fn a_message_longer_than_the_buffer_is_refused() {
    for room in 0..12 {
        let mut buffer = [0; 12];
        assert_eq!(encode_frame(&[1u8; 8], &mut buffer[..room]), Err(FrameTooLong));
    }
    let mut buffer = [0; FRAME_BYTES];
    assert!(encode_frame(&[[1u8; 32]; MESSAGE_BYTES / 32], &mut buffer).is_ok());
}

proptest! {
    #[test]
    fn frames_hold_zeros_at_their_ends_only_and_come_back(contents in prop::collection::vec(content(), 1..5)) {
        let mut decoder = Decoder::new();
        for content in &contents {
            let frame = frame(content);
            prop_assert!(frame.iter().skip(1).position(|b| *b == 0) == Some(frame.len() - 2));
            prop_assert_eq!(feed(&mut decoder, &frame), (std::vec![content.clone()], 0));
        }
        prop_assert_eq!(decoder.counters().frames as usize, contents.len());
        prop_assert_eq!(decoder.counters().corrupt(), 0);
    }

    #[test]
    fn no_flipped_bit_makes_another_message(content in content()) {
        let mut bytes = frame(&content);
        for bit in 0..8 * bytes.len() {
            bytes[bit / 8] ^= 1 << (bit % 8);
            survives(&bytes, &content);
            bytes[bit / 8] ^= 1 << (bit % 8);
        }
    }

    #[test]
    fn no_lost_byte_makes_another_message(content in content()) {
        let bytes = frame(&content);
        for lost in 0..bytes.len() {
            let mut damaged = bytes.clone();
            damaged.remove(lost);
            survives(&damaged, &content);
        }
    }

    #[test]
    fn after_any_garbage_the_next_frame_arrives(garbage in prop::collection::vec(any::<u8>(), 0..2000), content in content()) {
        let mut decoder = Decoder::new();
        let mut stream = garbage;
        stream.extend(frame(&content));
        let (good, bad) = feed(&mut decoder, &stream);
        prop_assert_eq!(good, std::vec![content]);
        prop_assert_eq!(decoder.counters().corrupt(), bad);
    }

    /// In any stream every run of bytes between zeros is counted exactly once.
    #[test]
    fn counters_add_up(stream in prop::collection::vec(prop_oneof![Just(0u8), 0u8..8, any::<u8>()], 0..2000)) {
        let mut decoder = Decoder::new();
        for byte in &stream {
            decoder.push(*byte);
        }
        decoder.push(0);
        let runs = stream.split(|b| *b == 0).filter(|run| !run.is_empty()).count();
        let counters = decoder.counters();
        prop_assert_eq!((counters.frames + counters.corrupt()) as usize, runs);
    }
}

#[test]
fn the_buffers_hold_the_longest_message_and_hardly_more() {
    // 672 bytes and a CRC of 4; COBS adds 1 byte and 1 per 254; two delimiters.
    assert_eq!((DECODER_BYTES, FRAME_BYTES), (676, 681));
}
