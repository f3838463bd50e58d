//! Calibrations in the flash: stored, read back, cut off; and their effect on the reading.

use shared::calibration::{CALIBRATION_BYTES, Calibration, SensorCorrection};
use shared::flash::journal::RECORD_BYTES;
use shared::link::refusal::Refusal;

use super::*;

/// Calibration of a unit whose sensor reads too high.
const FIRST: Calibration = Calibration {
    sensor_zero: 0.5,
    sensor_gain: 1.05,
    dead_time_ms: 12.0,
    lag_ms: 25.0,
    valve_flow: [0.25, 0.75, 1.25, 1.75],
    measured_at: 1_800_000_000,
};
const SECOND: Calibration = Calibration { sensor_zero: 0.25, measured_at: 1_800_086_400, ..FIRST };

/// A board whose flash is kept in a folder.
fn kept_in(folder: &tempfile::TempDir) -> (Emulator, Device) {
    let folder = Some(folder.path().to_owned());
    breathing(EmulatorConfig { folder, debugger: true, ..config("hil") }, &lung())
}

/// Ventilates for two breaths; returns the mean pressure in the last tenth of a second of the first expiration, cmH2O.
fn pressure_at_rest(device: &mut Device) -> f32 {
    device.telemetry(true).unwrap();
    start(device).unwrap();
    let mut samples = Samples::default();
    samples.until(device, |sample| (sample.breath, sample.tick) == (1, 0));
    device.stop().unwrap();
    let last: Vec<f32> =
        samples.all.iter().filter(|s| s.breath == 0 && s.tick >= 2900).map(|s| s.pressure).collect();
    last.iter().sum::<f32>() / last.len() as f32
}

#[test]
fn calibrations_outlast_resets_and_power_cuts_and_correct_the_reading() {
    let folder = tempfile::tempdir().unwrap();
    let (board, mut device) = kept_in(&folder);
    assert_eq!(device.calibration(0).unwrap(), (0, None));
    let uncorrected = pressure_at_rest(&mut device);
    assert_eq!(device.calibrate(&FIRST).unwrap(), 1);
    assert_eq!(device.calibrate(&SECOND).unwrap(), 2);
    device.restart().unwrap();
    assert_eq!(device.calibration(0).unwrap(), (2, Some(SECOND)));
    // A dropped board loses its power.
    drop((device, board));
    let (_board, mut device) = kept_in(&folder);
    assert_eq!(device.calibration(0).unwrap(), (2, Some(SECOND)));
    assert_eq!(device.calibration(1).unwrap(), (2, Some(FIRST)));
    assert_eq!(device.calibration(2).unwrap(), (2, None));
    let expected = SensorCorrection::new(&SECOND).unwrap().corrected(uncorrected);
    let corrected = pressure_at_rest(&mut device);
    assert!((corrected - expected).abs() < 0.1, "{uncorrected} is read as {corrected}, not {expected}");
    assert!(uncorrected - corrected > 0.3, "{uncorrected} {corrected}");
}

#[test]
fn no_calibration_is_stored_while_the_board_ventilates() {
    let (board, mut device) = breathing(EmulatorConfig { debugger: true, ..config("hil") }, &lung());
    device.telemetry(true).unwrap();
    start(&mut device).unwrap();
    let before = flash_operations(&board);
    let refused = device.calibrate(&FIRST);
    assert!(matches!(refused, Err(DeviceError::Refused(Refusal::Ventilating))), "{refused:?}");
    let mut samples = Samples::default();
    samples.until(&device, |sample| (sample.breath, sample.tick) == (1, 0));
    assert_eq!((flash_operations(&board), samples.counters.missed_ticks), (before, 0));
    assert_eq!(device.calibration(0).unwrap(), (0, None), "reading is allowed");
}

fn flash_operations(board: &Emulator) -> u32 {
    let mut halted = debugger(board);
    let operations = halted.record().unwrap().flash_operations;
    halted.detach().unwrap();
    operations
}

#[test]
fn a_cut_in_the_middle_of_a_store_leaves_the_older_calibration() {
    let folder = tempfile::tempdir().unwrap();
    let (board, mut device) = kept_in(&folder);
    device.calibrate(&FIRST).unwrap();
    drop((device, board));
    // Sequence number and checksum take a word each.
    let words = (CALIBRATION_BYTES / 4 + 2) as u32;
    let mut kept = 1;
    for cut in [1, words / 2, words - 1, words] {
        let (mut board, mut device) = kept_in(&folder);
        debugger(&board).cut_power_at(cut).unwrap();
        assert!(device.calibrate(&SECOND).is_err(), "the line closes when the power is cut");
        board.wait().unwrap();
        assert!(board.log().ends_with("power cut"), "{}", board.log());
        drop((device, board));
        let (_board, mut device) = kept_in(&folder);
        let newest = if cut < words { FIRST } else { SECOND };
        kept += u16::from(cut == words);
        assert_eq!(device.calibration(0).unwrap(), (kept, Some(newest)), "after a cut at word {cut}");
    }
    let (board, mut device) = kept_in(&folder);
    assert_eq!(device.calibrate(&FIRST).unwrap(), kept + 1, "the next store succeeds");
    let torn = board.flash().unwrap()[RECORD_BYTES..6 * RECORD_BYTES]
        .chunks(RECORD_BYTES)
        .filter(|r| r[0] != 0xFF)
        .count();
    assert_eq!(torn, 5, "each torn place stays unused");
}
