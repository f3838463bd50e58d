//! Properties that must be true for any external input: one function per target, for the fuzzer and for the test in
//! `tests/tests/fuzz.rs`, which runs the same functions on seeds and mutations.

use shared::calibration::Calibration;
use shared::checksum::{CHECKSUM_BYTES, crc32, verified};
use shared::device::control::Control;
use shared::device::server::{Answer, DeviceFacts, Server, Store};
use shared::link::frame::{DECODER_BYTES, FRAME_BYTES, FrameDecoder, Poll, encode_frame};
use shared::link::messages::{DeviceKind, ToDevice, ToHost, greeted_protocol, read_reply, read_request};
use shared::link::plant_link;
use shared::link::refusal::Refusal;
use shared::recorder::{Boot, LogEntry, Recorder, RecorderMemory, TickEntry};
use shared::ventilator::Mode;
use shared::weights::slots::{Slot, SlotState, StoreError};
use shared::weights::trust::seal;
use shared::weights::{IMAGE_BYTES, SIGNED_BYTES, decode, encode};

/// Core clock of the device, Hz.
const CORE_HZ: u32 = 168_000_000;

/// Every run of bytes between zeros is counted once, as a good or a corrupt frame; a content and its checksum are verified
/// again.
pub fn frames(data: &[u8]) {
    let mut decoder = FrameDecoder::<DECODER_BYTES>::new();
    let (mut good, mut bad) = (0, 0);
    for byte in data.iter().chain(&[0]) {
        match decoder.push(*byte) {
            Poll::Pending => {}
            Poll::Frame(content) => {
                good += 1;
                let mut bytes = content.to_vec();
                bytes.extend_from_slice(&crc32(content).to_le_bytes());
                assert_eq!(verified(&bytes), Some(content));
            }
            Poll::Corrupt(_) => bad += 1,
        }
    }
    let runs = data.split(|byte| *byte == 0).filter(|run| !run.is_empty()).count();
    let counters = decoder.counters();
    assert_eq!((counters.frames as usize, counters.corrupt() as usize), (good, bad));
    assert_eq!(good + bad, runs);
    plant_frames(data);
}

/// A frame of the plant link is accepted only if encoding it again gives the same bytes.
fn plant_frames(data: &[u8]) {
    let (mut decoder, mut found) = (plant_link::PlantDecoder::default(), 0);
    for (index, byte) in data.iter().enumerate() {
        if let Some(frame) = decoder.push(*byte) {
            found += 1;
            let bytes = frame.encode();
            assert_eq!(data.get((index + 1).wrapping_sub(plant_link::FRAME_BYTES)..=index), Some(&bytes[..]));
        }
    }
    assert!(found * plant_link::FRAME_BYTES + decoder.skipped() as usize <= data.len());
}

/// Every decoded message fits into a frame and is unchanged after encoding and decoding it again.
pub fn messages(data: &[u8]) {
    if let Ok(request) = read_request(data) {
        let again = through(&request);
        assert_eq!(read_request(&again).map(|request| through(&request)), Ok(again));
    }
    if let Ok(reply) = read_reply(data) {
        let again = through(&reply);
        assert_eq!(read_reply(&again).map(|reply| through(&reply)), Ok(again));
    }
    let _ = greeted_protocol(data);
    for entry in data.as_chunks().0 {
        if let Some(tick) = TickEntry::read(*entry) {
            assert!(tick.pressure.is_nan() || tick.pressure.abs() < 230.0);
        }
    }
    for entry in data.as_chunks().0 {
        let _ = LogEntry::read(*entry);
    }
}

/// Encodes and decodes a message as a frame; returns the content. Callers compare bytes, since NaN does not equal itself.
fn through<M: serde::Serialize>(message: &M) -> Vec<u8> {
    let (mut buffer, mut decoder) = ([0; FRAME_BYTES], FrameDecoder::<DECODER_BYTES>::new());
    let frame = encode_frame(message, &mut buffer).expect("every message fits into a frame");
    let mut content = Vec::new();
    for byte in frame {
        if let Poll::Frame(arrived) = decoder.push(*byte) {
            content = arrived.to_vec();
        }
    }
    content
}

