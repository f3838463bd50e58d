//! Tests of the real firmware image in QEMU: boot, ventilation, golden trace, weights in flash, faults, a misbehaving host.
//!
//! Run them with `cargo xtask qemu-test`, which builds the images. The results do not depend on the machine's speed: time on
//! the board is virtual and stops while the plant computes.

mod alarms;
mod calibration;
mod control;
mod desk;
mod failures;
mod link;
mod power;
mod recovery;
mod self_test;
mod weights;

use std::collections::BTreeMap;
use std::convert::Infallible;
use std::io::Write;
use std::net::TcpStream;
use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Condvar, Mutex};
use std::time::{Duration, Instant};
use std::{env, fs};

use device::blackbox::{Blackbox, RecordedTicks};
use device::port::Address;
use device::{Device, DeviceError};
use emulator::{Emulator, EmulatorConfig, LockstepPlant, Paced, PlantEnd};
use plant::bench::{BenchConfig, BenchPlant, MOST_FAULTS};
use plant::{Plant, Reading};
use progress::Progress;
use shared::breath::{PAPER_PIPS, Phase, paper_settings};
use shared::control::Controller;
use shared::control::pid::{Pid, PidGains};
use shared::device::KNOWN_GOOD;
use shared::device::prescription::RESUMES;
use shared::link::messages::{AlarmStatus, ControllerChoice, DeviceKind, Event};
use shared::link::telemetry::{Counters, PackedSample};
use shared::recorder::keeper::Keeper;
use shared::recorder::{
    Activity, ChipEvent, FAST_ENTRIES, FAST_TAIL, Happening, LogEntry, RecorderStatus, RecordingState,
    TickEntry,
};
use shared::reset::ResetCause;
use shared::safety::alarms::Fault;
use shared::safety::ladder::Level;
use shared::settings::Settings;
use shared::ventilator::{Mode, Sample};
use shared::weights::slots::{Slot, SlotState, UNIT};
use shared::weights::{IMAGE_BYTES, Identity, decode, encode};
use shim::flash::{COPIES, NEW_OPTIONS, SECTOR_BYTES, WEIGHTS};
use shim::plant_port::PACE_TICKS;
use shim::record;
use tests::debugger::{Debugger, symbol};
use tests::exact_lung::ExactLung;
use tests::trace::{self, Fnv};
use ventilator::collect::{CollectConfig, collect};
use ventilator::{BenchSource, PortSource, Source};

/// Longest wait before a test fails; no result depends on it.
const DEADLINE: Duration = Duration::from_mins(5);

