//! A device without a chip: both halves of [`shared::device`] on the virtual bench. It replaces the firmware where there is no
//! emulator. It has neither clock nor line: its owner runs the ticks, and carries bytes to it and from it.
#![forbid(unsafe_code)]

mod flash;

use std::sync::{Arc, Mutex};

use shared::breath::DEFAULT_PERIOD_US;
use shared::calibration::SensorCorrection;
use shared::calibration::stored::StoredCalibrations;
use shared::device::control::Control;
use shared::device::self_test::BootFindings;
use shared::device::server::{DeviceFacts, NextStep, Server};
use shared::link::frame::{DECODER_BYTES, FRAME_BYTES, FrameDecoder, Poll, encode_frame};
use shared::link::messages::{DeviceKind, ToDevice, ToHost, read_request};
use shared::link::refusal::Refusal;
use shared::recorder::{Boot, Recorder, RecorderMemory};
use shared::reset::ResetCause;
use shared::safety::filter::ValveCommand;
use shared::sensor::Readings;
use shared::timing::TickTime;
use shared::ventilator::Mode;
use shared::weights::slots::{Slot, SlotState};
use shared::weights::{IMAGE_BYTES, decode};

use flash::{Flash, SECTOR_BYTES};
use plant::bench::{BenchPlant, Failure};
use plant::{Plant, Reading, TickTruth, locked};

/// Clock rate that a simulated device reports, Hz; its ticks take no time.
const CORE_HZ: u32 = 1_000_000;

/// The reading of a bench that fails.
const NO_READING: Reading = Reading { pressure: f32::NAN, outlet: f32::NAN, flow: f32::NAN, truth: None };

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
    bench: BenchPlant,
    peep: f32,
    control: Control,
    server: Server<'a>,
    decoder: FrameDecoder<DECODER_BYTES>,
    ticks: u32,
    reading: f32,
    command: ValveCommand,
    /// The sector of the calibrations.
    flash: Flash,
    calibrations: StoredCalibrations,
    /// The weight slots.
    slots: [Option<[u8; IMAGE_BYTES]>; 2],
    newest: Option<Slot>,
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
        let (control, server, recorder) = boot(memory, ResetCause::PowerOn, &[None; 2], None);
        let mut flash = Flash::new();
        let calibrations = StoredCalibrations::open(&mut flash, 0, SECTOR_BYTES);
        let peep = shared::settings::Settings::default().peep;
        Self {
            memory,
            recorder,
            bench,
            peep,
            control,
            server,
            decoder: FrameDecoder::new(),
            ticks: 0,
            reading: peep,
            command: ValveCommand::SAFE,
            flash,
            calibrations,
            slots: [None; 2],
            newest: None,
            out: Vec::new(),
            truths: None,
            all_sensors: false,
            stuck: None,
        }
    }

    /// Starts again with these weights in the first slot.
    pub fn boot_with(&mut self, image: &[u8; IMAGE_BYTES]) {
        (self.slots[Slot::A as usize], self.newest) = (Some(*image), Some(Slot::A));
        (self.control, self.server, self.recorder) =
            boot(self.memory, ResetCause::PowerOn, &self.slots, self.newest);
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
        self.control.mode()
    }

    /// What it has sent and nobody has taken yet.
    pub fn out(&mut self) -> &mut Vec<u8> {
        &mut self.out
    }

    /// Injects a fault into the plant or the sensor.
    pub fn inject(&mut self, fault: PlantFault) {
        match fault {
            PlantFault::Part(failure) => self.bench.fail(failure),
            PlantFault::Cough(peak) => self.bench.cough(peak),
            PlantFault::ReadingSticks => self.stuck = Some(self.reading),
            PlantFault::None => {
                self.bench.restore();
                self.stuck = None;
            }
        }
    }

    /// One control tick, as the firmware's control task runs it.
    pub fn tick(&mut self) {
        let change = self.control.plant_change();
        self.peep = change.peep.unwrap_or(self.peep);
        let reading = match change.reset {
            Some(seed) => self.bench.reset(DEFAULT_PERIOD_US, seed, self.peep),
            None => self.bench.step(self.command.u_in(), self.command.u_out()),
        };
        if let (Ok(reading), Some(truths)) = (&reading, &self.truths) {
            let mut truths = locked(truths);
            if change.reset.is_some() {
                truths.clear();
            }
            // Nobody asks for the truth of a standby.
            truths.extend(reading.truth.filter(|_| self.control.mode() == Mode::Ventilating));
        }
        // A bench of this configuration was built before, so this never fails.
        let reading = reading.unwrap_or(NO_READING);
        self.reading = self.stuck.unwrap_or(reading.pressure);
        if let Some(peep) = change.peep {
            let _ = self.bench.set_peep(peep);
        }
        let mut readings = Readings::from(self.reading);
        if self.all_sensors {
            (readings.outlet, readings.flow) = (reading.outlet, reading.flow);
        }
        let output = self.control.step(readings);
        self.ticks = self.ticks.wrapping_add(1);
        self.command = output.command;
        self.control.record(&TickTime { latency: 0, work: 0, period: Some(DEFAULT_PERIOD_US), missed: 0 });
        self.recorder.record(&self.control.moment(self.reading, &output, 0));
        let mut reports = Vec::new();
        self.control.report(&output, &mut |report| {
            reports.push(report);
            true
        });
        for report in reports {
            for event in self.server.report(&report) {
                self.say(&event);
            }
        }
    }

    /// Receives a byte from the host.
    pub fn hear(&mut self, byte: u8) {
        let request = match self.decoder.push(byte) {
            Poll::Frame(content) => read_request(content),
            Poll::Pending | Poll::Corrupt(_) => return,
        };
        match request {
            Ok(request) => self.serve(&request),
            Err(unreadable) => {
                if let Some(refusal) = unreadable.refusal() {
                    self.say(&refusal);
                }
            }
        }
        self.server.corrupt_frames(self.decoder.counters().corrupt());
    }

    fn serve(&mut self, request: &ToDevice) {
        let mut step = self.server.receive(request, self.ticks);
        loop {
            step = match step {
                NextStep::Send(answer) => return self.say(&answer),
                NextStep::Control(request) => self.server.control_replied(self.control.execute(&request)),
                NextStep::Store => {
                    let slot = self.store();
                    self.server.stored(Ok(slot), states(&self.slots))
                }
                NextStep::StoreCalibration(calibration) => {
                    let stored = self.calibrations.store(&mut self.flash, &calibration);
                    let stored =
                        stored.map(|()| self.calibrations.count()).map_err(|_| Refusal::CalibrationStorage);
                    self.server.calibration_stored(&calibration, stored)
                }
                NextStep::ReadCalibration { back } => {
                    let calibration = self.calibrations.get(&mut self.flash, back);
                    self.server.calibration_read(self.calibrations.count(), calibration)
                }
                NextStep::Restart(answer) => {
                    self.say(&answer);
                    let cause = ResetCause::Software;
                    (self.control, self.server, self.recorder) =
                        boot(self.memory, cause, &self.slots, self.newest);
                    self.recall();
                    self.command = ValveCommand::SAFE;
                    return;
                }
            };
        }
    }

    /// Puts the newest calibration in force, as the firmware does at its start.
    fn recall(&mut self) {
        self.calibrations = StoredCalibrations::open(&mut self.flash, 0, SECTOR_BYTES);
        let newest = self.calibrations.get(&mut self.flash, 0);
        if let Some(correction) = newest.and_then(|newest| SensorCorrection::new(&newest).ok()) {
            self.control.calibrate(correction);
        }
    }

    fn store(&mut self) -> Slot {
        let slot = if self.newest == Some(Slot::A) { Slot::B } else { Slot::A };
        self.slots[slot as usize] = Some(*self.server.image());
        self.newest = Some(slot);
        slot
    }

    fn say(&mut self, message: &ToHost) {
        let mut buffer = [0; FRAME_BYTES];
        if let Ok(frame) = encode_frame(message, &mut buffer) {
            self.out.extend_from_slice(frame);
        }
    }
}