/// An image is accepted only if packing it again gives the same bytes. This is also checked with a corrected checksum, since
/// an attacker or a faulty trainer could send a damaged image with the right checksum.
pub fn weights(data: &[u8]) {
    accept(data);
    if let Some(image) = data.get(..IMAGE_BYTES) {
        let mut mended = image.to_vec();
        let (covered, checksum) = mended.split_at_mut(IMAGE_BYTES - CHECKSUM_BYTES);
        checksum.copy_from_slice(&crc32(covered).to_le_bytes());
        accept(&mended);
    }
}

fn accept(data: &[u8]) {
    let Ok(image) = decode(data) else { return };
    let mut again = [0; IMAGE_BYTES];
    encode(&image.residual, &image.identity, &mut again).expect("there is room");
    let signature = data[SIGNED_BYTES..].first_chunk().expect("an image holds a signature");
    seal(&mut again, image.version, |_| *signature);
    assert_eq!(data.get(..IMAGE_BYTES), Some(&again[..]));
}

/// With any input each request is answered once with its sequence number, and the valves are safe unless a breath runs.
pub fn device(data: &[u8]) {
    conversation(data);
}

/// All messages that a device sends in response to a stream of bytes.
pub fn conversation(data: &[u8]) -> Vec<ToHost> {
    let (memory, mut said) = (Box::new(RecorderMemory::new()), Vec::new());
    let mut rig = Rig::new(&memory);
    for (number, byte) in data.iter().enumerate() {
        said.extend(rig.hear(*byte));
        if number % 16 == 0 {
            // A pressure reading that depends on the byte.
            said.extend(rig.tick(if *byte == 0xEE { f32::NAN } else { f32::from(*byte) / 4.0 }));
        }
    }
    said
}

/// Flash that takes everything and keeps nothing.
struct NoFlash;

impl Store for NoFlash {
    fn store_weights(&mut self, _: &[u8; IMAGE_BYTES]) -> (Result<Slot, StoreError>, [SlotState; 2]) {
        (Ok(Slot::A), [SlotState::Torn; 2])
    }

    fn store_calibration(&mut self, _: &Calibration) -> Result<u16, Refusal> {
        Ok(1)
    }

    fn calibration(&mut self, _: u16) -> (u16, Option<Calibration>) {
        (0, None)
    }
}

struct Rig<'a> {
    recorder: Recorder<'a>,
    control: Control,
    server: Server<'a>,
    decoder: FrameDecoder<DECODER_BYTES>,
    ticks: u32,
}

impl<'a> Rig<'a> {
    fn new(memory: &'a RecorderMemory) -> Self {
        let facts = DeviceFacts::blank(DeviceKind::HardwareInTheLoop);
        let boot = Boot { cause: facts.reset, failed: false, weights: None, restored: false };
        Self {
            recorder: Recorder::attach(memory, boot),
            control: Control::new(facts.device, facts.period_us, CORE_HZ).expect("the period is in bounds"),
            server: Server::new(facts, memory),
            decoder: FrameDecoder::new(),
            ticks: 0,
        }
    }

    fn hear(&mut self, byte: u8) -> Option<ToHost> {
        let request = match self.decoder.push(byte) {
            Poll::Frame(content) => read_request(content),
            Poll::Pending | Poll::Corrupt(_) => return None,
        };
        match request {
            Ok(request) => Some(self.serve(&request)),
            Err(unreadable) => unreadable.refusal(),
        }
    }

    fn serve(&mut self, request: &ToDevice) -> ToHost {
        let Answer { message, .. } = self.server.serve(request, self.ticks, &mut self.control, &mut NoFlash);
        let answered = matches!(message, ToHost::Response { sequence, .. } if sequence == request.sequence);
        assert!(answered, "{request:?}: {message:?}");
        message
    }

    fn tick(&mut self, reading: f32) -> Vec<ToHost> {
        let _ = self.control.plant_change();
        let output = self.control.step(reading);
        self.ticks += 1;
        assert!(output.mode == Mode::Ventilating || (output.command.u_out() && output.command.u_in() <= 0.0));
        assert!((0.0..=100.0).contains(&output.command.u_in()));
        self.recorder.record(&self.control.moment(reading, &output, 0));
        let (Self { control, server, .. }, mut events) = (self, Vec::new());
        control.report(&output, &mut |report| {
            events.extend(server.report(&report));
            true
        });
        events
    }
}
