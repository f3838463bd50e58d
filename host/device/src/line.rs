//! The thread that reads a device's line, and the half that writes to it.

use std::io::{self, ErrorKind, Read, Write};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, Sender, channel};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::{self, JoinHandle};
use std::time::Duration;

use shared::link::frame::{DECODER_BYTES, FRAME_BYTES, FrameDecoder, Poll, encode_frame};
use shared::link::messages::{Event, Response, ToDevice, ToHost, greeted_protocol, read_reply};
use shared::link::telemetry::LossCounter;

use crate::port::Port;
use monitoring::LineCounters;

/// Number of bytes read at once.
const CHUNK: usize = 4096;
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
    counters: Arc<Mutex<LineCounters>>,
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
        let counters = Arc::new(Mutex::new(LineCounters::default()));
        let reader = Reader {
            answers,
            events,
            losses: LossCounter::default(),
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
        *self.counters.lock().unwrap_or_else(PoisonError::into_inner)
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
    counters: Arc<Mutex<LineCounters>>,
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
                    for byte in &chunk[..count] {
                        if !self.take(*byte) {
                            return;
                        }
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

    /// Processes a byte; false when the receiver has gone.
    fn take(&mut self, byte: u8) -> bool {
        let message = match self.decoder.push(byte) {
            Poll::Pending => return true,
            Poll::Frame(content) => read_reply(content).map_err(|_| greeted_protocol(content)),
            Poll::Corrupt(_) => Err(None),
        };
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
        counters.frames = self.decoder.counters().frames.into();
        counters.corrupt = self.decoder.counters().corrupt().into();
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
            (counters.lost_batches, counters.device) = (self.losses.lost(), batch.counters);
        }
    }
}

/// Whether a failed read may succeed later.
pub(crate) fn patient(kind: ErrorKind) -> bool {
    matches!(kind, ErrorKind::TimedOut | ErrorKind::WouldBlock | ErrorKind::Interrupted)
}
