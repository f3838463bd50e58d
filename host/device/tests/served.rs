//! Faults that are injected into a served device while it ventilates.

use std::time::{Duration, Instant};

use device::Device;
use device::simulated::{MOST_PACE, PlantFault, Served, ServedConfig};
use plant::bench::{BenchConfig, Failure};
use shared::link::messages::Event;
use shared::safety::alarms::Fault;
use shared::settings::Settings;

/// Longest time that any step here may take.
const LONG: Duration = Duration::from_mins(1);

fn ventilating() -> (Served, Device) {
    let config = ServedConfig { pace: MOST_PACE, weights: None, all_sensors: false, keeps_truth: false };
    let served = Served::with(&BenchConfig::paper(20.0, 20.0), config).unwrap();
    let mut device = Device::connect(served.address()).unwrap();
    device.telemetry(true).unwrap();
    device.apply(Settings::default()).unwrap();
    device.start().unwrap();
    (served, device)
}

/// Waits for an event that a test expects.
fn wait(device: &Device, mut expected: impl FnMut(&Event) -> bool) {
    let deadline = Instant::now() + LONG;
    while !expected(&device.events().recv_timeout(LONG).unwrap()) {
        assert!(Instant::now() < deadline, "the event did not come");
    }
}

/// Waits until this number of batches in a row has one pressure each, or none of them.
fn wait_for_readings(device: &Device, stuck: bool) {
    let mut found = 0;
    wait(device, |event| {
        if let Event::Telemetry(batch) = event {
            let pressure = |place: usize| batch.samples[place].unpack().pressure.to_bits();
            let same = (1..batch.samples.len()).all(|place| pressure(place) == pressure(0));
            found = if same == stuck { found + 1 } else { 0 };
        }
        found == 20
    });
}

#[test]
fn a_tube_comes_off_and_is_connected_again() {
    let (served, device) = ventilating();
    served.inject(PlantFault::Part(Failure::Disconnected));
    wait(&device, |event| {
        matches!(event, Event::Alarm { fault: Fault::Disconnection | Fault::LowPressure, .. })
    });
    served.inject(PlantFault::None);
    let mut reached = 0;
    wait(&device, |event| {
        let plateau = matches!(event, Event::Breath(breath) if breath.peak_pressure > 18.0);
        reached += u32::from(plateau);
        reached == 3
    });
}

#[test]
fn a_reading_sticks_until_the_fault_ends() {
    let (served, device) = ventilating();
    wait_for_readings(&device, false);
    served.inject(PlantFault::ReadingSticks);
    wait_for_readings(&device, true);
    served.inject(PlantFault::None);
    wait_for_readings(&device, false);
}

#[test]
fn a_cough_shows_in_the_pressure() {
    let (served, device) = ventilating();
    wait(&device, |event| matches!(event, Event::Breath(breath) if breath.breath == 2));
    served.inject(PlantFault::Cough(40.0));
    wait(&device, |event| matches!(event, Event::Breath(breath) if breath.peak_pressure > 24.0));
}
