//! One simulated device, and the host's end of its link.

use bedside::steer::Wheel;
use bedside::watched::{Out, Watched};
use monitoring::{News, POLLED};
use plant::bench::{BenchConfig, BenchError, BenchPlant};
use shared::breath::DEFAULT_PERIOD_US;
use shared::control::pid::PidGains;
use shared::link::host_name::HostName;
use shared::link::messages::{ControllerChoice, Request, Response, ToHost};
use shared::link::refusal::Refusal;
use shared::recorder::RecorderMemory;
use shared::settings::Settings;
use shared::weights::IMAGE_BYTES;
use thiserror::Error;
use virtual_chip::{Chip, PlantFault};

use crate::line::Line;

/// Name of the page, for the device's lease and for those who read the state.
pub const PAGE: &str = "this page";
/// Identifies the page on the link of a device, which has no other host.
const HOST: u32 = 1;
/// Ticks between two polls of the device.
const POLL_TICKS: u32 = 1000;
/// Ticks between two attempts to start while the self-test runs, and most attempts.
const START: (u32, u32) = (20, 1500);
/// Why a device does not start.
#[derive(Debug, Error)]
pub enum PatientError {
    /// The bench cannot be built.
    #[error(transparent)]
    Bench(#[from] BenchError),
    /// The device refuses to ventilate.
    #[error("a simulated device does not start: {0}")]
    Refused(String),
}

/// A lung on a simulated device.
pub struct Patient {
    /// Name to show.
    pub name: String,
    /// What is known about the device.
    pub watched: Watched,
    /// Whether the page steers it.
    pub wheel: Wheel,
    /// Messages for the page.
    pub out: Vec<Out>,
    chip: Chip<'static>,
    line: Line,
    /// Ticks until the next poll.
    poll_in: u32,
}

impl Patient {
    /// Starts a device on this bench, which ventilates with the default settings: with a PID of these gains, or with learned weights.
    ///
    /// # Errors
    /// [`PatientError`].
    pub fn start(
        number: u8,
        title: &str,
        bench: &BenchConfig,
        controller: Result<PidGains, &[u8; IMAGE_BYTES]>,
    ) -> Result<Self, PatientError> {
        // The page's devices live as long as the page.
        let memory: &'static RecorderMemory = Box::leak(Box::new(RecorderMemory::new()));
        let mut chip = Chip::new(BenchPlant::new(bench)?, memory);
        chip.read_all_sensors();
        let choice = match controller {
            Ok(gains) => ControllerChoice::Pid(gains),
            Err(image) => {
                chip.boot_with(image);
                ControllerChoice::Learned
            }
        };
        let mut patient = Self {
            name: format!("{} {title}", bench.name),
            watched: Watched::new(number, DEFAULT_PERIOD_US),
            wheel: Wheel::default(),
            out: Vec::new(),
            chip,
            line: Line::new(HOST, 0),
            // Devices of one page are not all polled in the same instant.
            poll_in: 1 + u32::from(number) * 50 % POLL_TICKS,
        };
        patient.poll(0);
        let settings = Request::ApplySettings(Settings::default());
        for request in [Request::SetController(choice), settings, Request::Start, Request::ReleaseLease] {
            patient.ask(request, 0).map_err(PatientError::Refused)?;
        }
        patient.poll(0);
        Ok(patient)
    }

    /// Runs some ticks, at a time in ms since 1970.
    pub fn run(&mut self, ticks: u32, now_ms: u64) {
        for _ in 0..ticks {
            self.chip.tick();
            self.poll_in -= 1;
            if self.poll_in == 0 {
                self.poll_in = POLL_TICKS;
                self.poll(now_ms);
            }
        }
        self.listen(now_ms);
    }

    /// Injects a fault.
    pub fn inject(&mut self, fault: PlantFault) {
        self.chip.inject(fault);
    }

    /// Sends a request to the device; its answer also becomes news.
    ///
    /// # Errors
    /// The reason of a refusal.
    pub fn ask(&mut self, request: Request, now_ms: u64) -> Result<Response, String> {
        let mut answer = self.leased(&request, now_ms);
        // A start soon after power-up waits for the self-test.
        for _ in 0..START.1 {
            if answer != Some(Response::Refused(Refusal::SelfTestRuns)) {
                break;
            }
            (0..START.0).for_each(|_| self.chip.tick());
            self.listen(now_ms);
            answer = self.leased(&request, now_ms);
        }
        let result = match answer {
            Some(Response::Refused(refusal)) => Err(format!("the device refused: {refusal}")),
            Some(response) => Ok(response),
            None => Err("the device does not answer".to_owned()),
        };
        self.take(&News::Answer { request, result: result.clone() }, now_ms);
        result
    }

    /// The answer to a request, for which the lease is acquired if the device demands that.
    fn leased(&mut self, request: &Request, now_ms: u64) -> Option<Response> {
        let answer = self.exchange(request.clone(), now_ms);
        if request.changes() && answer == Some(Response::Refused(Refusal::NoLease)) {
            let acquire = Request::AcquireLease { name: HostName::new(PAGE), take_over: false };
            self.exchange(acquire, now_ms);
            return self.exchange(request.clone(), now_ms);
        }
        answer
    }

    fn exchange(&mut self, request: Request, now_ms: u64) -> Option<Response> {
        self.listen(now_ms);
        let (sequence, frame) = self.line.frame(request)?;
        for byte in frame {
            self.chip.hear(byte);
        }
        self.listen(now_ms).filter(|(answered, _)| *answered == sequence).map(|(_, response)| response)
    }

    fn poll(&mut self, now_ms: u64) {
        for request in POLLED {
            // A refusal is news, too.
            let _ = self.ask(request, now_ms);
        }
        self.take(&News::Traffic(self.line.counters()), now_ms);
    }

    /// Reads what the device has sent; returns its last answer, with the sequence number.
    fn listen(&mut self, now_ms: u64) -> Option<(u16, Response)> {
        let mut answer = None;
        for byte in std::mem::take(self.chip.out()) {
            match self.line.hear(byte) {
                Some(Ok(ToHost::Response { sequence, response })) => {
                    answer = Some((sequence, response));
                }
                Some(Ok(ToHost::Event(event))) => self.take(&News::Event(event), now_ms),
                Some(Err(_)) | None => {}
            }
        }
        answer
    }

    fn take(&mut self, news: &News, now_ms: u64) {
        self.watched.take(news, now_ms, &mut self.out);
    }
}
