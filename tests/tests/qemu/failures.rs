//! Failures of program, stack, clock and supply.

use super::*;

/// Verifies: tick-watchdog.
#[test]
fn a_control_tick_that_hangs_is_ended_by_the_watchdog() {
    let (board, mut device) = breathing(EmulatorConfig { debugger: true, ..config("hil") }, &lung());
    let mut debugger = debugger(&board);
    let step = symbol(&image("hil"), CONTROL_STEP).unwrap();
    let whole = debugger.read(step, 2).unwrap();
    // A branch to itself in place of the step's first instruction.
    debugger.write(step, &[0xFE, 0xE7]).unwrap();
    debugger.detach().unwrap();
    let _ = start(&mut device);
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

/// Verifies: tick-watchdog.
#[test]
fn a_program_that_fails_tells_the_reason_after_its_restart() {
    let (board, mut device) = breathing(EmulatorConfig { debugger: true, ..config("hil") }, &lung());
    let mut debugger = debugger(&board);
    let step = symbol(&image("hil"), CONTROL_STEP).unwrap();
    // An instruction that is permanently undefined.
    debugger.write(step, &[0x00, 0xDE]).unwrap();
    debugger.detach().unwrap();
    let _ = start(&mut device);
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

/// Verifies: stack-guard.
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

/// Verifies: stack-guard.
#[test]
fn a_stack_that_overflows_is_reported_and_the_recorder_keeps_the_ticks_before() {
    let (board, mut device) = breathing(EmulatorConfig { debugger: true, ..config("hil") }, &lung());
    device.telemetry(true).unwrap();
    start(&mut device).unwrap();
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

/// What must be left of a stack, bytes.
const RESERVE: usize = 4 * 1024;

/// Bytes of the stack that a board has used: the start painted the rest.
fn used_stack(firmware: &str, board: &Emulator) -> usize {
    const PAINT: [u8; 4] = 0xCCCC_CCCC_u32.to_le_bytes();
    let [bottom, top] = ["_stack_end", "_stack_start"].map(|name| symbol(&image(firmware), name).unwrap());
    let stack = debugger(board).read(bottom, (top - bottom) as usize).unwrap();
    let unused = 4 * stack.as_chunks().0.iter().take_while(|word| **word == PAINT).count();
    let used = stack.len() - unused;
    println!("{firmware}: {used} of {} bytes of the stack are used", stack.len());
    assert!(
        used > 0 && unused >= RESERVE,
        "{firmware}: {used} of {} bytes of the stack are used",
        stack.len()
    );
    used
}

fn store(device: &mut Device, version: u32) {
    device.upload(&weights::signed(version, weights::TRUSTED), &Progress::silent()).unwrap();
}

/// Ventilates for some breaths, and reads the flight recorder.
fn ventilate(device: &mut Device) {
    device.telemetry(true).unwrap();
    start(device).unwrap();
    Samples::default().until(device, |sample| sample.breath == 3);
    device.blackbox(&Progress::silent()).unwrap();
    device.stop().unwrap();
}

/// Verifies: stack-guard.
#[test]
fn the_smallest_stack_has_a_reserve() {
    /// Stack of the STM32F446, whose program is the same, bytes.
    const SMALLEST: usize = 39 * 1024;
    // The image `signed` also verifies signatures, at the start and in a store.
    for firmware in ["hil", "signed"] {
        let (board, mut device) = breathing(EmulatorConfig { debugger: true, ..config(firmware) }, &lung());
        store(&mut device, 1);
        device.restart().unwrap();
        ventilate(&mut device);
        store(&mut device, 2);
        assert!(used_stack(firmware, &board) <= SMALLEST - RESERVE);
    }
}

/// Verifies: stack-guard.
#[test]
fn the_stack_of_the_desk_which_the_small_board_has_too_has_a_reserve() {
    /// Limit for the variables and the stack in use, bytes.
    const MOST_RAM: usize = 96 * 1024;
    // As many faults as fit, one of them with delay lines, later than this test.
    let faults = "[[faults]]
        from_s = 1e4
        what = { sensor = { signal = \"converter\", distortion = { dead_time_ms = 250 } } }\n"
        .to_owned()
        + &"[[faults]]
        from_s = 1e4
        what = { sensor = { signal = \"airway\", distortion = { noise = 1 } } }\n"
            .repeat(MOST_FAULTS - 1);
    let bench = BenchConfig::from_toml(&faults).unwrap();
    let (board, mut device) = on_the_desk(EmulatorConfig { debugger: true, ..config("desk") }, &bench);
    store(&mut device, 1);
    device.restart().unwrap();
    device.set_bench(&bench.to_bytes()).unwrap();
    ventilate(&mut device);
    // A restart of the bench and a store at the same time.
    device.set_bench(&bench.to_bytes()).unwrap();
    store(&mut device, 2);
    let used = used_stack("desk", &board);
    let [first, end] = ["__ram_start", "__euninit"].map(|name| symbol(&image("desk"), name).unwrap());
    let variables = (end - first) as usize;
    assert!(variables + used <= MOST_RAM, "{variables} bytes of variables, {used} of the stack");
}

/// Verifies: crystal.
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
    start(&mut device).unwrap();
    Samples::default().until(&device, |sample| sample.breath == 1);
}

/// Verifies: crystal.
#[test]
fn a_crystal_that_stops_is_reported_and_ventilation_continues() {
    let (board, mut device) = breathing(EmulatorConfig { debugger: true, ..config("hil") }, &lung());
    device.telemetry(true).unwrap();
    start(&mut device).unwrap();
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

/// Verifies: supply-detector.
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

/// Verifies: supply-detector.
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
