//! Tests of the real firmware image in QEMU: boot, ventilation, golden trace, weights in flash, faults, a misbehaving host.
//!
//! Run them with `cargo xtask qemu-test`, which builds the images. The results do not depend on the machine's speed: time on
//! the board is virtual and stops while the plant computes.

use std::collections::BTreeMap;
use std::convert::Infallible;
use std::io::Write;
use std::net::TcpStream;
use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Condvar, Mutex};
use std::time::{Duration, Instant};
use std::{env, fs};

use device::Device;
use device::blackbox::{Blackbox, RecordedTicks};
use device::port::Address;
use emulator::{Emulator, EmulatorConfig, LockstepPlant, PlantEnd};
use plant::bench::{BenchConfig, BenchPlant};
use plant::{Plant, Reading};
use progress::Progress;
use shared::breath::{PAPER_PIPS, Phase, paper_settings};
use shared::control::Controller;
use shared::control::pid::{Pid, PidGains};
use shared::device::KNOWN_GOOD;
use shared::device::prescription::RESUMES;
use shared::link::messages::{AlarmStatus, ControllerChoice, DeviceKind, Event};
use shared::link::telemetry::{Counters, PackedSample};
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
use shim::flash::NEW_OPTIONS;
use shim::record;
use tests::debugger::{Debugger, symbol};
use tests::exact_lung::ExactLung;
use tests::trace::{self, Fnv};
use ventilator::collect::{CollectConfig, collect};
use ventilator::{BenchSource, PortSource, Source};

/// Length of a control tick, cycles.
const TICK_CYCLES: u32 = 168_000;
/// Cycles per microsecond.
const MICROSECOND: u32 = 168;
/// Clock cycles per instruction in QEMU: 8 ns of virtual time at 168 MHz.
const CYCLES_PER_INSTRUCTION: f32 = 1.344;
/// Longest wait before a test fails; no result depends on it.
const DEADLINE: Duration = Duration::from_mins(5);
/// Length of a weights slot, bytes.
const SLOT: usize = 128 * 1024;

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

fn lung() -> BenchConfig {
    BenchConfig::paper(20.0, 20.0)
}

