//! The host's end of a device's link: frames, losses, counters.

use monitoring::LineCounters;
use shared::link::frame::{DECODER_BYTES, FRAME_BYTES, FrameDecoder, Poll, encode_frame};
use shared::link::messages::{Event, Request, ToDevice, ToHost, greeted_protocol, read_reply};
use shared::link::telemetry::LossCounter;

/// A line to a device.
pub struct Line {
    decoder: FrameDecoder<DECODER_BYTES>,
    losses: LossCounter,
    counters: LineCounters,
    sequence: u16,
    /// Identifies this host.
    token: u32,
}

impl Line {
    /// A line on which nothing was sent. The token must differ from those of the device's other hosts; of a host that was there before,
    /// the device must not have answered the `sequence` after this one last.
    pub fn new(token: u32, sequence: u16) -> Self {
        let (losses, counters) = (LossCounter::default(), LineCounters::default());
        Self { decoder: FrameDecoder::new(), losses, counters, sequence, token }
    }

    /// The frame of a request, and its sequence number; none if the request is longer than a frame.
    pub fn frame(&mut self, request: Request) -> Option<(u16, Vec<u8>)> {
        self.sequence = self.sequence.wrapping_add(1);
        let message = ToDevice { sequence: self.sequence, request, host: Some(self.token) };
        let mut buffer = [0; FRAME_BYTES];
        let frame = encode_frame(&message, &mut buffer).ok()?;
        Some((self.sequence, frame.to_vec()))
    }

    /// Takes a byte of the device: the message that it completes, or the version of the protocol in the greeting of a device with
    /// another one.
    pub fn hear(&mut self, byte: u8) -> Option<Result<ToHost, u16>> {
        let heard = match self.decoder.push(byte) {
            Poll::Frame(content) => match (greeted_protocol(content), read_reply(content)) {
                (_, Ok(message)) => Some(Ok(message)),
                (Some(protocol), Err(_)) => Some(Err(protocol)),
                (None, Err(_)) => None,
            },
            _ => None,
        };
        if let Some(Ok(ToHost::Event(Event::Telemetry(batch)))) = &heard {
            self.losses.arrived(batch.sequence);
            (self.counters.lost_batches, self.counters.device) = (self.losses.lost(), batch.counters);
        }
        heard
    }

    /// Its counters.
    pub fn counters(&self) -> LineCounters {
        let counters = self.decoder.counters();
        let (frames, corrupt) = (counters.frames.into(), counters.corrupt().into());
        LineCounters { frames, corrupt, ..self.counters }
    }
}
