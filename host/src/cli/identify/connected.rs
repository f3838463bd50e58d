//! `trainer identify --port`: identifies the connected device.

use serde::Serialize;
use shared::link::messages::DeviceIdentity;
use shared::weights::slots::SlotState;

use super::super::common::warn_of_development_build;
use super::super::controller_args::image_id;
use super::super::output::OutputArgs;
use device::Device;
use device::port::Address;
use show::monitor::words;
use show::report::{Cell, Table};

/// The content of `--json`.
#[derive(Debug, Serialize)]
struct Found {
    port: String,
    identity: DeviceIdentity,
}

/// Identifies the device at an address.
pub fn run(address: &Address, output: &OutputArgs) -> anyhow::Result<()> {
    let identity = Device::connect(address)?.identify()?;
    warn_of_development_build(&identity);
    let port = address.to_string();
    output.table(&table(&port, &identity));
    output.finish(&Found { port, identity })
}

fn table(port: &str, identity: &DeviceIdentity) -> Table {
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
    table
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

    #[test]
    fn everything_that_the_greeting_holds_is_told() {
        insta::assert_snapshot!(table("/dev/ttyACM0", &identity()).to_plain());
    }

    #[test]
    fn a_device_without_weights_or_failure_says_so() {
        let slots = [SlotState::Empty, SlotState::Invalid(ImageProblem::Checksum)];
        let text =
            table("COM3", &DeviceIdentity { slots, running: None, failure: None, ..identity() }).to_plain();
        assert!(text.contains("empty") && text.contains("Checksum") && text.contains("no weights"), "{text}");
        assert!(!text.contains("failed before"), "{text}");
        let development = table("COM3", &DeviceIdentity { weights_key: None, ..identity() }).to_plain();
        assert!(development.contains("none: accepts unsigned weights"), "{development}");
    }
}