fn pid(gains: PidGains) -> Controller {
    Controller::Pid(Pid::new(gains, 1000).unwrap())
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

/// Description of a damage, and a function that applies it to a slot.
type Damage = (&'static str, fn(&mut [u8]));

/// A plant that never answers.
struct Silence;

impl PlantEnd for Silence {
    fn answer(&mut self, _request: &[u8]) -> Vec<u8> {
        Vec::new()
    }
}

/// The lung of the golden traces as a plant on the plant line.
struct GoldenPlant(ExactLung);

impl GoldenPlant {
    fn reading(&self) -> Reading {
        Reading::of_pressure(self.0.pressure())
    }
}

impl Plant for GoldenPlant {
    type Error = Infallible;

    fn name(&self) -> String {
        "exact lung".to_owned()
    }

    fn reset(&mut self, _period_us: u32, _seed: u64, peep: f32) -> Result<Reading, Infallible> {
        self.0 = ExactLung::new(peep);
        Ok(self.reading())
    }

    fn set_peep(&mut self, peep: f32) -> Result<(), Infallible> {
        self.0.set_peep(peep);
        Ok(())
    }

    fn step(&mut self, u_in: f32, u_out: bool) -> Result<Reading, Infallible> {
        self.0.step(u_in, u_out);
        Ok(self.reading())
    }
}

#[test]
fn the_boards_own_image_stands_by_names_the_missing_sensor_and_does_not_start() {
    let board = Emulator::start(config("board"), Silence).unwrap();
    let mut device = connect(&board);
    let identity = device.identify().unwrap();
    assert_eq!((identity.device, identity.reset), (DeviceKind::Ventilator, ResetCause::PowerOn));
    assert_eq!(identity.mode, Mode::Standby);
    assert!(device.alarms().unwrap().indicated.has(Fault::ReadingNotANumber));
    assert_eq!((identity.slots, identity.running), ([SlotState::Empty; 2], None));
    assert_eq!(identity.controller, ControllerChoice::Pid(KNOWN_GOOD), "no weights: the PID");
    assert!(device.start().unwrap_err().to_string().contains("no pressure sensor is sound"));
    assert!(device.reset_plant(1).is_err(), "a ventilator has no plant");
}

#[test]
fn golden_trace_of_learned_weights_is_the_hosts_bit_for_bit() {
    let host = trace::run(trace::learned()).unwrap();
    let board = Emulator::start(config("hil"), LockstepPlant::new(GoldenPlant(ExactLung::new(5.0)))).unwrap();
    let mut port = PortSource::new(connect(&board), 0).unwrap();
    port.know(trace::LEARNED.to_vec());
    port.configure(trace::learned(), Some(trace::exploration())).unwrap();
    let plan: Vec<Settings> = (0..trace::BREATHS).map(trace::settings).collect();
    port.upcoming(&plan).unwrap();
    let (mut hash, mut entries) = (Fnv::default(), Vec::new());
    for (number, settings) in (1..).zip(&plan) {
        port.breath(settings, &mut |tick| hash.command(tick.sample.u_in, tick.sample.u_out)).unwrap();
        if number % trace::ENTRY_BREATHS == 0 {
            entries.push((number, hash.value()));
        }
    }
    drop(port);
    let expected: Vec<(u32, u64)> = host.entries.iter().map(|entry| (entry.breaths, entry.hash)).collect();
    let times = connect(&board).timing(false).unwrap();
    let instructions = |cycles: f32| (cycles / CYCLES_PER_INSTRUCTION) as u32;
    let hash = |entries: &[(u32, u64)]| format!("{:016x}", entries.last().unwrap().1);
    let found = BTreeMap::from([
        ("hash_host", serde_json::json!(hash(&expected))),
        ("hash_qemu", serde_json::json!(hash(&entries))),
        ("tick_mean", serde_json::json!(instructions(times.work.mean))),
        ("tick_worst", serde_json::json!(instructions(times.work.longest as f32))),
    ]);
    fs::write(image("golden").with_extension("json"), serde_json::to_string_pretty(&found).unwrap()).unwrap();
    assert_eq!(entries, expected);
}

#[test]
fn it_ventilates_all_lungs_of_the_paper() {
    // No PID suits all lungs; the resistance determines the gains.
    let gains = |p, i| PidGains { p, i, d: 0.0 };
    let tuned = [(5.0, gains(20.0, 100.0)), (20.0, gains(5.0, 100.0)), (50.0, gains(3.5, 25.0))];
    for ((resistance, gains), compliance) in
        tuned.into_iter().flat_map(|tuned| [10.0, 20.0, 50.0].map(|compliance| (tuned, compliance)))
    {
        let (_board, device) = breathing(config("hil"), &BenchConfig::paper(resistance, compliance));
        let mut port = PortSource::new(device, 1).unwrap();
        port.configure(pid(gains), None).unwrap();
        let breaths = [paper_settings(15.0), paper_settings(15.0)];
        port.upcoming(&breaths).unwrap();
        let mut plateau = Vec::new();
        for breath in &breaths {
            plateau.clear();
            port.breath(breath, &mut |tick| {
                if tick.sample.phase == Phase::Inspiration && tick.sample.tick >= 900 {
                    plateau.push(tick.sample.pressure);
                }
            })
            .unwrap();
        }
        let mean = plateau.iter().sum::<f32>() / plateau.len() as f32;
        assert!((mean - 15.0).abs() < 1.0, "R{resistance}C{compliance}: a plateau of {mean} cmH2O");
    }
}

#[test]
fn a_recording_over_the_link_is_that_of_the_bench_in_process_bit_for_bit() {
    let (_board, device) = breathing(config("hil"), &lung());
    let config = CollectConfig { breaths: 30, seed: (1 << 51) + 3, ..CollectConfig::default() };
    let controller = pid(KNOWN_GOOD);
    let mut bench =
        BenchSource::new(&lung(), controller.clone(), &config.settings, 1000, config.seed).unwrap();
    let here = collect(&mut bench, &controller, &config, &Progress::silent()).unwrap().recording;
    let mut port = PortSource::new(device, config.seed).unwrap();
    let there = collect(&mut port, &controller, &config, &Progress::silent()).unwrap().recording;
    let bits = |values: &[f32]| values.iter().map(|value| value.to_bits()).collect::<Vec<_>>();
    assert_eq!(bits(&here.u_in), bits(&there.u_in));
    assert_eq!(bits(&here.pressure), bits(&there.pressure));
    assert_eq!(bits(&here.target), bits(&there.target));
    assert_eq!(bits(&here.explore), bits(&there.explore));
    assert_eq!((&here.breath, &here.tick, &here.phase), (&there.breath, &there.tick, &there.phase));
    assert_eq!(&here.u_out, &there.u_out);
}

#[test]
fn weights_are_stored_survive_a_reset_and_a_power_cut_and_alternate() {
    let folder = tempfile::tempdir().unwrap();
    let config = || EmulatorConfig { folder: Some(folder.path().to_owned()), ..config("hil") };
    let (board, mut device) = breathing(config(), &lung());
    assert_eq!(upload(&mut device, 1), (renamed(1).1, Slot::A));
    assert_eq!(running(&mut device), None, "they run after a reset");
    let identity = device.restart().unwrap();
    assert_eq!((identity.reset, identity.running), (ResetCause::Software, Some(Slot::A)));
    assert_eq!(identity.controller, ControllerChoice::Learned);
    assert_eq!(upload(&mut device, 2), (renamed(2).1, Slot::B));
    // A dropped board loses its power.
    drop((device, board));
    let (_board, mut device) = breathing(config(), &lung());
    assert_eq!(
        (running(&mut device), device.identify().unwrap().reset),
        (Some(renamed(2).1), ResetCause::PowerOn)
    );
}

#[test]
fn torn_and_damaged_images_are_refused_and_the_older_weights_run() {
    let (board, mut device) = breathing(config("hil"), &lung());
    upload(&mut device, 1);
    device.restart().unwrap();
    upload(&mut device, 2);
    let good = board.flash().unwrap();
    drop((device, board));
    let damages: [Damage; 4] = [
        ("a flipped bit of a weight", |slot| slot[1000] ^= 1),
        ("a torn write", |slot| slot[3000..IMAGE_BYTES].fill(0xFF)),
        ("no commit word", |slot| slot[IMAGE_BYTES.next_multiple_of(32) + 32..][..4].fill(0xFF)),
        ("an erased sector", |slot| slot.fill(0xFF)),
    ];
    for (name, damage) in damages {
        let mut flash = good.clone();
        damage(&mut flash[SLOT..]);
        let (_board, mut device) = breathing(EmulatorConfig { flash: Some(flash), ..config("hil") }, &lung());
        assert_eq!(running(&mut device), Some(renamed(1).1), "{name}");
    }
    let mut flash = good;
    flash[1000] ^= 1;
    flash[SLOT + 1000] ^= 1;
    let (_board, mut device) = breathing(EmulatorConfig { flash: Some(flash), ..config("hil") }, &lung());
    let identity = device.identify().unwrap();
    assert_eq!((identity.running, identity.controller), (None, ControllerChoice::Pid(KNOWN_GOOD)));
    assert!(identity.slots.iter().all(|slot| matches!(slot, SlotState::Invalid(_))), "{:?}", identity.slots);
}

#[test]
fn a_cut_in_the_middle_of_a_store_leaves_the_old_or_the_new_weights() {
    let folder = tempfile::tempdir().unwrap();
    let config =
        || EmulatorConfig { folder: Some(folder.path().to_owned()), debugger: true, ..config("hil") };
    let (board, mut device) = breathing(config(), &lung());
    upload(&mut device, 1);
    // The sector erase, then the words in order; the first word of the last unit is the commit word.
    let operations = debugger(&board).record().unwrap().flash_operations;
    let commit = operations + 1 - UNIT as u32 / 4;
    assert!(commit as usize > IMAGE_BYTES / 4, "{commit}");
    drop((device, board));
    let old = renamed(1).1;
    for (training, cut) in (2..).zip([1, 2, commit / 2, commit - 1, commit, operations]) {
        let (mut board, mut device) = breathing(config(), &lung());
        debugger(&board).cut_power_at(cut).unwrap();
        let (image, new) = renamed(training);
        assert!(device.upload(&image, &Progress::silent()).is_err(), "the line closes when the power is cut");
        board.wait().unwrap();
        assert!(board.log().ends_with("power cut"), "{}", board.log());
        drop((device, board));
        let (_board, mut device) = breathing(config(), &lung());
        let expected = if cut < commit { old } else { new };
        assert_eq!(running(&mut device), Some(expected), "after a cut at {cut} of {operations}");
    }
}

#[test]
fn settings_take_effect_at_the_breath_boundary_and_are_refused_with_the_reason() {
    let (_board, mut device) = breathing(config("hil"), &lung());
    device.telemetry(true).unwrap();
    device.apply(paper_settings(15.0)).unwrap();
    device.start().unwrap();
    let mut samples = Samples::default();
    samples.until(&device, |sample| sample.tick >= 100);
    device.apply(paper_settings(30.0)).unwrap();
    let refused = device.apply(Settings { pip: 70.0, ..Settings::default() }).unwrap_err();
    assert!(refused.to_string().contains("pip is 70 cmH2O, allowed are 5 to 50"), "{refused}");
    samples.until(&device, |sample| sample.breath == 3);
    let inspiration = samples.all.iter().filter(|sample| sample.phase == Phase::Inspiration);
    let mut targets: BTreeMap<u32, Vec<f32>> = BTreeMap::new();
    inspiration.for_each(|sample| targets.entry(sample.breath).or_default().push(sample.target));
    assert!(
        targets.values().all(|targets| targets.iter().all(|target| target.to_bits() == targets[0].to_bits()))
    );
    let pips: Vec<f32> = targets.values().map(|targets| targets[0]).collect();
    assert_eq!((pips[0], pips.last()), (15.0, Some(&30.0)));
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
                Event::Breath(_) => {}
                Event::Alarm { fault, .. } => panic!("{fault:?}"),
            }
        }
    }
}

