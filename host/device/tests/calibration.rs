//! Calibrations of a simulated device at a pseudo-terminal: stored, read back, and their effect on the readings.
#![cfg(unix)]

use std::time::Duration;

use device::Device;
use device::port::{Address, BAUD, Port};
use device::simulated::Simulated;
use plant::bench::BenchConfig;
use serialport::{SerialPort, TTYPort};
use shared::calibration::{Calibration, SensorCorrection};
use shared::link::messages::Event;
use shared::link::telemetry::PackedSample;
use shared::settings::Settings;

/// A simulated device and a connection to it; the terminal stays open while the last part lives.
fn connected() -> (Device, Simulated, TTYPort) {
    let (mut master, slave) = TTYPort::pair().unwrap();
    master.set_timeout(Duration::from_millis(2)).unwrap();
    let address = Address::Serial { name: slave.name().unwrap(), baud: BAUD };
    let reader = Box::new(master.try_clone_native().unwrap());
    // A long timeout for writes, because the host may be busy.
    master.set_timeout(Duration::from_mins(1)).unwrap();
    let port = Port { reader, writer: Box::new(master) };
    let simulated = Simulated::start(&BenchConfig::paper(20.0, 20.0), port).unwrap();
    (Device::connect(&address).unwrap(), simulated, slave)
}

#[test]
fn a_calibration_outlasts_a_restart_and_corrects_the_readings() {
    let (mut device, _simulated, _terminal) = connected();
    let first = Calibration {
        sensor_zero: 0.5,
        sensor_gain: 1.05,
        dead_time_ms: 12.0,
        lag_ms: 25.0,
        valve_flow: [0.25, 0.75, 1.25, 1.75],
        measured_at: 1_800_000_000,
    };
    let second = Calibration { sensor_zero: 0.25, ..first };
    let uncorrected = pressure_at_rest(&mut device);
    assert_eq!(device.calibration(0).unwrap(), (0, None));
    assert_eq!((device.calibrate(&first).unwrap(), device.calibrate(&second).unwrap()), (1, 2));
    let corrected = pressure_at_rest(&mut device);
    let expected = SensorCorrection::new(&second).unwrap().corrected(uncorrected);
    assert!((corrected - expected).abs() < 0.2, "{uncorrected} is read as {corrected}, not {expected}");
    device.restart().unwrap();
    assert_eq!(device.calibration(0).unwrap(), (2, Some(second)));
    assert_eq!(device.calibration(1).unwrap(), (2, Some(first)));
    let corrected = pressure_at_rest(&mut device);
    assert!((corrected - expected).abs() < 0.2, "after a restart: {corrected}");
    let refused = device.calibrate(&Calibration { sensor_gain: 2.0, ..first }).unwrap_err().to_string();
    assert!(refused.contains("gain of the sensor = 2 is outside 0.9 to 1.1"), "{refused}");
}

/// The mean pressure at the end of the first expiration, cmH2O. The device ends in standby.
fn pressure_at_rest(device: &mut Device) -> f32 {
    device.telemetry(true).unwrap();
    device.events().try_iter().for_each(drop);
    device.apply(Settings::default()).unwrap();
    device.start().unwrap();
    let mut last = Vec::new();
    while last.len() < 100 {
        let event = device.events().recv_timeout(Duration::from_secs(30)).expect("samples come");
        let Event::Telemetry(batch) = event else { continue };
        let samples = batch.samples.iter().map(PackedSample::unpack);
        last.extend(samples.filter(|sample| sample.tick >= 2900).map(|sample| sample.pressure));
    }
    device.stop().unwrap();
    last.iter().sum::<f32>() / last.len() as f32
}
