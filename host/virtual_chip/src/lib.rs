//! A device without a chip: both halves of [`shared::device`] on the virtual bench. It replaces the firmware where there is no
//! emulator. It has neither clock nor line: its owner runs the ticks, and carries bytes to it and from it.
#![forbid(unsafe_code)]

mod flash;
mod rig;

use std::sync::{Arc, Mutex};

use plant::bench::{BenchPlant, Failure};
use plant::{TickTruth, locked};
use shared::breath::DEFAULT_PERIOD_US;
use shared::calibration::SensorCorrection;
use shared::device::control::Control;
use shared::device::self_test::BootFindings;
use shared::device::server::{DeviceFacts, Server, Store};
use shared::link::frame::{DECODER_BYTES, FRAME_BYTES, FrameDecoder, Poll, encode_frame};
use shared::link::messages::{DeviceKind, ToHost, read_request};
use shared::recorder::{Boot, Recorder, RecorderMemory};
use shared::reset::ResetCause;
use shared::sensor::Readings;
use shared::settings::Settings;
use shared::timing::TickTime;
use shared::ventilator::Mode;
use shared::weights::IMAGE_BYTES;

pub use flash::Flash;
pub use rig::{Rig, control};

/// The true states of a plant since it last restarted: entry `n` belongs to its `n`-th reading.
pub type TruthLog = Arc<Mutex<Vec<TickTruth>>>;

/// A fault of a simulated device, in its plant or its sensor.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum PlantFault {
    /// A part fails.
    Part(Failure),
    /// The patient coughs once, with this peak, cmH2O.
    Cough(f64),
    /// The reading of the pressure sensor stays at its last value.
    ReadingSticks,
    /// All faults end.
    None,
}

/// The state of a simulated chip.
pub struct Chip<'a> {
    memory: &'a RecorderMemory,
    recorder: Recorder<'a>,
    rig: Rig,
    server: Server<'a>,
    decoder: FrameDecoder<DECODER_BYTES>,
    flash: Flash,
    out: Vec<u8>,
    /// True states of the ticks, if they are kept.
    truths: Option<TruthLog>,
    /// Whether it reads all sensors of the bench, not only the one at the airway.
    all_sensors: bool,
    /// The reading at which the sensor sticks.
    stuck: Option<f32>,
}

impl<'a> Chip<'a> {
    /// A chip on a bench, after power-up. The memory of its flight recorder survives its restarts.
    pub fn new(bench: BenchPlant, memory: &'a RecorderMemory) -> Self {
        let mut flash = Flash::default();
        let (control, server, recorder) = boot(memory, ResetCause::PowerOn, &mut flash);
        Self {
            memory,
            recorder,
            rig: Rig::new(control, bench, Settings::default().peep),
            server,
            decoder: FrameDecoder::new(),
            flash,
            out: Vec::new(),
            truths: None,
            all_sensors: false,
            stuck: None,
        }
    }

    /// Starts again with these weights, which go into the first slot of a new chip.
    pub fn boot_with(&mut self, image: &[u8; IMAGE_BYTES]) {
        // This flash does not fail, and the start refuses an image that is not valid.
        let _ = self.flash.store_weights(image);
        self.restart(ResetCause::PowerOn);
    }

    fn restart(&mut self, cause: ResetCause) {
        let (control, server, recorder) = boot(self.memory, cause, &mut self.flash);
        self.rig.restart(control);
        (self.server, self.recorder) = (server, recorder);
    }

    /// Reads all sensors that the bench has from now on: the one at the outlet and the flow sensor too. A chip on the plant link has the
    /// airway sensor alone.
    pub fn read_all_sensors(&mut self) {
        self.all_sensors = true;
    }

    /// Keeps the true states from now on.
    pub fn keep_truths(&mut self, log: TruthLog) {
        self.truths = Some(log);
    }

    /// The true states, if they are kept.
    pub fn truths(&self) -> Option<&TruthLog> {
        self.truths.as_ref()
    }

    /// What it does.
    pub fn mode(&self) -> Mode {
        self.rig.control.mode()
    }