#[test]
fn sixty_seconds_of_telemetry_under_a_flooding_host_miss_no_tick_and_no_sample() {
    let (_board, mut device) = breathing(config("hil"), &lung());
    device.telemetry(true).unwrap();
    device.start().unwrap();
    device.timing(true).unwrap();
    let mut samples = Samples::default();
    for breath in 0..20 {
        // Continuous requests, bytes outside frames and a truncated frame, throughout the breath.
        for _ in 0..10 {
            device.settings().unwrap();
            device.send_raw(&[0x55; 300]).unwrap();
            device.send_raw(&[0, 7, 1, 2, 0]).unwrap();
        }
        samples.until(&device, |sample| sample.breath > breath);
    }
    let times = device.timing(false).unwrap();
    assert!(samples.all.len() >= 60_000, "{} samples", samples.all.len());
    assert_eq!(
        (samples.counters.dropped, device.counters().lost_batches, device.counters().corrupt),
        (0, 0, 0)
    );
    assert!(samples.counters.corrupt_frames >= 200, "the garbage is counted: {:?}", samples.counters);
    assert_eq!((times.missed, samples.counters.missed_ticks), (0, 0));
    let (shortest, longest) = (times.period.shortest, times.period.longest);
    let allowed = TICK_CYCLES - 2 * MICROSECOND..=TICK_CYCLES + 2 * MICROSECOND;
    assert!(
        allowed.contains(&shortest) && allowed.contains(&longest),
        "periods of {shortest} to {longest} cycles: {times:?}"
    );
}

/// Number of exchanges with a plant, one per control tick.
#[derive(Default)]
struct Ticks {
    count: Mutex<u64>,
    more: Condvar,
}

impl Ticks {
    /// Waits for `ticks` more exchanges.
    fn wait_for(&self, ticks: u64) {
        let count = self.count.lock().unwrap();
        let end = *count + ticks;
        let (count, _) = self.more.wait_timeout_while(count, DEADLINE, |count| *count < end).unwrap();
        assert!(*count >= end, "the board has stopped");
    }
}

