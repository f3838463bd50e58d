//! `trainer identify --port`: identifies the connected device.

use std::time::{SystemTime, UNIX_EPOCH};

use serde::Serialize;
use shared::calibration::Calibration;
use shared::link::messages::DeviceIdentity;
use shared::weights::slots::SlotState;

use crate::args::controller::image_id;
use crate::args::port::warn_of_development_build;
use crate::command::Context;
use device::port::Address;
use device::{Device, DeviceError};
use show::monitor::words;
use show::report::{Cell, Table};

/// The content of `--json`.
#[derive(Debug, Serialize)]
pub struct Found {
    port: String,
    identity: DeviceIdentity,
    calibrations: Calibrations,
}

/// The calibrations in a device.
#[derive(Debug, Serialize)]
struct Calibrations {
    /// Number of stored ones.
    stored: u16,
    newest: Option<Calibration>,
    /// Time since the newest was measured, s.
    age: Option<u64>,
}

/// Identifies the device at an address.
pub fn run(address: &Address, context: &Context<'_>) -> anyhow::Result<Found> {
    let mut device = Device::connect(address)?;
    let identity = device.identify()?;
    warn_of_development_build(&identity);
    let calibrations = calibrations(&mut device)?;
    let port = address.to_string();
    context.table(&table(&port, &identity, &calibrations));
    Ok(Found { port, identity, calibrations })
}

fn calibrations(device: &mut Device) -> Result<Calibrations, DeviceError> {
    let (stored, newest) = match device.calibration(0) {
        // A firmware from before calibrations.
        Err(DeviceError::Unknown(_)) => (0, None),
        answer => answer?,
    };
    let now = SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |since| since.as_secs());
    let age = newest.map(|newest| now.saturating_sub(newest.measured_at.into()));
    Ok(Calibrations { stored, newest, age })
}

fn table(port: &str, identity: &DeviceIdentity, calibrations: &Calibrations) -> Table {
    let mut table = Table::new("", &["device", port]);
    let mut row = |name: &str, value: String| table.row(vec![Cell::text(name), Cell::text(value)]);
    row("type", words::identity(identity));
    row("protocol", identity.protocol.to_string());
    row("started by", words::reset(identity.reset).to_owned());
    if let Some(failure) = &identity.failure {
        row("previous failure", failure.to_string());
    }
    row("mode", words::mode(identity.mode));
    row("controller", words::controller(identity.controller));
    row("explores", if identity.exploration.is_some() { "yes" } else { "no" }.to_owned());
    for (name, state) in ["slot A", "slot B"].into_iter().zip(&identity.slots) {
        row(name, slot(state));
    }
    row("weights key", words::weights_key(identity));
    row("loaded", identity.running.map_or("no weights".to_owned(), |slot| format!("slot {slot:?}")));
    row("calibrations", stored(calibrations));
    if let Some(newest) = calibrations.newest {
        let Calibration { sensor_zero, sensor_gain, dead_time_ms, lag_ms, valve_flow: [a, b, c, d], .. } =
            newest;
        row("airway sensor", format!("zero {sensor_zero:.2} cmH2O, gain {sensor_gain:.3}"));
        row("delays", format!("dead time {dead_time_ms:.1} ms, lag {lag_ms:.1} ms"));
        row("valve", format!("{a:.2}, {b:.2}, {c:.2}, {d:.2} L/s at 25, 50, 75, 100 %"));
    }
    table
}

/// Number of calibrations, and the age of the newest.
fn stored(calibrations: &Calibrations) -> String {
    const HOUR: u64 = 3600;
    const DAY: u64 = 24 * HOUR;
    match (calibrations.stored, calibrations.age) {
        (0, _) => "none: readings are not corrected".to_owned(),
        (count, None) => format!("{count}, the newest refused by this firmware: calibrate the device again"),
        (count, Some(age)) if age < 2 * DAY => format!("{count}, the newest {} h old", age / HOUR),
        (count, Some(age)) => format!("{count}, the newest {} days old", age / DAY),
    }
}

fn slot(state: &SlotState) -> String {
    match state {
        SlotState::Empty => "empty".to_owned(),
        SlotState::Torn => "upload not finished: upload again".to_owned(),
        SlotState::Invalid(problem) => format!("refused ({problem:?}): pack and upload it again"),
        SlotState::Valid { generation, id } => format!("weights {}, generation {generation}", image_id(*id)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use shared::device::KNOWN_GOOD;
    use shared::link::PROTOCOL;
    use shared::link::messages::{ControllerChoice, DeviceKind};
    use shared::reset::ResetCause;
    use shared::safety::alarms::Fault;
    use shared::ventilator::Mode;
    use shared::weights::ImageProblem;
    use shared::weights::slots::Slot;
    use shared::weights::trust::KeyId;

    fn identity() -> DeviceIdentity {
        DeviceIdentity {
            protocol: PROTOCOL,
            firmware: [0, 1, 2],
            device: DeviceKind::HardwareInTheLoop,
            period_us: 1000,
            mode: Mode::Fault(Fault::ReadingOutOfRange),
            controller: ControllerChoice::Pid(KNOWN_GOOD),
            exploration: None,
            slots: [SlotState::Valid { generation: 7, id: 0xBEEF }, SlotState::Torn],
            running: Some(Slot::A),
            reset: ResetCause::Watchdog,
            failure: Some("index out of bounds".try_into().unwrap()),
            weights_key: Some(KeyId([0xAB; 8])),
        }
    }

    const NONE: Calibrations = Calibrations { stored: 0, newest: None, age: None };

    fn calibrated(stored: u16, age: u64) -> Calibrations {
        let newest = Calibration {
            sensor_zero: 0.5,
            sensor_gain: 1.05,
            dead_time_ms: 12.0,
            lag_ms: 25.0,
            valve_flow: [0.25, 0.75, 1.25, 1.75],
            measured_at: 1_800_000_000,
        };
        Calibrations { stored, newest: Some(newest), age: Some(age) }
    }

    #[test]
    fn everything_that_the_device_holds_is_told() {
        let table = table("/dev/ttyACM0", &identity(), &calibrated(3, 30 * 86_400));
        insta::assert_snapshot!(table.to_plain());
    }

    #[test]
    fn the_age_of_a_calibration_is_told_in_hours_and_then_in_days() {
        assert_eq!(stored(&calibrated(1, 7199)), "1, the newest 1 h old");
        assert_eq!(stored(&calibrated(2, 172_799)), "2, the newest 47 h old");
        assert_eq!(stored(&calibrated(2, 172_800)), "2, the newest 2 days old");
        assert!(stored(&NONE).contains("not corrected"));
        assert!(stored(&Calibrations { stored: 1, ..NONE }).contains("calibrate the device again"));
    }

    #[test]
    fn a_device_without_weights_or_failure_says_so() {
        let slots = [SlotState::Empty, SlotState::Invalid(ImageProblem::Checksum)];
        let text =
            table("COM3", &DeviceIdentity { slots, running: None, failure: None, ..identity() }, &NONE)
                .to_plain();
        assert!(text.contains("empty") && text.contains("Checksum") && text.contains("no weights"), "{text}");
        assert!(!text.contains("failed before"), "{text}");
        let development =
            table("COM3", &DeviceIdentity { weights_key: None, ..identity() }, &NONE).to_plain();
        assert!(development.contains("none: accepts unsigned weights"), "{development}");
    }
}
