//! Runs the fuzz targets with the stable compiler, on the committed seeds and on mutations that are the same on every
//! machine; and decodes ten million damaged frames, of which none may be accepted as another one.
//!
//! If a fuzzer finds a failing input, put the file into `fuzz/seeds/<target>`, so that this test always runs it.
//! `EUPNEA_BLESS=1` regenerates the seeds that cover every message.

use std::fs;
use std::path::{Path, PathBuf};

use rand_chacha::ChaCha8Rng;
use rand_core::{Rng, SeedableRng};
use serde::Serialize;
use shared::breath::paper_settings;
use shared::control::memory::Lesson;
use shared::device::self_test::Check;
use shared::explore::Exploration;
use shared::link::frame::{DECODER_BYTES, FRAME_BYTES, FrameDecoder, Poll, encode_frame};
use shared::link::host_name::HostName;
use shared::link::messages::{CHUNK_BYTES, ControllerChoice, Event, Request, ToDevice, ToHost, read_request};
use shared::link::plant_link;
use shared::link::telemetry::BreathSummary;
use shared::recorder::RecorderPart;
use shared::safety::alarms::Fault;
use shared::weights::IMAGE_BYTES;
use tests::trace::LEARNED;

#[path = "../../fuzz/targets.rs"]
mod targets;

/// Frames of the long run; without an optimiser, as in a plain `cargo test`, ten million would take minutes.
const FRAMES: u32 = if cfg!(debug_assertions) { 100_000 } else { 10_000_000 };

fn folder(target: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../fuzz/seeds").join(target)
}

/// Seeds of a target, sorted by name.
fn seeds(target: &str) -> Vec<Vec<u8>> {
    let entries = fs::read_dir(folder(target)).expect("the target has seeds");
    let mut files: Vec<PathBuf> = entries.map(|entry| entry.expect("a seed").path()).collect();
    files.sort();
    assert!(!files.is_empty(), "no seeds in {}", folder(target).display());
    files.iter().map(|file| fs::read(file).expect("a seed can be read")).collect()
}

/// Bytes from a seeded generator.
struct Dice(ChaCha8Rng);

impl Dice {
    fn new(seed: u64) -> Self {
        Self(ChaCha8Rng::seed_from_u64(seed))
    }

    fn below(&mut self, end: usize) -> usize {
        self.0.next_u32() as usize % end.max(1)
    }

    fn byte(&mut self) -> u8 {
        // More zeros and 0xFF, since lengths, signs and delimiters often contain them.
        match self.below(4) {
            0 => 0,
            1 => 0xFF,
            _ => self.0.next_u32() as u8,
        }
    }

    /// Damages bytes in a way that is typical of lines, memories or programs.
    fn mutate(&mut self, bytes: &mut Vec<u8>, other: &[u8]) {
        let at = self.below(bytes.len());
        match (self.below(7), bytes.is_empty()) {
            (0, false) => bytes[at] ^= 1 << self.below(8),
            (1, false) => bytes[at] = self.byte(),
            (2, false) => drop(bytes.remove(at)),
            (3, false) => bytes.truncate(at),
            (4, _) => bytes.insert(at, self.byte()),
            (5, _) => {
                let part = &other[self.below(other.len())..];
                bytes.splice(at..at, part.iter().take(40).copied());
            }
            _ => {
                let end = bytes.len().min(at + 8);
                let part = bytes[at..end].to_vec();
                bytes.extend_from_slice(&part);
            }
        }
    }
}

/// Runs a target on its seeds, unchanged and with `mutations` mutations.
fn run(target: &str, function: fn(&[u8]), mutations: u64) {
    let seeds = seeds(target);
    for seed in &seeds {
        function(seed);
    }
    let mut dice = Dice::new(mutations);
    for _ in 0..mutations {
        let mut bytes = seeds[dice.below(seeds.len())].clone();
        let other = &seeds[dice.below(seeds.len())];
        for _ in 0..=dice.below(4) {
            dice.mutate(&mut bytes, other);
        }
        function(&bytes);
    }
}