/// Function of the image that runs in every tick of a breath.
const CONTROL_STEP: &str = "shared::ventilator::Ventilator<C>::breathe";

/// A plant whose exchanges are counted.
struct Counted<P>(P, Arc<Ticks>);

impl<P: PlantEnd> PlantEnd for Counted<P> {
    fn answer(&mut self, request: &[u8]) -> Vec<u8> {
        *self.1.count.lock().unwrap() += 1;
        self.1.more.notify_all();
        self.0.answer(request)
    }
}

#[test]
fn a_host_that_falls_silent_and_comes_back_finds_the_device_ventilating() {
    let ticks = Arc::new(Ticks::default());
    let bench = LockstepPlant::new(BenchPlant::new(&lung()).unwrap());
    let board = Emulator::start(config("hil"), Counted(bench, Arc::clone(&ticks))).unwrap();
    let mut device = connect(&board);
    device.apply(paper_settings(25.0)).unwrap();
    device.start().unwrap();
    drop(device);
    ticks.wait_for(300);
    // Another program, which sends no frames.
    let mut stranger = TcpStream::connect(board.address()).unwrap();
    stranger.write_all(&[0xFF; 5000]).unwrap();
    ticks.wait_for(300);
    drop(stranger);
    ticks.wait_for(300);
    let mut device = connect(&board);
    let identity = device.identify().unwrap();
    assert_eq!((identity.mode, identity.reset), (Mode::Ventilating, ResetCause::PowerOn));
    assert_eq!(device.settings().unwrap().0, paper_settings(25.0));
    assert_eq!(device.timing(false).unwrap().missed, 0);
}

#[test]
fn a_control_tick_that_hangs_is_ended_by_the_watchdog() {
    let (board, mut device) = breathing(EmulatorConfig { debugger: true, ..config("hil") }, &lung());
    let mut debugger = debugger(&board);
    let step = symbol(&image("hil"), CONTROL_STEP).unwrap();
    let whole = debugger.read(step, 2).unwrap();
    // A branch to itself in place of the step's first instruction.
    debugger.write(step, &[0xFE, 0xE7]).unwrap();
    debugger.detach().unwrap();
    let _ = device.start();
    let deadline = Instant::now() + DEADLINE;
    let identity = loop {
        match device.identify() {
            Ok(identity) if identity.reset == ResetCause::Watchdog => break identity,
            other => assert!(Instant::now() < deadline, "the watchdog does not reset the board: {other:?}"),
        }
    };
    assert_eq!(identity.mode, Mode::Standby, "nothing moves by itself");
    assert_ne!(whole, [0xFE, 0xE7]);
}

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

#[test]
fn a_program_that_fails_tells_the_reason_after_its_restart() {
    let (board, mut device) = breathing(EmulatorConfig { debugger: true, ..config("hil") }, &lung());
    let mut debugger = debugger(&board);
    let step = symbol(&image("hil"), CONTROL_STEP).unwrap();
    // An instruction that is permanently undefined.
    debugger.write(step, &[0x00, 0xDE]).unwrap();
    debugger.detach().unwrap();
    let _ = device.start();
    let failure = failure(&mut device);
    assert!(failure.contains(&format!("hard fault at {step:#010x}")), "{failure}");
    assert_eq!(device.identify().unwrap().mode, Mode::Standby);
}

/// Instructions that push registers until the stack overflows: `push {r0-r7, lr}`, and a branch back to it.
const OVERFLOW: [u8; 4] = [0xFF, 0xB5, 0xFD, 0xE7];

/// Function that a failure of the program calls first. In a hard fault the shim's models are out of reach, so its effect on the
/// pins is tested where it is called in a control tick.
const STOP: &str = "failure::stop_safely";

#[test]
fn a_failure_closes_the_inspiratory_and_opens_the_expiratory_valve() {
    const INSPIRATORY: u32 = 6;
    const EXPIRATORY: u32 = 0;
    const OUTPUT: u32 = 1;
    let board = Emulator::start(EmulatorConfig { debugger: true, ..config("board") }, Silence).unwrap();
    connect(&board);
    let mut debugger = debugger(&board);
    debugger.run_to(symbol(&image("board"), "valves::Valves::apply").unwrap()).unwrap();
    assert_ne!(debugger.record().unwrap().ports[0].mode(INSPIRATORY), OUTPUT, "the PWM drives the valve");
    let caller = debugger.registers().unwrap()[14] & !1;
    debugger.jump(symbol(&image("board"), STOP).unwrap()).unwrap();
    debugger.run_to(caller).unwrap();
    let [a, b] = debugger.record().unwrap().ports;
    assert_eq!((a.mode(INSPIRATORY), a.level(INSPIRATORY)), (OUTPUT, false), "closed");
    assert_eq!((b.mode(EXPIRATORY), b.level(EXPIRATORY)), (OUTPUT, false), "open");
}

#[test]
fn a_stack_that_overflows_stops_safely_before_the_restart() {
    let board = Emulator::start(EmulatorConfig { debugger: true, ..config("board") }, Silence).unwrap();
    let mut device = connect(&board);
    let mut debugger = debugger(&board);
    let apply = symbol(&image("board"), "valves::Valves::apply").unwrap();
    let whole = debugger.read(apply, OVERFLOW.len()).unwrap();
    debugger.write(apply, &OVERFLOW).unwrap();
    for place in [STOP, "failure::restart"] {
        debugger.run_to(symbol(&image("board"), place).unwrap()).unwrap();
    }
    debugger.write(apply, &whole).unwrap();
    debugger.detach().unwrap();
    let failure = failure(&mut device);
    assert!(failure.starts_with("stack overflow"), "{failure}");
}