/// The states of the slots.
fn states(slots: &[Option<[u8; IMAGE_BYTES]>; 2]) -> [SlotState; 2] {
    slots.map(|bytes| match bytes.and_then(|bytes| decode(&bytes).ok()) {
        Some(image) => SlotState::Valid { generation: 0, id: image.id },
        None => SlotState::Empty,
    })
}

/// Both halves and the flight recorder after a start.
fn boot<'a>(
    memory: &'a RecorderMemory,
    reset: ResetCause,
    images: &[Option<[u8; IMAGE_BYTES]>; 2],
    newest: Option<Slot>,
) -> (Control, Server<'a>, Recorder<'a>) {
    let slots = states(images);
    let weights = newest.and_then(|slot| slots[slot as usize].id());
    let recorder = Recorder::attach(memory, Boot { cause: reset, failed: false, weights, restored: false });
    let image = newest.and_then(|slot| images[slot as usize]).and_then(|bytes| decode(&bytes).ok());
    let learned = image.map(|image| image.residual);
    let running = newest.filter(|_| learned.is_some());
    let device = DeviceKind::Simulated;
    let facts = DeviceFacts { slots, running, reset, ..DeviceFacts::blank(device) };
    let control: Result<Control, Refusal> = Control::new(device, DEFAULT_PERIOD_US, CORE_HZ);
    let mut control = control.expect("the default control period is in bounds");
    if let Some(learned) = &learned {
        control.learn(learned);
    }
    control.require_self_test(&BootFindings { program: None, memory: None, slots });
    control.report_boot(reset, recorder.interrupted(), &slots);
    (control, Server::new(facts, memory), recorder)
}
