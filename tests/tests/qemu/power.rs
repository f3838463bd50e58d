//! A supply that is lost while the device ventilates, with the backup domain on its cell.

use super::*;

/// A board in a folder, after this time without supply; none: without a cell, so the backup domain is lost.
fn after(folder: &tempfile::TempDir, supply_away: Option<u64>) -> (Emulator, Device) {
    let folder = Some(folder.path().to_owned());
    let supply_away = supply_away.map(Duration::from_secs);
    breathing(EmulatorConfig { folder, supply_away, debugger: true, ..config("hil") }, &lung())
}

/// Whether the board's calendar clock was set.
fn is_clock_set(board: &Emulator) -> bool {
    let bytes = fs::read(board.backup()).unwrap();
    bytes[4 * (shim::backup::TIME + 1) + 2] != 0
}

/// Ventilates at a PIP of 25 cmH2O up to the middle of an inspiration.
fn reach_mid_breath(device: &mut Device) {
    device.telemetry(true).unwrap();
    device.apply(paper_settings(25.0)).unwrap();
    device.start().unwrap();
    Samples::default().until(device, |sample| (sample.breath, sample.tick) == (2, 400));
}

/// Ventilates a new device, with the clock running, and cuts the supply in mid-breath.
fn cut_in_mid_breath(folder: &tempfile::TempDir) {
    let (board, mut device) = after(folder, None);
    let identity = device.identify().unwrap();
    assert_eq!((identity.reset, identity.mode), (ResetCause::PowerOn, Mode::Standby));
    assert_eq!(device.alarms().unwrap(), AlarmStatus::default(), "a first start");
    reach_mid_breath(&mut device);
    assert!(is_clock_set(&board));
}

/// Asserts that a device stays in standby with the alarm, and that its log contains the reason.
fn stays_in_standby(device: &mut Device, reason: ChipEvent) {
    let identity = device.identify().unwrap();
    assert_eq!((identity.reset, identity.mode), (ResetCause::PowerOn, Mode::Standby));
    assert!(device.alarms().unwrap().indicated.has(Fault::Restarted));
    assert_eq!(device.settings().unwrap(), (Settings::default(), None));
    let blackbox = device.blackbox(&Progress::silent()).unwrap();
    assert!(happened(&blackbox, Happening::Chip(reason)), "{:?}", blackbox.log);
    assert_eq!(device.identify().unwrap().mode, Mode::Standby);
}

/// Changes the file of the backup domain between two runs: the words with this value get another one.
fn replace(folder: &tempfile::TempDir, old: u32, new: u32) -> usize {
    let path = folder.path().join(shim::BACKUP_FILE.to_str().unwrap());
    let mut bytes = fs::read(&path).unwrap();
    let words = bytes.as_chunks_mut().0.iter_mut();
    let found = words.filter(|word| **word == old.to_le_bytes()).map(|word| *word = new.to_le_bytes());
    let count = found.count();
    fs::write(&path, bytes).unwrap();
    count
}

/// Virtual time from the chip's start to its first control tick, ms, if the chip has started once. The shim's timer counts
/// nanoseconds since the start and wraps after 4.3 s; each tick feeds the watchdog once.
fn boot_ms(board: &Emulator) -> f64 {
    const TIMER: u32 = 0x4000_0C24;
    let mut halted = debugger(board);
    let ticks = halted.record().unwrap().feeds;
    let nanoseconds = u32::from_le_bytes(halted.read(TIMER, 4).unwrap().try_into().unwrap());
    halted.detach().unwrap();
    f64::from(nanoseconds.wrapping_sub(ticks.wrapping_mul(1_000_000))) * 1e-6
}

/// Highest pressure in two whole breaths, cmH2O, whatever alarms are raised meanwhile.
fn highest_of_two_breaths(device: &mut Device) -> f32 {
    device.telemetry(true).unwrap();
    let (mut first, mut highest) = (None, 0.0_f32);
    let deadline = Instant::now() + DEADLINE;
    loop {
        let event = device.events().recv_timeout(deadline - Instant::now()).expect("samples come");
        let Event::Telemetry(batch) = event else { continue };
        for sample in batch.samples.iter().map(PackedSample::unpack) {
            highest = highest.max(sample.pressure);
            if sample.breath > *first.get_or_insert(sample.breath) + 2 {
                return highest;
            }
        }
    }
}

