//! The thread that reads a device's line, and the half that writes to it.

use std::fmt;
use std::io::{self, ErrorKind, Read, Write};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, Sender, channel};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::{self, JoinHandle};
use std::time::Duration;

use shared::link::PROTOCOL;
use shared::link::frame::{DECODER_BYTES, FRAME_BYTES, FrameDecoder, Poll, encode_frame};
use shared::link::messages::{Event, Response, ToDevice, ToHost, greeted_protocol, read_reply};
use shared::link::telemetry::LossCounter;

use crate::port::Port;
use monitoring::LineCounters;

/// What a line has brought that answers nothing.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Heard {
    /// Bytes of any kind.
    pub bytes: u64,
    /// Damaged frames.
    pub corrupt: u64,
    /// Sound frames without a message of this version, or with samples that no device can send.
    pub unreadable: u64,
    /// Answers, of whatever sequence number.
    pub answers: u64,
    /// Events.
    pub events: u64,
}

impl Heard {
    /// What came after `before`.
    #[must_use]
    pub(super) fn since(&self, before: &Self) -> Self {
        Self {
            bytes: self.bytes.wrapping_sub(before.bytes),
            corrupt: self.corrupt.wrapping_sub(before.corrupt),
            unreadable: self.unreadable.wrapping_sub(before.unreadable),
            answers: self.answers.wrapping_sub(before.answers),
            events: self.events.wrapping_sub(before.events),
        }
    }
}

impl fmt::Display for Heard {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { bytes, corrupt, unreadable, answers, events } = self;
        write!(
            f,
            "{bytes} bytes came, with {corrupt} damaged frames, {unreadable} without a message of protocol {PROTOCOL}, \
             {answers} answers under other sequence numbers and {events} events"
        )
    }
}

/// Number of bytes read at once.
const CHUNK: usize = 4096;
/// Tick that no device reaches, and up to which a page counts exactly.
const LAST_TICK: u64 = 1 << 53;
/// Pause after a read, to let more bytes arrive.
const LULL: Duration = Duration::from_millis(1);

/// A received answer.
pub(super) enum Answer {
    Response { sequence: u16, response: Box<Response> },
    OtherProtocol(u16),
}

/// A line with its reading thread.
pub(super) struct Line {
    writer: Box<dyn Write + Send>,
    pub(super) answers: Receiver<Answer>,
    pub(super) events: Receiver<Event>,
    pub(super) broken: Arc<AtomicBool>,
    counters: Arc<Mutex<(LineCounters, Heard)>>,
    closing: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl Line {
    /// Starts the reading thread.
    pub(super) fn start(port: Port) -> Self {
        let (answers, answered) = channel();
        let (events, happened) = channel();
        let broken = Arc::new(AtomicBool::new(false));
        let closing = Arc::new(AtomicBool::new(false));
        let counters = Arc::default();
        let reader = Reader {
            answers,
            events,
            losses: LossCounter::default(),
            heard: Heard::default(),
            counters: Arc::clone(&counters),
            decoder: FrameDecoder::new(),
        };
        let flags = (Arc::clone(&broken), Arc::clone(&closing));
        let thread = thread::spawn(move || {
            reader.run(port.reader, &flags.1);
            flags.0.store(true, Ordering::Relaxed);
        });
        let thread = Some(thread);
        Self { writer: port.writer, answers: answered, events: happened, broken, counters, closing, thread }
    }

    /// A line that is not open.
    pub(super) fn closed() -> Self {
        Self {
            writer: Box::new(io::sink()),
            answers: channel().1,
            events: channel().1,
            broken: Arc::new(AtomicBool::new(true)),
            counters: Arc::default(),
            closing: Arc::default(),
            thread: None,
        }
    }

    pub(super) fn send(&mut self, message: &ToDevice) -> io::Result<()> {
        let mut buffer = [0; FRAME_BYTES];
        let frame = encode_frame(message, &mut buffer).map_err(io::Error::other)?;
        self.send_raw(frame)
    }

    pub(super) fn send_raw(&mut self, bytes: &[u8]) -> io::Result<()> {
        self.writer.write_all(bytes)?;
        self.writer.flush()
    }

    pub(super) fn counters(&self) -> LineCounters {
        self.counters.lock().unwrap_or_else(PoisonError::into_inner).0
    }

    /// What has come so far.
    pub(super) fn heard(&self) -> Heard {
        self.counters.lock().unwrap_or_else(PoisonError::into_inner).1
    }

    /// Stops reading and closes the port.
    pub(super) fn end(&mut self) {
        self.closing.store(true, Ordering::Relaxed);
        if let Some(thread) = self.thread.take() {
            // The port is in use until the thread has ended. A thread that panicked has already reported it.
            let _ = thread.join();
        }
        self.writer = Box::new(io::sink());
    }
}

impl Drop for Line {
    fn drop(&mut self) {
        self.end();
    }
}

struct Reader {
    answers: Sender<Answer>,
    events: Sender<Event>,
    losses: LossCounter,
    heard: Heard,
    counters: Arc<Mutex<(LineCounters, Heard)>>,
    decoder: FrameDecoder<DECODER_BYTES>,
}

impl Reader {
    /// Reads until the line breaks or is closed.
    fn run(mut self, mut from: impl Read, closing: &AtomicBool) {
        let mut chunk = [0; CHUNK];
        while !closing.load(Ordering::Relaxed) {
            match from.read(&mut chunk) {
                Ok(0) => return,
                Ok(count) => {
                    if !self.take_all(&chunk[..count]) {
                        return;
                    }
                    // A virtual board sends byte by byte; waking up for each of them would slow it down.
                    thread::sleep(LULL);
                }
                Err(error) if patient(error.kind()) => {}
                Err(error) => {
                    tracing::debug!(%error, "the line broke");
                    return;
                }
            }
        }
    }

