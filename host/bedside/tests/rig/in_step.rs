//! A simulated device whose time passes as fast as it is watched, or not at all: it is polled by its own clock, so that a busy machine
//! makes no host silent.

use std::collections::VecDeque;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use bedside::source::{Source, Unable, Watch};
use bedside::stream::{DemoFault, Kind};
use monitoring::{News, POLLED};
use plant::bench::{BenchConfig, BenchPlant};
use shared::breath::DEFAULT_PERIOD_US;
use shared::control::pid::PidGains;
use shared::link::frame::{DECODER_BYTES, FRAME_BYTES, FrameDecoder, Poll, encode_frame};
use shared::link::host_name::HostName;
use shared::link::messages::{ControllerChoice, Request, Response, ToDevice, ToHost, read_reply};
use shared::link::refusal::Refusal;
use shared::recorder::RecorderMemory;
use virtual_chip::Chip;

/// Ticks between two looks of the hub at its pages.
const TICKS_AT_ONCE: u64 = 200;
/// Ticks between two polls.
const POLL_TICKS: u64 = 1000;

/// The time that the device may still run.
#[derive(Clone)]
pub struct Clock(Arc<AtomicU64>);

impl Clock {
    /// Lets so many ticks pass from now on.
    pub fn allow(&self, ticks: u64) {
        self.0.store(ticks, Ordering::Relaxed);
    }

    pub fn run(&self) {
        self.allow(u64::MAX);
    }
}

struct InStep {
    chip: Chip<'static>,
    decoder: FrameDecoder<DECODER_BYTES>,
    clock: Clock,
    ticks: u64,
    sequence: u16,
    news: VecDeque<News>,
}

/// A watched device on this bench, whose clock runs, with an airway sensor alone and a PID of these gains.
pub fn in_step(bench: &BenchConfig, gains: PidGains) -> (Watch, Clock) {
    let memory: &'static RecorderMemory = Box::leak(Box::new(RecorderMemory::new()));
    let clock = Clock(Arc::new(AtomicU64::new(u64::MAX)));
    let chip = Chip::new(BenchPlant::new(bench).unwrap(), memory);
    let (decoder, clock_) = (FrameDecoder::new(), clock.clone());
    let mut source = InStep { chip, decoder, clock: clock_, ticks: 0, sequence: 0, news: VecDeque::new() };
    let (name, kind, period_us) = (bench.name.clone(), Kind::Simulated, DEFAULT_PERIOD_US);
    source.exchange(Request::SetController(ControllerChoice::Pid(gains)));
    source.exchange(Request::ReleaseLease);
    let source = Box::new(source);
    (Watch { name, kind, period_us, source, verdict: None, recorder: None }, clock)
}

impl InStep {
    fn run(&mut self) {
        for _ in 0..TICKS_AT_ONCE {
            if self.ticks.is_multiple_of(POLL_TICKS) {
                for request in POLLED {
                    self.exchange(request);
                }
            }
            self.ticks += 1;
            self.chip.tick();
        }
        self.listen();
    }

    /// The answer to a request, which is news, too.
    fn exchange(&mut self, request: Request) {
        let mut answer = self.send(&request);
        if request.changes() && answer == Some(Response::Refused(Refusal::NoLease)) {
            let name = HostName::new("a test");
            self.send(&Request::AcquireLease { name, take_over: false });
            answer = self.send(&request);
        }
        let result = match answer.expect("the device answers") {
            Response::Refused(refusal) => Err(format!("the device refused: {refusal}")),
            response => Ok(response),
        };
        self.news.push_back(News::Answer { request, result });
    }

    fn send(&mut self, request: &Request) -> Option<Response> {
        self.listen();
        self.sequence = self.sequence.wrapping_add(1);
        let message = ToDevice { sequence: self.sequence, request: request.clone(), host: Some(1) };
        let mut buffer = [0; FRAME_BYTES];
        encode_frame(&message, &mut buffer).unwrap().iter().for_each(|byte| self.chip.hear(*byte));
        self.listen()
    }

    fn listen(&mut self) -> Option<Response> {
        let mut answer = None;
        for byte in std::mem::take(self.chip.out()) {
            let Poll::Frame(content) = self.decoder.push(byte) else { continue };
            match read_reply(content).unwrap() {
                ToHost::Response { response, .. } => answer = Some(response),
                ToHost::Event(event) => self.news.push_back(News::Event(event)),
            }
        }
        answer
    }
}

impl Source for InStep {
    fn next(&mut self, patience: Duration) -> Option<News> {
        if self.news.is_empty() && !patience.is_zero() {
            let left = self.clock.0.load(Ordering::Relaxed);
            if left == 0 {
                std::thread::sleep(patience);
            } else {
                self.run();
                // A test may have stopped it meanwhile.
                let rest = left.saturating_sub(TICKS_AT_ONCE);
                let _ = self.clock.0.compare_exchange(left, rest, Ordering::Relaxed, Ordering::Relaxed);
            }
        }
        self.news.pop_front()
    }

    fn ask(&mut self, request: Request) -> Result<(), Unable> {
        self.exchange(request);
        Ok(())
    }

    fn fault(&mut self, fault: DemoFault) -> Result<(), Unable> {
        self.chip.inject(fault.into());
        Ok(())
    }

    fn leave(self: Box<Self>) {}
}