/// Verifies: resume.
#[test]
fn a_power_cut_in_mid_breath_resumes_within_2_s_with_its_settings_and_the_pid_alone() {
    let folder = tempfile::tempdir().unwrap();
    cut_in_mid_breath(&folder);
    let (board, mut device) = after(&folder, Some(14 * 60 + 58));
    let identity = device.identify().unwrap();
    assert_eq!((identity.reset, identity.mode), (ResetCause::PowerOn, Mode::Ventilating));
    let alarms = device.alarms().unwrap();
    assert!(alarms.indicated.has(Fault::Restarted));
    assert_eq!(alarms.level, Level::Pid);
    assert_eq!(device.settings().unwrap().0, paper_settings(25.0));
    let blackbox = device.blackbox(&Progress::silent()).unwrap();
    assert!(happened(&blackbox, Happening::Boot { cause: ResetCause::PowerOn, failed: false }));
    let resumed = blackbox.log.iter().find(|event| event.happening == Happening::Start).unwrap();
    let (boot, breath) = (boot_ms(&board), f64::from(resumed.tick));
    println!("{boot:.0} ms to the first tick, {breath:.0} ms to the first breath");
    assert!(boot + breath < 2000.0, "{boot} ms to the first tick, {breath} ms to the first breath");
    let highest = highest_of_two_breaths(&mut device);
    assert!((24.0..30.0).contains(&highest), "{highest} cmH2O");
    // A second cut is survived as well.
    drop((device, board));
    let (_board, mut device) = after(&folder, Some(60));
    assert_eq!(device.identify().unwrap().mode, Mode::Ventilating);
    assert_eq!(device.stop().unwrap(), Mode::Standby);
}

/// Verifies: absence-limit.
#[test]
fn a_power_cut_of_more_than_15_min_ends_in_standby_with_the_reason() {
    let folder = tempfile::tempdir().unwrap();
    cut_in_mid_breath(&folder);
    let (board, mut device) = after(&folder, Some(15 * 60 + 2));
    stays_in_standby(&mut device, ChipEvent::AbsentTooLong);
    drop((device, board));
    let (_board, mut device) = after(&folder, Some(1));
    assert_eq!(device.identify().unwrap().mode, Mode::Standby, "and is over");
    assert_eq!(device.alarms().unwrap(), AlarmStatus::default());
}

/// Verifies: kept-settings.
#[test]
fn a_prescription_that_was_damaged_without_supply_ends_in_standby_with_the_reason() {
    let folder = tempfile::tempdir().unwrap();
    cut_in_mid_breath(&folder);
    assert_eq!(replace(&folder, 25.0_f32.to_bits(), 26.0_f32.to_bits()), 1);
    let (_board, mut device) = after(&folder, Some(60));
    stays_in_standby(&mut device, ChipEvent::PrescriptionDamaged);
}

/// Verifies: absence-limit.
#[test]
fn a_clock_that_has_gone_back_ends_in_standby_with_the_reason() {
    let folder = tempfile::tempdir().unwrap();
    cut_in_mid_breath(&folder);
    let path = folder.path().join(shim::BACKUP_FILE.to_str().unwrap());
    let mut bytes = fs::read(&path).unwrap();
    bytes[4 * shim::backup::TIME..][..4].fill(0);
    fs::write(&path, bytes).unwrap();
    let (_board, mut device) = after(&folder, Some(0));
    stays_in_standby(&mut device, ChipEvent::AbsenceUnknown);
}

/// Verifies: absence-limit.
#[test]
fn without_the_clocks_crystal_a_power_cut_in_mid_breath_ends_in_standby_with_the_reason() {
    let folder = tempfile::tempdir().unwrap();
    let (board, mut device) = after(&folder, None);
    debugger(&board).suffer(record::NO_CLOCK_CRYSTAL).unwrap();
    device.restart().unwrap();
    reach_mid_breath(&mut device);
    drop((device, board));
    let (_board, mut device) = after(&folder, Some(60));
    stays_in_standby(&mut device, ChipEvent::AbsenceUnknown);
}

/// Verifies: first-start.
#[test]
fn without_a_cell_or_after_a_stop_a_power_cut_is_a_first_start() {
    let folder = tempfile::tempdir().unwrap();
    cut_in_mid_breath(&folder);
    // A first start as well, of which it asserts that no alarm is raised.
    cut_in_mid_breath(&folder);
    let (board, mut device) = after(&folder, Some(60));
    assert_eq!(device.stop().unwrap(), Mode::Standby);
    drop((device, board));
    let (_board, mut device) = after(&folder, Some(60));
    assert_eq!(device.identify().unwrap().mode, Mode::Standby);
    assert_eq!(device.alarms().unwrap(), AlarmStatus::default());
}