#[test]
fn a_stack_that_overflows_is_reported_and_the_recorder_keeps_the_ticks_before() {
    let (board, mut device) = breathing(EmulatorConfig { debugger: true, ..config("hil") }, &lung());
    device.telemetry(true).unwrap();
    device.start().unwrap();
    Samples::default().until(&device, |sample| (sample.breath, sample.tick) == (1, 0));
    let mut debugger = debugger(&board);
    debugger.write(symbol(&image("hil"), CONTROL_STEP).unwrap(), &OVERFLOW).unwrap();
    debugger.detach().unwrap();
    let failure = failure(&mut device);
    assert!(failure.starts_with("stack overflow"), "{failure}");
    assert_eq!(device.identify().unwrap().mode, Mode::Standby);
    let blackbox = device.blackbox(&Progress::silent()).unwrap();
    // It resumes, and overflows again, until it gives up.
    assert_eq!((blackbox.status.boot, blackbox.status.recording), (2 + RESUMES, RecordingState::Reset));
    assert!(happened(&blackbox, Happening::Boot { cause: ResetCause::Software, failed: true }));
    assert!(happened(&blackbox, Happening::Start));
    assert_eq!(blackbox.fast.ticks().count(), FAST_ENTRIES);
    assert!(blackbox.fast.ticks().all(|tick| tick.activity == Activity::Ventilating));
}

#[test]
fn the_smallest_stack_has_a_reserve() {
    /// Stack of the STM32F446, whose program is the same, and what must be left of it, bytes.
    const SMALLEST: usize = 48 * 1024;
    const RESERVE: usize = 4 * 1024;
    const PAINT: [u8; 4] = 0xCCCC_CCCC_u32.to_le_bytes();
    let (board, mut device) = breathing(EmulatorConfig { debugger: true, ..config("hil") }, &lung());
    upload(&mut device, 1);
    device.restart().unwrap();
    device.telemetry(true).unwrap();
    device.start().unwrap();
    Samples::default().until(&device, |sample| sample.breath == 3);
    device.blackbox(&Progress::silent()).unwrap();
    device.stop().unwrap();
    upload(&mut device, 2);
    let [bottom, top] = ["_stack_end", "_stack_start"].map(|name| symbol(&image("hil"), name).unwrap());
    let stack = debugger(&board).read(bottom, (top - bottom) as usize).unwrap();
    let unused = 4 * stack.as_chunks().0.iter().take_while(|word| **word == PAINT).count();
    let used = stack.len() - unused;
    assert!(used > 0 && used <= SMALLEST - RESERVE, "{used} bytes of the stack are used");
}

#[test]
fn without_a_crystal_the_board_runs_on_its_internal_oscillator_and_reports_it() {
    let (board, mut device) = breathing(EmulatorConfig { debugger: true, ..config("hil") }, &lung());
    assert!(!happened(&device.blackbox(&Progress::silent()).unwrap(), Happening::Chip(ChipEvent::NoCrystal)));
    debugger(&board).suffer(record::NO_CRYSTAL).unwrap();
    let identity = device.restart().unwrap();
    assert_eq!((identity.mode, identity.failure), (Mode::Standby, None));
    let blackbox = device.blackbox(&Progress::silent()).unwrap();
    assert!(happened(&blackbox, Happening::Chip(ChipEvent::NoCrystal)), "{:?}", blackbox.log);
    device.telemetry(true).unwrap();
    device.start().unwrap();
    Samples::default().until(&device, |sample| sample.breath == 1);
}

#[test]
fn a_crystal_that_stops_is_reported_and_ventilation_continues() {
    let (board, mut device) = breathing(EmulatorConfig { debugger: true, ..config("hil") }, &lung());
    device.telemetry(true).unwrap();
    device.start().unwrap();
    let mut samples = Samples::default();
    samples.until(&device, |sample| (sample.breath, sample.tick) == (1, 0));
    debugger(&board).suffer(record::NO_CRYSTAL).unwrap();
    samples.until(&device, |sample| sample.breath == 3);
    assert_eq!(samples.counters.missed_ticks, 0);
    let blackbox = device.blackbox(&Progress::silent()).unwrap();
    let stops = blackbox.log.iter().filter(|event| {
        event.happening == Happening::Chip(ChipEvent::CrystalStopped) && event.boot == blackbox.status.boot
    });
    assert_eq!((stops.count(), blackbox.status.boot), (1, 1), "once, without a restart");
}

#[test]
fn a_falling_supply_makes_the_valves_safe_at_once_and_is_reported() {
    const INSPIRATORY: u32 = 6;
    const OUTPUT: u32 = 1;
    let board = Emulator::start(EmulatorConfig { debugger: true, ..config("board") }, Silence).unwrap();
    let mut device = connect(&board);
    let mut halted = debugger(&board);
    assert_ne!(halted.record().unwrap().ports[0].mode(INSPIRATORY), OUTPUT, "the PWM drives the valve");
    halted.write(record::CONDITIONS_ADDRESS, &record::SUPPLY_LOW.to_le_bytes()).unwrap();
    halted.run_to(symbol(&image("board"), "failure::restart").unwrap()).unwrap();
    let [a, b] = halted.record().unwrap().ports;
    assert_eq!((a.mode(INSPIRATORY), a.level(INSPIRATORY)), (OUTPUT, false), "closed");
    assert_eq!((b.mode(0), b.level(0)), (OUTPUT, false), "open");
    halted.detach().unwrap();
    let failure = failure(&mut device);
    assert!(failure.contains("supply voltage"), "{failure}");
    let blackbox = device.blackbox(&Progress::silent()).unwrap();
    assert!(happened(&blackbox, Happening::Chip(ChipEvent::SupplyLow)), "{:?}", blackbox.log);
}