    /// Processes bytes; false when the receiver has gone.
    fn take_all(&mut self, bytes: &[u8]) -> bool {
        self.heard.bytes += bytes.len() as u64;
        let alive = bytes.iter().all(|byte| self.take(*byte));
        // Also without a whole frame: what answers nothing is counted.
        self.counters.lock().unwrap_or_else(PoisonError::into_inner).1 = self.heard;
        alive
    }

    /// Processes a byte; false when the receiver has gone.
    fn take(&mut self, byte: u8) -> bool {
        let message = match self.decoder.push(byte) {
            Poll::Pending => return true,
            Poll::Frame(content) => match read_reply(content) {
                Ok(message) if is_possible(&message) => Ok(message),
                Ok(_) => Err(None),
                Err(_) => Err(greeted_protocol(content)),
            },
            Poll::Corrupt(_) => Err(None),
        };
        self.heard.corrupt = self.decoder.counters().corrupt().into();
        match &message {
            Ok(ToHost::Response { .. }) => self.heard.answers += 1,
            Ok(ToHost::Event(_)) => self.heard.events += 1,
            Err(_) => {
                let sound: u64 = self.decoder.counters().frames.into();
                self.heard.unreadable = sound - self.heard.answers - self.heard.events;
            }
        }
        let alive = match message {
            Ok(ToHost::Response { sequence, response }) => {
                self.answers.send(Answer::Response { sequence, response: Box::new(response) }).is_ok()
            }
            Ok(ToHost::Event(event)) => {
                self.count_batch(&event);
                self.events.send(event).is_ok()
            }
            Err(Some(protocol)) => self.answers.send(Answer::OtherProtocol(protocol)).is_ok(),
            Err(None) => true,
        };
        let mut counters = self.counters.lock().unwrap_or_else(PoisonError::into_inner);
        counters.0.frames = self.decoder.counters().frames.into();
        counters.0.corrupt = self.heard.corrupt + self.heard.unreadable;
        alive
    }