/// Where `cargo xtask firmware` puts the images.
fn image(name: &str) -> PathBuf {
    let folder = env::var_os("EUPNEA_IMAGES").map(PathBuf::from);
    let folder =
        folder.unwrap_or_else(|| PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../target/firmware"));
    folder.join(name).with_extension("elf")
}

fn config(firmware: &str) -> EmulatorConfig {
    EmulatorConfig { firmware: image(firmware), shim: image("shim"), ..EmulatorConfig::default() }
}

fn connect(board: &Emulator) -> Device {
    let mut device = Device::connect(&Address::Tcp(board.address().to_string())).unwrap();
    device.identify().unwrap();
    device
}

/// Starts ventilation with the settings in force.
fn start(device: &mut Device) -> Result<Mode, DeviceError> {
    let (in_force, pending) = device.settings()?;
    device.apply(pending.unwrap_or(in_force))?;
    device.start()
}

/// Halts a board.
fn debugger(board: &Emulator) -> Debugger {
    Debugger::connect(board.debugger_address().expect("a debugger may connect")).unwrap()
}

/// A board whose plant is the virtual bench with a lung.
fn breathing(config: EmulatorConfig, lung: &BenchConfig) -> (Emulator, Device) {
    let board = Emulator::start(config, LockstepPlant::new(BenchPlant::new(lung).unwrap())).unwrap();
    let device = connect(&board);
    (board, device)
}

/// A board that simulates the bench itself, with a lung; nothing is connected to it but the link. At most four times as fast as
/// real time: while it waits for its host it could run so fast that the host's lease ends between two requests.
fn on_the_desk(config: EmulatorConfig, bench: &BenchConfig) -> (Emulator, Device) {
    let pace = Duration::from_millis(PACE_TICKS.into()) / 4;
    let board = Emulator::start(config, Paced::new(Silence, pace)).unwrap();
    let mut device = connect(&board);
    device.set_bench(&bench.to_bytes()).unwrap();
    (board, device)
}

fn lung() -> BenchConfig {
    BenchConfig::paper(20.0, 20.0)
}

/// An image that differs from the committed weights only in its training id.
fn renamed(training: u8) -> ([u8; IMAGE_BYTES], u32) {
    let image = decode(trace::LEARNED).unwrap();
    let mut bytes = [0; IMAGE_BYTES];
    encode(&image.residual, &Identity { training: [training; 16], ..image.identity }, &mut bytes).unwrap();
    (bytes, decode(&bytes).unwrap().id)
}

fn upload(device: &mut Device, training: u8) -> (u32, Slot) {
    let uploaded = device.upload(&renamed(training).0, &Progress::silent()).unwrap();
    assert_eq!(uploaded.id, renamed(training).1);
    (uploaded.id, uploaded.slot)
}

/// Id of the weights that a device has loaded at its start.
fn running(device: &mut Device) -> Option<u32> {
    let identity = device.identify().unwrap();
    match identity.slots[identity.running? as usize] {
        SlotState::Valid { id, .. } => Some(id),
        other => panic!("{other:?} runs"),
    }
}

/// A plant that never answers.
struct Silence;

impl PlantEnd for Silence {
    fn answer(&mut self, _request: &[u8]) -> Vec<u8> {
        Vec::new()
    }
}

/// Received samples, checked for gaps.
#[derive(Default)]
struct Samples {
    all: Vec<Sample>,
    next_tick: Option<u64>,
    counters: Counters,
}

impl Samples {
    /// Receives samples until one meets a condition.
    fn until(&mut self, device: &Device, wished: impl Fn(&Sample) -> bool) {
        let deadline = Instant::now() + DEADLINE;
        loop {
            let left = deadline.saturating_duration_since(Instant::now());
            match device.events().recv_timeout(left).expect("samples come") {
                Event::Telemetry(batch) => {
                    assert!(
                        self.next_tick.is_none_or(|next| next == batch.first_tick),
                        "samples are missing"
                    );
                    self.next_tick = Some(batch.first_tick + batch.samples.len() as u64);
                    self.counters = batch.counters;
                    self.all.extend(batch.samples.iter().map(PackedSample::unpack));
                    if batch.samples.iter().any(|sample| wished(&sample.unpack())) {
                        return;
                    }
                }
                Event::Breath(_) | Event::Unacknowledged { .. } => {}
                Event::Alarm { fault, .. } => panic!("{fault:?}"),
            }
        }
    }
}

/// Function of the image that runs in every tick of a breath.
const CONTROL_STEP: &str = "shared::ventilator::Ventilator<C>::breathe";

/// Waits for a greeting with the reason of a failure.
fn failure(device: &mut Device) -> String {
    let deadline = Instant::now() + DEADLINE;
    loop {
        match device.identify() {
            Ok(identity) if identity.failure.is_some() => return identity.failure.unwrap().to_string(),
            other => assert!(Instant::now() < deadline, "the greeting contains no reason: {other:?}"),
        }
    }
}

/// Waits for the alarm of a fault.
fn alarmed(device: &Device, fault: Fault) {
    let alarm = |event: &Event| matches!(event, Event::Alarm { fault: found, .. } if *found == fault);
    let deadline = Instant::now() + DEADLINE;
    while !alarm(&device.events().recv_timeout(deadline - Instant::now()).expect("an alarm comes")) {}
}

/// Polls the alarms until they meet a condition.
fn indicates(device: &mut Device, wished: impl Fn(&AlarmStatus) -> bool) {
    let deadline = Instant::now() + DEADLINE;
    loop {
        let alarms = device.alarms().unwrap();
        if wished(&alarms) {
            return;
        }
        assert!(Instant::now() < deadline, "{alarms:?}");
    }
}

fn happened(blackbox: &Blackbox, wanted: Happening) -> bool {
    blackbox.log.iter().any(|event| event.happening == wanted)
}
