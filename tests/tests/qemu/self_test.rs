//! The self-test of the image.

use shared::device::self_test::{Check, Finding, Outcome, Step};

use super::*;

fn outcomes(device: &mut Device) -> Vec<Outcome> {
    device.self_test().unwrap().iter().map(|result| result.outcome).collect()
}

/// Waits until the sensors have been judged.
fn tested(device: &mut Device) -> Vec<Outcome> {
    let deadline = Instant::now() + DEADLINE;
    loop {
        let outcomes = outcomes(device);
        if outcomes[Step::Sensors as usize] != Outcome::Runs {
            return outcomes;
        }
        assert!(Instant::now() < deadline, "{outcomes:?}");
    }
}

/// Verifies: self-test.
#[test]
fn a_sound_board_passes_and_damage_to_its_program_prevents_ventilation() {
    use Outcome::{Failed, NotRun, Passed};

    let (board, mut device) = breathing(EmulatorConfig { debugger: true, ..config("hil") }, &lung());
    let sound = [Passed, Passed, Passed, Passed, NotRun, NotRun, NotRun, NotRun];
    assert_eq!(tested(&mut device), sound);
    // In the vector table, the entry of an interrupt that never occurs.
    let place = 0x0800_0000 + 4 * (16 + 79);
    let mut debugger = debugger(&board);
    let byte = debugger.read(place, 1).unwrap()[0];
    debugger.write(place, &[byte ^ 1]).unwrap();
    debugger.detach().unwrap();
    device.restart().unwrap();
    assert_eq!(tested(&mut device)[Step::Program as usize], Failed(Finding::Program));
    let refused = device.start().unwrap_err().to_string();
    assert!(refused.contains("the self-test step 'program' has failed"), "{refused}");
    assert_eq!(device.identify().unwrap().mode, Mode::Standby);
}

#[test]
fn the_checks_on_request_run_on_the_board() {
    let (_board, mut device) = breathing(config("hil"), &lung());
    tested(&mut device);
    let report = device.run_check(Check::Circuit).unwrap();
    let [valves, circuit] = [Step::Valves, Step::Circuit].map(|step| report[step as usize]);
    // The plant line has no flow sensor.
    assert!(valves.outcome == Outcome::Passed && circuit.outcome == Outcome::Passed, "{report:?}");
    let zero = device.run_check(Check::Zero).unwrap()[Step::Zero as usize];
    assert_eq!(zero.outcome, Outcome::Failed(Finding::ZeroTooFar), "PEEP is not the pressure of the air");
    assert!(device.start().unwrap_err().to_string().contains("self-test step 'zero' has failed"));
}