    fn count_batch(&mut self, event: &Event) {
        if let Event::Telemetry(batch) = event {
            // A restarted device counts from zero again; that is not a loss of batches.
            if batch.sequence == 0 {
                self.losses = self.losses.restarted();
            }
            self.losses.arrived(batch.sequence);
            let mut counters = self.counters.lock().unwrap_or_else(PoisonError::into_inner);
            (counters.0.lost_batches, counters.0.device) = (self.losses.lost(), batch.counters);
        }
    }
}

/// Whether the ticks of an event can be those of a device: any display counts with them.
fn is_possible(message: &ToHost) -> bool {
    match message {
        ToHost::Event(Event::Telemetry(batch)) => !batch.samples.is_empty() && batch.first_tick < LAST_TICK,
        ToHost::Event(Event::Alarm { tick, .. } | Event::Unacknowledged { tick, .. }) => *tick < LAST_TICK,
        ToHost::Event(Event::Breath(_)) | ToHost::Response { .. } => true,
    }
}

/// Whether a failed read may succeed later.
pub(crate) fn patient(kind: ErrorKind) -> bool {
    matches!(kind, ErrorKind::TimedOut | ErrorKind::WouldBlock | ErrorKind::Interrupted)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use shared::link::refusal::Refusal;
    use shared::link::telemetry::{BreathSummary, Counters, PackedSample, TelemetryBatch};
    use shared::safety::alarms::Fault;
    use shared::ventilator::Sample;

    fn reader() -> (Reader, Receiver<Answer>, Receiver<Event>) {
        let ((answers, answered), (events, happened)) = (channel(), channel());
        let (losses, heard) = (LossCounter::default(), Heard::default());
        let reader =
            Reader { answers, events, losses, heard, counters: Arc::default(), decoder: FrameDecoder::new() };
        (reader, answered, happened)
    }

    fn batch(first_tick: u64, samples: usize) -> ToHost {
        let sample = Sample {
            breath: 0,
            tick: 0,
            phase: shared::breath::Phase::Inspiration,
            target: 20.0,
            pressure: 19.0,
            u_in: 30.0,
            u_out: false,
            explore: 0.0,
            learned: 0.0,
            flow: None,
        };
        let samples = (0..samples).map(|_| PackedSample::pack(&sample)).collect();
        ToHost::Event(Event::Telemetry(TelemetryBatch {
            sequence: 0,
            first_tick,
            counters: Counters::default(),
            samples,
        }))
    }

    fn framed(message: &ToHost) -> Vec<u8> {
        encode_frame(message, &mut [0; FRAME_BYTES]).unwrap().to_vec()
    }

    #[test]
    fn ticks_with_which_no_display_can_count_are_left_out_and_counted() {
        let (mut reader, _answered, happened) = reader();
        let (fault, tick) = (Fault::Apnoea, u64::MAX);
        for message in [
            batch(7, 0),
            batch(LAST_TICK, 1),
            batch(u64::MAX, 16),
            ToHost::Event(Event::Alarm { fault, tick }),
        ] {
            assert!(reader.take_all(&framed(&message)));
        }
        assert_eq!((happened.try_iter().count(), reader.heard.unreadable, reader.heard.events), (0, 4, 0));
        assert_eq!(reader.counters.lock().unwrap().0.corrupt, 4);
        reader.take_all(&framed(&batch(LAST_TICK - 1, 1)));
        assert_eq!(happened.try_iter().count(), 1);
    }

    fn messages() -> impl Strategy<Value = ToHost> {
        let summary = BreathSummary {
            breath: 3,
            mean_absolute_error: f32::NAN,
            peak_pressure: f32::INFINITY,
            end_pressure: 5.0,
            leak: None,
            lesson: shared::control::memory::Lesson::Adopt,
            adopted: 0,
        };
        prop_oneof![
            (any::<u64>(), 0usize..17).prop_map(|(tick, samples)| batch(tick, samples)),
            any::<u16>().prop_map(|sequence| {
                ToHost::Response { sequence, response: Response::Refused(Refusal::UnknownRequest) }
            }),
            Just(ToHost::Event(Event::Breath(summary))),
        ]
    }

    proptest! {
        /// Frames, some of them damaged or cut short, among bytes of chance.
        #[test]
        fn whatever_comes_is_passed_on_or_counted(
            parts in prop::collection::vec(
                prop_oneof![
                    prop::collection::vec(any::<u8>(), 0..40),
                    messages().prop_map(|message| framed(&message)),
                    (messages(), any::<prop::sample::Index>(), 1u8..=255).prop_map(|(message, place, flip)| {
                        let mut bytes = framed(&message);
                        let place = place.index(bytes.len());
                        bytes[place] ^= flip;
                        bytes
                    }),
                    (messages(), any::<prop::sample::Index>()).prop_map(|(message, place)| {
                        let bytes = framed(&message);
                        bytes[..place.index(bytes.len())].to_vec()
                    }),
                ],
                0..12,
            ),
        ) {
            let (mut reader, answered, happened) = reader();
            prop_assert!(parts.iter().all(|part| reader.take_all(part)));
            let heard = reader.heard;
            prop_assert_eq!(heard.bytes, parts.iter().map(|part| part.len() as u64).sum::<u64>());
            let events: Vec<Event> = happened.try_iter().collect();
            prop_assert!(events.iter().all(|event| is_possible(&ToHost::Event(event.clone()))));
            prop_assert_eq!(events.len() as u64, heard.events);
            let others = answered.try_iter().filter(|answer| matches!(answer, Answer::OtherProtocol(_))).count() as u64;
            let counters = *reader.decoder.counters();
            prop_assert!(others <= heard.unreadable);
            prop_assert_eq!(u64::from(counters.frames), heard.answers + heard.events + heard.unreadable);
            prop_assert_eq!(u64::from(counters.corrupt()), heard.corrupt);
        }
    }
}
