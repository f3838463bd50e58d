//! Calibrations: what is stored, when not, and what they do to a reading.

use super::*;
use crate::calibration::tests::SOUND;
use crate::calibration::{Calibration, CalibrationError, Quantity, SensorCorrection};
use crate::link::messages::Response;

/// The calibration with which a reading is furthest below the pressure.
const READS_LOW: Calibration = Calibration {
    sensor_zero: Quantity::SensorZero.bounds().1,
    sensor_gain: Quantity::SensorGain.bounds().1,
    ..SOUND
};

fn stored(stored: u16, calibration: Calibration) -> Response {
    Response::Calibration { stored, calibration: Some(calibration) }
}

/// The pressure in the newest sample.
fn pressure(rig: &Rig) -> f32 {
    rig.samples().last().unwrap().pressure
}

#[test]
fn calibrations_are_stored_and_read_back_to_the_oldest() {
    let mut rig = Rig::new(None);
    let newest = |back| Request::GetCalibration { back };
    assert_eq!(rig.ask(newest(0)), Response::Calibration { stored: 0, calibration: None });
    let second = Calibration { sensor_zero: -0.5, measured_at: 1_800_086_400, ..SOUND };
    assert_eq!(rig.ask(Request::StoreCalibration(SOUND)), stored(1, SOUND));
    assert_eq!(rig.ask(Request::StoreCalibration(second)), stored(2, second));
    assert_eq!(rig.ask_by(None, newest(0)), stored(2, second), "a host without the lease reads");
    assert_eq!(rig.ask(newest(1)), stored(2, SOUND));
    assert_eq!(rig.ask(newest(2)), Response::Calibration { stored: 2, calibration: None });
}

#[test]
fn a_calibration_is_stored_only_in_standby_by_the_host_that_steers() {
    let mut rig = Rig::new(None);
    let request = || Request::StoreCalibration(SOUND);
    assert_eq!(rig.ask_by(HOST, request()), Response::Refused(Refusal::NoLease));
    rig.start();
    assert_eq!(rig.ask(request()), Response::Refused(Refusal::Ventilating));
    rig.run(20);
    rig.run_blocked(800, 70.0);
    assert_eq!(rig.ask(request()), Response::Refused(Refusal::FaultLatched));
    rig.ask(Request::Acknowledge);
    assert!(matches!(rig.ask(Request::RunSelfTest(Check::Circuit)), Response::SelfTest(_)));
    assert_eq!(rig.ask(request()), Response::Refused(Refusal::SelfTestRuns));
    rig.ask(Request::Stop);
    assert_eq!(rig.ask(request()), stored(1, SOUND));
}

#[test]
fn a_calibration_out_of_bounds_is_refused_and_not_stored() {
    let mut rig = Rig::new(None);
    let refused = rig.ask(Request::StoreCalibration(Calibration { sensor_gain: 1.2, ..SOUND }));
    let error = CalibrationError::OutOfBounds { quantity: Quantity::SensorGain, value: 1.2 };
    assert_eq!(refused, Response::Refused(Refusal::Calibration(error)));
    let none = rig.ask(Request::GetCalibration { back: 0 });
    assert_eq!(none, Response::Calibration { stored: 0, calibration: None });
}

#[test]
fn a_calibration_that_the_flash_refuses_corrects_nothing() {
    let mut rig = Rig { flash: Flash::failing(), ..Rig::new(None) };
    let refused = rig.ask(Request::StoreCalibration(SOUND));
    assert_eq!(refused, Response::Refused(Refusal::CalibrationStorage));
    rig.ask(Request::Telemetry { on: true });
    rig.start();
    rig.run_at(200, 10.3);
    assert_eq!(pressure(&rig).to_bits(), 10.3_f32.to_bits());
}

#[test]
fn a_stored_calibration_corrects_the_reading_from_the_next_start_on() {
    let mut rig = Rig::new(None);
    rig.ask(Request::Telemetry { on: true });
    rig.start();
    rig.run_at(200, 10.3);
    assert_eq!(pressure(&rig).to_bits(), 10.3_f32.to_bits(), "without a calibration no bit changes");
    rig.ask(Request::Stop);
    rig.ask(Request::StoreCalibration(SOUND));
    rig.start();
    rig.run_at(200, 10.3);
    let corrected = SensorCorrection::new(&SOUND).unwrap().corrected(10.3);
    assert_eq!(pressure(&rig).to_bits(), corrected.to_bits());
    assert!((corrected - 9.333).abs() < 1e-3, "{corrected}");
}

#[test]
fn a_calibration_replaces_the_zero_of_an_earlier_check() {
    let mut rig = Rig::new(None);
    rig.ask(Request::Telemetry { on: true });
    assert!(matches!(rig.ask(Request::RunSelfTest(Check::Zero)), Response::SelfTest(_)));
    rig.run_at(600, 0.5);
    rig.start();
    rig.run_at(200, 10.5);
    assert!((pressure(&rig) - 10.0).abs() < 1e-3, "the check's zero");
    rig.ask(Request::Stop);
    rig.ask(Request::StoreCalibration(Calibration { sensor_gain: 1.0, ..SOUND }));
    rig.start();
    rig.run_at(200, 10.5);
    assert!((pressure(&rig) - 10.0).abs() < 1e-3, "not subtracted twice: {}", pressure(&rig));
}

#[test]
fn the_flight_recorder_sees_the_reading_that_the_ventilator_sees() {
    let mut control = control(DeviceKind::Simulated, None);
    let correction = SensorCorrection::new(&SOUND).unwrap();
    control.calibrate(correction);
    begin(&mut control);
    let output = control.step(10.3);
    let recorded = control.moment(10.3, &output, 0).reading;
    assert_eq!(recorded.to_bits(), output.sample.unwrap().pressure.to_bits());
    assert_eq!(recorded.to_bits(), correction.corrected(10.3).to_bits(), "the corrected one");
}

#[test]
fn the_worst_allowed_calibration_leaves_the_hard_limit_in_place() {
    let limit = Settings::default().pressure_limit;
    let (zero, gain) = (READS_LOW.sensor_zero, READS_LOW.sensor_gain);
    for (pressure, vents) in [(limit * gain + zero - 0.1, false), (limit * gain + zero + 0.1, true)] {
        let mut rig = Rig::new(None);
        assert_eq!(rig.ask(Request::StoreCalibration(READS_LOW)), stored(1, READS_LOW));
        rig.start();
        rig.run(20);
        rig.run_blocked(800, pressure);
        let latched = Mode::Fault(Fault::HardLimit);
        assert_eq!(rig.control.mode() == latched, vents, "at {pressure} cmH2O");
    }
}

#[test]
fn no_calibration_moves_the_highest_limit_out_of_the_sensors_reach() {
    let field = |field: &&crate::settings::Field| field.name == "pressure_limit";
    let highest = crate::settings::FIELDS.iter().find(field).unwrap().max;
    let reading = SensorCorrection::new(&READS_LOW).unwrap().reading(highest);
    // The lowest reading that a sensor at the end of its range can give, beyond its span.
    assert!(reading < crate::sensor::HIGHEST_PRESSURE, "{reading} cmH2O");
}