#[test]
fn no_bytes_upset_the_frame_decoder() {
    run("frames", targets::frames, 100_000);
}

#[test]
fn no_bytes_upset_the_messages() {
    run("messages", targets::messages, 200_000);
}

#[test]
fn no_bytes_upset_a_device() {
    run("device", targets::device, 10_000);
}

#[test]
fn no_bytes_become_weights_that_were_not_packed() {
    run("weights", targets::weights, 2_000);
}

/// One request of every kind.
fn requests() -> Vec<Request> {
    let image = u32::from_le_bytes(*LEARNED.last_chunk().expect("an image ends with its id"));
    vec![
        Request::Identify,
        Request::AcquireLease { name: HostName::new("anna@icu"), take_over: false },
        Request::GetSettings,
        Request::ApplySettings(paper_settings(20.0)),
        Request::QueueSettings(paper_settings(30.0)),
        Request::Start,
        Request::Stop,
        Request::Acknowledge,
        Request::SetController(ControllerChoice::Pid(shared::device::KNOWN_GOOD)),
        Request::SetController(ControllerChoice::Learned),
        Request::SetExploration(Some(Exploration::default())),
        Request::Telemetry { on: true },
        Request::BeginWeights { length: IMAGE_BYTES as u32, id: image },
        Request::WeightsChunk {
            offset: 0,
            bytes: LEARNED[..CHUNK_BYTES].try_into().expect("a chunk has room for it"),
        },
        Request::CommitWeights,
        Request::CommitBench,
        Request::GetTiming { clear: true },
        Request::ResetPlant { seed: 1 << 40 },
        Request::GetRecorder,
        Request::ReadRecorder { part: RecorderPart::Log, from: 0 },
        Request::ClearRecorder,
        Request::GetAlarms,
        Request::PauseAudio { seconds: 120 },
        Request::GetAudio,
        Request::GetSelfTest,
        Request::RunSelfTest(Check::Circuit),
        Request::Reset,
        Request::GetLease,
        Request::ReleaseLease,
    ]
}

fn frame(sequence: u16, request: Request) -> Vec<u8> {
    framed(&ToDevice { sequence, request, host: Some(300) })
}

fn framed<M: Serialize>(message: &M) -> Vec<u8> {
    let mut buffer = [0; FRAME_BYTES];
    encode_frame(message, &mut buffer).expect("every message fits").to_vec()
}

/// The device's replies to these frames, and the events that take longer.
fn replies(frames: &[u8]) -> Vec<ToHost> {
    let breath = BreathSummary {
        breath: 7,
        mean_absolute_error: 1.5,
        peak_pressure: 21.0,
        end_pressure: 5.0,
        leak: Some(0.01),
        lesson: Lesson::Discard,
        adopted: 2,
    };
    let alarm = Event::Alarm { fault: Fault::HighPressure, tick: 1 << 33 };
    let again = Event::Unacknowledged { fault: Fault::HighPressure, tick: 1 << 33 };
    let events = [Event::Breath(breath), alarm, again].map(ToHost::Event);
    targets::conversation(frames).into_iter().chain(events).collect()
}

/// A frame of each kind on the plant link.
fn plant_frames() -> Vec<u8> {
    let messages = [
        plant_link::PlantMessage::Reset { period_us: 1000 },
        plant_link::PlantMessage::Step { u_in: 50.0, u_out: false },
        plant_link::PlantMessage::Peep { pressure: 5.0 },
        plant_link::PlantMessage::Seed { seed: 9 },
        plant_link::PlantMessage::Ready { pressure: 5.0 },
        plant_link::PlantMessage::Pressure { pressure: 20.0 },
    ];
    (0..)
        .zip(messages)
        .flat_map(|(tick, message)| plant_link::PlantFrame { tick, message }.encode())
        .collect()
}