#[test]
fn a_new_chips_brown_out_level_is_programmed_once() {
    let (board, mut device) = breathing(EmulatorConfig { debugger: true, ..config("hil") }, &lung());
    let mut halted = debugger(&board);
    assert_eq!(halted.record().unwrap().options, NEW_OPTIONS & !0b1100, "level 3, and all else as it was");
    halted.detach().unwrap();
    device.restart().unwrap();
    let log = device.blackbox(&Progress::silent()).unwrap().log;
    let set = log.iter().filter(|one| one.happening == Happening::Chip(ChipEvent::BrownOutLevelSet));
    assert_eq!(set.map(|one| one.boot).collect::<Vec<_>>(), [1]);
}

#[test]
fn the_flash_is_read_with_prefetch_and_caches() {
    const FIVE_WAIT_STATES: u32 = 5;
    const PREFETCH: u32 = 1 << 8;
    const INSTRUCTION_CACHE: u32 = 1 << 9;
    const DATA_CACHE: u32 = 1 << 10;
    let wanted = FIVE_WAIT_STATES | PREFETCH | INSTRUCTION_CACHE | DATA_CACHE;
    let (board, mut device) = breathing(EmulatorConfig { debugger: true, ..config("hil") }, &lung());
    let read = || {
        let mut debugger = debugger(&board);
        let access = debugger.record().unwrap().flash_access;
        debugger.detach().unwrap();
        access
    };
    assert_eq!(read(), wanted);
    upload(&mut device, 1);
    assert_eq!(read(), wanted, "after a store");
}

/// A plant that can be disconnected.
struct Unplugged<P>(P, Arc<AtomicBool>);