    /// What it has sent and nobody has taken yet.
    pub fn out(&mut self) -> &mut Vec<u8> {
        &mut self.out
    }

    /// Injects a fault into the plant or the sensor.
    pub fn inject(&mut self, fault: PlantFault) {
        match fault {
            PlantFault::Part(failure) => self.rig.plant.bench.fail(failure),
            PlantFault::Cough(peak) => self.rig.plant.bench.cough(peak),
            PlantFault::ReadingSticks => self.stuck = Some(self.readings().airway),
            PlantFault::None => {
                self.rig.plant.bench.restore();
                self.stuck = None;
            }
        }
    }

    /// What the chip reads.
    fn readings(&self) -> Readings {
        let readings = self.rig.readings();
        let airway = self.stuck.unwrap_or(readings.airway);
        if self.all_sensors { Readings { airway, ..readings } } else { Readings::from(airway) }
    }

    /// One control tick, as the firmware's control task runs it.
    pub fn tick(&mut self) {
        self.rig.run_plant();
        let restarted = self.rig.follow();
        self.keep_truth(restarted);
        let readings = self.readings();
        let output = self.rig.step(readings);
        let control = &mut self.rig.control;
        control.record(&TickTime { latency: 0, work: 0, period: Some(DEFAULT_PERIOD_US), missed: 0 });
        self.recorder.record(&control.moment(readings.airway, &output, 0));
        let mut reports = Vec::new();
        control.report(&output, &mut |report| {
            reports.push(report);
            true
        });
        for report in reports {
            for event in self.server.report(&report) {
                self.say(&event);
            }
        }
    }

    fn keep_truth(&self, restarted: bool) {
        let Some(truths) = &self.truths else { return };
        let mut truths = locked(truths);
        if restarted {
            truths.clear();
        }
        // Nobody asks for the truth of a standby.
        truths.extend(self.rig.reading.truth.filter(|_| self.mode() == Mode::Ventilating));
    }

    /// Receives a byte from the host.
    pub fn hear(&mut self, byte: u8) {
        let request = match self.decoder.push(byte) {
            Poll::Frame(content) => read_request(content),
            Poll::Pending | Poll::Corrupt(_) => return,
        };
        match request {
            Ok(request) => {
                let Rig { control, ticks, .. } = &mut self.rig;
                let answer = self.server.serve(&request, *ticks, control, &mut self.flash);
                self.say(&answer.message);
                if answer.restart {
                    self.restart(ResetCause::Software);
                }
            }
            Err(unreadable) => {
                if let Some(refusal) = unreadable.refusal() {
                    self.say(&refusal);
                }
            }
        }
        self.server.corrupt_frames(self.decoder.counters().corrupt());
    }

    fn say(&mut self, message: &ToHost) {
        let mut buffer = [0; FRAME_BYTES];
        if let Ok(frame) = encode_frame(message, &mut buffer) {
            self.out.extend_from_slice(frame);
        }
    }
}

/// Both halves and the flight recorder after a start, with what the flash contains.
fn boot<'a>(
    memory: &'a RecorderMemory,
    reset: ResetCause,
    flash: &mut Flash,
) -> (Control, Server<'a>, Recorder<'a>) {
    let mut stored = flash.slots();
    let newest = stored.load(|image| image.residual.clone());
    let slots = stored.states();
    let (running, learned) = newest.unzip();
    let weights = running.and_then(|slot| slots[slot as usize].id());
    let recorder = Recorder::attach(memory, Boot { cause: reset, failed: false, weights, restored: false });
    let facts = DeviceFacts { slots, running, reset, ..DeviceFacts::blank(DeviceKind::Simulated) };
    let mut control = control(learned.as_ref());
    control.require_self_test(&BootFindings { program: None, memory: None, slots });
    control.report_boot(reset, recorder.interrupted(), &slots);
    let (_, newest) = flash.calibration(0);
    if let Some(correction) = newest.and_then(|newest| SensorCorrection::new(&newest).ok()) {
        control.calibrate(correction);
    }
    (control, Server::new(facts, memory), recorder)
}
