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