impl<P: PlantEnd> PlantEnd for Unplugged<P> {
    fn answer(&mut self, request: &[u8]) -> Vec<u8> {
        if self.1.load(Ordering::Relaxed) { Vec::new() } else { self.0.answer(request) }
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

#[test]
fn a_plant_that_vanishes_is_ventilated_in_backup_until_it_returns() {
    let gone = Arc::new(AtomicBool::new(false));
    let bench = LockstepPlant::new(BenchPlant::new(&lung()).unwrap());
    let board = Emulator::start(config("hil"), Unplugged(bench, Arc::clone(&gone))).unwrap();
    let mut device = connect(&board);
    device.telemetry(true).unwrap();
    device.start().unwrap();
    Samples::default().until(&device, |sample| sample.breath == 1);
    gone.store(true, Ordering::Relaxed);
    alarmed(&device, Fault::ReadingNotANumber);
    assert_eq!(device.identify().unwrap().mode, Mode::Ventilating);
    let alarms = device.alarms().unwrap();
    assert_eq!(alarms.level, Level::Backup);
    assert!(alarms.present.has(Fault::ReadingNotANumber) && alarms.present.has(Fault::BackupVentilation));
    gone.store(false, Ordering::Relaxed);
    indicates(&mut device, |alarms| alarms.level != Level::Backup);
    assert!(device.alarms().unwrap().indicated.has(Fault::BackupVentilation), "until it is acknowledged");
    assert_eq!(device.acknowledge().unwrap(), Mode::Ventilating);
    indicates(&mut device, |alarms| !alarms.indicated.has(Fault::BackupVentilation));
}

/// Waits for a greeting after a start with this cause.
fn restarted_by(device: &mut Device, cause: ResetCause) {
    let deadline = Instant::now() + DEADLINE;
    loop {
        match device.identify() {
            Ok(identity) if identity.reset == cause => return,
            other => assert!(Instant::now() < deadline, "no start by {cause:?}: {other:?}"),
        }
    }
}

fn happened(blackbox: &Blackbox, wanted: Happening) -> bool {
    blackbox.log.iter().any(|event| event.happening == wanted)
}

/// A plant whose sensor can be made to read far above the pressure limit, with a working sensor's noise.
struct Overpressure {
    bench: BenchPlant,
    on: Arc<AtomicBool>,
    noise: f32,
}

impl Plant for Overpressure {
    type Error = <BenchPlant as Plant>::Error;

    fn name(&self) -> String {
        self.bench.name()
    }

    fn reset(&mut self, period_us: u32, seed: u64, peep: f32) -> Result<Reading, Self::Error> {
        self.bench.reset(period_us, seed, peep)
    }

    fn set_peep(&mut self, peep: f32) -> Result<(), Self::Error> {
        self.bench.set_peep(peep)
    }

    fn step(&mut self, u_in: f32, u_out: bool) -> Result<Reading, Self::Error> {
        let reading = self.bench.step(u_in, u_out)?;
        self.noise = -self.noise;
        Ok(if self.on.load(Ordering::Relaxed) { Reading::of_pressure(65.0 + self.noise) } else { reading })
    }
}

#[test]
fn a_fault_is_kept_with_what_led_to_it_through_a_software_reset() {
    let on = Arc::new(AtomicBool::new(false));
    let bench = BenchPlant::new(&lung()).unwrap();
    let plant = Overpressure { bench, on: Arc::clone(&on), noise: 0.05 };
    let board = Emulator::start(config("hil"), LockstepPlant::new(plant)).unwrap();
    let mut device = connect(&board);
    device.telemetry(true).unwrap();
    device.apply(paper_settings(25.0)).unwrap();
    device.start().unwrap();
    Samples::default().until(&device, |sample| (sample.breath, sample.tick) == (2, 0));
    on.store(true, Ordering::Relaxed);
    alarmed(&device, Fault::HardLimit);
    let deadline = Instant::now() + DEADLINE;
    // Recording continues for its tail.
    let ended = |status: &RecorderStatus| status.fast.tick(status.fast.next, 1) == status.tick + FAST_TAIL;
    while !ended(&device.recorder().unwrap()) {
        assert!(Instant::now() < deadline, "recording does not stop");
    }
    let before = device.blackbox(&Progress::silent()).unwrap();
    let fault = Fault::HardLimit;
    assert_eq!(before.status.recording, RecordingState::Fault(fault));
    assert_eq!(before.fast.entries.len(), FAST_ENTRIES);
    let end = before.fast.ticks().filter(|tick| tick.activity == Activity::Fault).count();
    assert_eq!(end, FAST_TAIL as usize);
    assert!(
        before.fast.ticks().all(|tick| tick.activity != Activity::Fault || (tick.u_out && tick.u_in <= 0.0))
    );
    assert!(before.slow.ticks().any(|tick| tick.pressure > 20.0), "the breaths before are recorded");
    device.restart().unwrap();
    let after = device.blackbox(&Progress::silent()).unwrap();
    assert_eq!(
        (after.status.boot, after.status.recording),
        (before.status.boot + 1, before.status.recording)
    );
    let bits = |ticks: &RecordedTicks| ticks.ticks().map(|tick| tick.pressure.to_bits()).collect::<Vec<_>>();
    assert!(bits(&after.fast) == bits(&before.fast), "the recorded ticks have changed");
    assert!(bits(&after.slow).starts_with(&bits(&before.slow)), "the slow recording has changed");
    assert!(after.log.starts_with(&before.log) && after.unread == 0);
    assert!(happened(&after, Happening::Fault(fault)) && happened(&after, Happening::Start));
    assert!(happened(&after, Happening::Boot { cause: ResetCause::Software, failed: false }));
    device.clear_recorder().unwrap();
    assert_eq!(device.recorder().unwrap().recording, RecordingState::Nothing);
}

/// A board that ventilates at a PIP of 25 cmH2O with learned weights, halted at the start of a control step in mid-breath.
fn halted_in_mid_breath() -> (Emulator, Device, Debugger) {
    let (board, mut device) = breathing(EmulatorConfig { debugger: true, ..config("hil") }, &lung());
    upload(&mut device, 1);
    assert_eq!(device.restart().unwrap().controller, ControllerChoice::Learned);
    device.telemetry(true).unwrap();
    device.apply(paper_settings(25.0)).unwrap();
    device.start().unwrap();
    Samples::default().until(&device, |sample| (sample.breath, sample.tick) == (1, 400));
    assert_eq!(device.alarms().unwrap(), AlarmStatus::default());
    let mut debugger = debugger(&board);
    debugger.run_to(symbol(&image("hil"), CONTROL_STEP).unwrap()).unwrap();
    (board, device, debugger)
}

/// Lets the halted control task hang, and waits for the watchdog's reset.
fn hang(mut debugger: Debugger, device: &mut Device) {
    // The default interrupt handler is an endless loop.
    debugger.jump(symbol(&image("hil"), "DefaultHandler_").unwrap()).unwrap();
    debugger.detach().unwrap();
    restarted_by(device, ResetCause::Watchdog);
}

/// Control ticks from the last start of the device until ventilation resumed.
fn resumed_after(device: &mut Device) -> u32 {
    let blackbox = device.blackbox(&Progress::silent()).unwrap();
    let resumed =
        |event: &&LogEntry| event.happening == Happening::Start && event.boot == blackbox.status.boot;
    blackbox.log.iter().find(resumed).expect("ventilation resumes").tick
}

#[test]
fn a_control_task_that_hangs_in_mid_breath_resumes_with_its_settings_and_the_pid_alone() {
    let (_board, mut device, debugger) = halted_in_mid_breath();
    hang(debugger, &mut device);
    let alarms = device.alarms().unwrap();
    assert_eq!(device.identify().unwrap().mode, Mode::Ventilating);
    assert!(alarms.indicated.has(Fault::Restarted));
    assert_eq!(alarms.level, Level::Pid);
    assert_eq!(device.settings().unwrap().0, paper_settings(25.0));
    assert!(resumed_after(&mut device) <= 2000, "later than 2 s");
    device.telemetry(true).unwrap();
    assert_eq!(device.acknowledge().unwrap(), Mode::Ventilating);
    indicates(&mut device, |alarms| !alarms.indicated.has(Fault::Restarted));
    indicates(&mut device, |alarms| alarms.level == Level::Learned);
    assert_eq!(device.stop().unwrap(), Mode::Standby);
    assert_eq!(
        device.restart().unwrap().mode,
        Mode::Standby,
        "after a requested restart nothing moves by itself"
    );
}

#[test]
fn a_damaged_prescription_stays_in_standby_with_the_alarm() {
    /// The settings in both copies: after magic word and sequence number, 11 words apart.
    const SETTINGS: [u32; 2] = [8, 8 + 44];
    let (_board, mut device, mut debugger) = halted_in_mid_breath();
    let start = symbol(&image("hil"), "__prescription_start").unwrap();
    let pip = 25.0_f32.to_le_bytes();
    let copies = SETTINGS.map(|offset| debugger.read(start + offset, 4).unwrap());
    assert!(copies.contains(&pip.to_vec()), "the settings in force are there: {copies:?}");
    for offset in SETTINGS {
        debugger.write(start + offset, &26.0_f32.to_le_bytes()).unwrap();
    }
    hang(debugger, &mut device);
    assert_eq!(device.identify().unwrap().mode, Mode::Standby);
    assert!(device.alarms().unwrap().indicated.has(Fault::Restarted));
    assert_eq!(device.settings().unwrap(), (Settings::default(), None));
}

#[test]
fn a_supply_that_falls_in_mid_breath_resumes_when_it_returns() {
    let (board, mut device, mut halted) = halted_in_mid_breath();
    halted.write(record::CONDITIONS_ADDRESS, &record::SUPPLY_LOW.to_le_bytes()).unwrap();
    halted.detach().unwrap();
    assert!(failure(&mut device).contains("supply voltage"));
    assert_eq!(device.identify().unwrap().mode, Mode::Standby, "until the supply returns");
    assert!(device.alarms().unwrap().indicated.has(Fault::Restarted));
    debugger(&board).suffer(0).unwrap();
    let deadline = Instant::now() + DEADLINE;
    while device.identify().unwrap().mode != Mode::Ventilating {
        assert!(Instant::now() < deadline, "ventilation does not resume");
    }
    assert_eq!(device.alarms().unwrap().level, Level::Pid);
    assert_eq!(device.settings().unwrap().0, paper_settings(25.0));
}

#[test]
fn the_ticks_before_one_that_hung_are_there_after_the_watchdogs_reset() {
    let (board, mut device) = breathing(EmulatorConfig { debugger: true, ..config("hil") }, &lung());
    device.telemetry(true).unwrap();
    device.start().unwrap();
    let mut samples = Samples::default();
    samples.until(&device, |sample| (sample.breath, sample.tick) == (1, 0));
    let mut debugger = debugger(&board);
    let step = symbol(&image("hil"), CONTROL_STEP).unwrap();
    debugger.write(step, &[0xFE, 0xE7]).unwrap();
    debugger.detach().unwrap();
    restarted_by(&mut device, ResetCause::Watchdog);
    let blackbox = device.blackbox(&Progress::silent()).unwrap();
    // It resumes, and hangs again, until it gives up.
    assert_eq!((blackbox.status.boot, blackbox.status.recording), (2 + RESUMES, RecordingState::Reset));
    assert_eq!(blackbox.status.tick_boot, 1);
    assert!(happened(&blackbox, Happening::Boot { cause: ResetCause::Watchdog, failed: false }));
    // The last ticks received before the hang must be in the recorder, to its resolution.
    let recorded: Vec<_> = blackbox.fast.ticks().collect();
    assert_eq!(recorded.len(), FAST_ENTRIES);
    let mut sent = samples.all;
    for event in device.events().try_iter() {
        if let Event::Telemetry(batch) = event {
            sent.extend(batch.samples.iter().map(PackedSample::unpack));
        }
    }
    let sent = &sent[sent.len() - 500..];
    let same = |kept: &TickEntry, sent: &Sample| {
        (kept.pressure - sent.pressure).abs() < 0.011 && (kept.u_in - sent.u_in).abs() < 0.11
    };
    let found =
        recorded.windows(sent.len()).any(|part| part.iter().zip(sent).all(|(kept, sent)| same(kept, sent)));
    assert!(found, "the last received ticks are not in the recorder");
}

#[test]
fn reading_the_recorder_disturbs_no_tick() {
    let (_board, mut device) = breathing(config("hil"), &lung());
    device.telemetry(true).unwrap();
    device.start().unwrap();
    let mut samples = Samples::default();
    samples.until(&device, |sample| sample.breath == 1);
    device.timing(true).unwrap();
    let blackbox = device.blackbox(&Progress::silent()).unwrap();
    samples.until(&device, |sample| sample.breath == 3);
    let times = device.timing(false).unwrap();
    assert_eq!((blackbox.status.recording, blackbox.unread), (RecordingState::Running, 0));
    assert!(blackbox.fast.ticks().all(|tick| tick.activity == Activity::Ventilating));
    assert_eq!((times.missed, samples.counters.missed_ticks, samples.counters.dropped), (0, 0, 0));
    let jitter = times.period.longest.abs_diff(TICK_CYCLES).max(times.period.shortest.abs_diff(TICK_CYCLES));
    assert!(jitter <= 2 * MICROSECOND, "{jitter} cycles");
}

#[test]
fn two_runs_on_the_image_are_equal() {
    let run = || {
        let (_board, device) = breathing(config("hil"), &lung());
        let mut port = PortSource::new(device, 9).unwrap();
        port.configure(pid(KNOWN_GOOD), None).unwrap();
        let breaths = PAPER_PIPS.map(paper_settings);
        port.upcoming(&breaths).unwrap();
        let mut hash = Fnv::default();
        for breath in &breaths {
            port.breath(breath, &mut |tick| hash.command(tick.sample.u_in, tick.sample.u_out)).unwrap();
        }
        hash.value()
    };
    assert_eq!(run(), run());
}