fn content(frame: &[u8]) -> Vec<u8> {
    let mut decoder = FrameDecoder::<DECODER_BYTES>::new();
    let mut content = Vec::new();
    for byte in frame {
        if let Poll::Frame(arrived) = decoder.push(*byte) {
            content = arrived.to_vec();
        }
    }
    content
}

/// Files and content of the seeds that a change of a message makes outdated.
fn fresh_seeds() -> Vec<(PathBuf, Vec<u8>)> {
    let frames: Vec<_> = (0..).zip(requests()).map(|(number, request)| frame(number, request)).collect();
    let mut seeds = vec![
        (folder("frames").join("requests"), frames.concat()),
        (folder("frames").join("plant"), plant_frames()),
        (folder("device").join("requests"), with_time(&frames)),
        (folder("weights").join("learned"), LEARNED.to_vec()),
    ];
    for (number, frame) in frames.iter().enumerate() {
        seeds.push((folder("messages").join(format!("request-{number:02}")), content(frame)));
    }
    let replies = replies(&with_time(&frames));
    for (number, reply) in replies.iter().enumerate() {
        seeds.push((folder("messages").join(format!("reply-{number:02}")), content(&framed(reply))));
    }
    seeds
}

/// Frames separated by bytes outside frames, during which control ticks pass.
fn with_time(frames: &[Vec<u8>]) -> Vec<u8> {
    frames.iter().flat_map(|frame| [&frame[..], &[0; 64]].concat()).collect()
}

#[test]
fn the_seeds_hold_every_message() {
    for (file, bytes) in fresh_seeds() {
        if tests::blesses() {
            fs::create_dir_all(file.parent().expect("a folder")).expect("the folder can be made");
            fs::write(&file, &bytes).expect("the seed can be written");
        }
        let found = fs::read(&file).unwrap_or_default();
        assert!(
            found == bytes,
            "{} is outdated; run: EUPNEA_BLESS=1 cargo test -p tests --test fuzz",
            file.display()
        );
    }
}

/// Damaged or random frames in one stream: none is accepted as another frame, and each is counted. Verifies: frame-checks.
#[test]
fn no_damaged_frame_gets_through_as_another() {
    let frames: Vec<Vec<u8>> =
        (0..).zip(requests()).map(|(number, request)| frame(number, request)).collect();
    let contents: Vec<Vec<u8>> = frames.iter().map(|frame| content(frame)).collect();
    let (mut dice, mut decoder) = (Dice::new(10), FrameDecoder::<DECODER_BYTES>::new());
    let (mut runs, mut good, mut bad, mut bytes) = (0, 0, 0, Vec::new());
    for _ in 0..FRAMES {
        let chosen = dice.below(frames.len());
        bytes.clear();
        if dice.below(4) == 0 {
            let length = dice.below(24);
            bytes.extend((0..length).map(|_| dice.byte()));
            bytes.push(0);
        } else {
            bytes.extend_from_slice(&frames[chosen]);
            for _ in 0..dice.below(3) {
                dice.mutate(&mut bytes, &frames[chosen]);
            }
            // The missing end of a frame must not affect the next one.
            bytes.push(0);
        }
        runs += bytes.split(|byte| *byte == 0).filter(|run| !run.is_empty()).count();
        for byte in &bytes {
            match decoder.push(*byte) {
                Poll::Pending => {}
                Poll::Frame(arrived) => {
                    good += 1;
                    // Eight bytes of 0xFF are a content with its right checksum, but must not be a request.
                    let sent = contents.iter().any(|content| content == arrived);
                    assert_eq!(read_request(arrived).is_ok(), sent, "{arrived:02x?}");
                }
                Poll::Corrupt(_) => bad += 1,
            }
        }
    }
    let counters = decoder.counters();
    assert_eq!((counters.frames as usize, counters.corrupt() as usize), (good, bad));
    assert_eq!(good + bad, runs);
    assert!(good > FRAMES as usize / 5 && bad > FRAMES as usize / 3, "{good} good, {bad} bad");
}
