//! After a fault or a reset: the flight recorder, and ventilation that resumes.

use super::*;

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

/// A board with a folder of its own, which keeps the flash, and a debugger.
fn kept_in(folder: &tempfile::TempDir) -> (Emulator, Device) {
    let folder = Some(folder.path().to_owned());
    breathing(EmulatorConfig { folder, debugger: true, ..config("hil") }, &lung())
}

/// Ventilates for two breaths and stops.
fn ventilate(device: &mut Device) {
    // Samples of an earlier ventilation are no part of this one.
    device.events().try_iter().for_each(drop);
    device.telemetry(true).unwrap();
    device.apply(paper_settings(25.0)).unwrap();
    device.start().unwrap();
    Samples::default().until(device, |sample| (sample.breath, sample.tick) == (2, 0));
    assert_eq!(device.stop().unwrap(), Mode::Standby);
}

/// Flash operations since power-on.
fn flash_operations(board: &Emulator) -> u32 {
    let mut halted = debugger(board);
    let operations = halted.record().unwrap().flash_operations;
    halted.detach().unwrap();
    operations
}

/// Waits until the copy of the flight recorder in one of its sectors is complete, and the other sector erased for the next.
fn copied(board: &Emulator, sector: usize) {
    let unit = |sector: usize, last: usize| {
        let flash = board.flash().unwrap();
        let end = COPIES as usize + sector * SECTOR_BYTES as usize + Keeper::BYTES as usize;
        flash[end - last * UNIT..][..4] != [0xFF; 4]
    };
    let deadline = Instant::now() + DEADLINE;
    // The commit word is in the last unit but one, the mark of an ended erase in the last.
    while !(unit(sector, 2) && !unit(1 - sector, 2) && unit(1 - sector, 1)) {
        assert!(Instant::now() < deadline, "no copy is made");
        std::thread::sleep(Duration::from_millis(20));
    }
}

#[test]
fn the_recording_of_an_ended_ventilation_outlasts_a_power_cut() {
    let folder = tempfile::tempdir().unwrap();
    let (board, mut device) = kept_in(&folder);
    ventilate(&mut device);
    copied(&board, 0);
    let before = device.blackbox(&Progress::silent()).unwrap();
    assert_eq!((before.status.recording, before.from_flash), (RecordingState::Stopped, false));
    drop((device, board));
    let (board, mut device) = kept_in(&folder);
    assert_eq!(device.identify().unwrap().reset, ResetCause::PowerOn);
    let after = device.blackbox(&Progress::silent()).unwrap();
    assert!(after.from_flash);
    assert_eq!((after.status.recording, after.status.tick), (RecordingState::Stopped, before.status.tick));
    assert_eq!((after.status.tick_boot, after.status.boot), (1, 2));
    let bits = |ticks: &RecordedTicks| ticks.ticks().map(|tick| tick.pressure.to_bits()).collect::<Vec<_>>();
    assert_eq!(after.fast.entries.len(), FAST_ENTRIES);
    assert!(bits(&after.fast) == bits(&before.fast), "every tick of the last 2 s");
    assert!(bits(&before.slow).starts_with(&bits(&after.slow)));
    assert!(after.slow.ticks().any(|tick| tick.pressure > 20.0), "the breaths");
    assert!(after.log.starts_with(&before.log) && after.unread == 0);
    assert!(happened(&after, Happening::Chip(ChipEvent::RecorderRestored)));
    // What was read back is not copied again, and the next ventilation is.
    ventilate(&mut device);
    copied(&board, 1);
    let next = device.blackbox(&Progress::silent()).unwrap();
    assert_eq!((next.from_flash, next.status.tick_boot), (false, 2));
}

#[test]
fn a_power_cut_in_the_middle_of_a_copy_leaves_the_older_recording() {
    let folder = tempfile::tempdir().unwrap();
    let (board, mut device) = kept_in(&folder);
    ventilate(&mut device);
    copied(&board, 0);
    let older = device.recorder().unwrap().tick;
    let words = Keeper::BYTES / 4;
    let begun = flash_operations(&board);
    assert!(
        begun > words && begun < words + 64,
        "a copy of {words} words and two erases: {begun} operations"
    );
    debugger(&board).cut_power_at(begun + words / 2).unwrap();
    ventilate(&mut device);
    let mut board = board;
    board.wait().unwrap();
    assert!(board.log().ends_with("power cut"), "{}", board.log());
    drop((device, board));
    let (_board, mut device) = kept_in(&folder);
    let blackbox = device.blackbox(&Progress::silent()).unwrap();
    assert!(blackbox.from_flash);
    assert_eq!((blackbox.status.tick, blackbox.status.tick_boot), (older, 1));
}

#[test]
fn a_start_in_the_middle_of_a_copy_is_served_and_nothing_is_written_while_it_ventilates() {
    let (board, mut device) = breathing(EmulatorConfig { debugger: true, ..config("hil") }, &lung());
    ventilate(&mut device);
    let deadline = Instant::now() + DEADLINE;
    while flash_operations(&board) < 100 {
        assert!(Instant::now() < deadline, "no copy begins");
    }
    device.events().try_iter().for_each(drop);
    device.apply(Settings::default()).unwrap();
    assert_eq!(device.start().unwrap(), Mode::Ventilating);
    let begun = flash_operations(&board);
    assert!(begun < Keeper::BYTES / 4, "the copy was not complete: {begun}");
    let mut samples = Samples::default();
    samples.until(&device, |sample| (sample.breath, sample.tick) == (2, 0));
    assert_eq!((flash_operations(&board), samples.counters.missed_ticks), (begun, 0));
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

/// Verifies: tick-watchdog.
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

/// Verifies: kept-settings.
#[test]
fn a_damaged_prescription_stays_in_standby_with_the_alarm() {
    /// The settings in both copies: after magic word and sequence number, 11 words apart.
    const SETTINGS: [u32; 2] = [8, 8 + 44];
    let (_board, mut device, mut debugger) = halted_in_mid_breath();
    // The shim's own memory, since a debugger cannot read the part that it models.
    let start = shim::backup::ADDRESS;
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
    start(&mut device).unwrap();
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
