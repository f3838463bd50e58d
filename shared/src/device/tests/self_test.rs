//! The self-test of a device: what it prevents, and what it may do to the valves and readings.

use super::*;
use crate::device::self_test::{BootFindings, Check, Finding, Outcome, Report, Step};
use crate::recorder::keeper::Leave;
use crate::safety::filter::ValveCommand;

/// A device after a start of the chip that has found nothing wrong.
fn booted() -> Rig {
    let mut rig = Rig::new(None);
    let boot = BootFindings { program: Some(true), memory: Some(true), slots: [SlotState::Empty; 2] };
    rig.control.require_self_test(&boot);
    rig
}

fn report(rig: &mut Rig) -> Report {
    match rig.ask(Request::GetSelfTest) {
        Response::SelfTest(report) => report,
        other => panic!("{other:?}"),
    }
}

#[test]
fn ventilation_starts_after_the_self_test_of_half_a_second_in_standby() {
    let mut rig = booted();
    rig.ask(Request::ApplySettings(Settings::default()));
    rig.run(499);
    assert_eq!(rig.ask(Request::Start), Response::Refused(Refusal::SelfTestRuns));
    rig.run(1);
    assert_eq!(rig.ask(Request::Start), Response::Mode(Mode::Ventilating));
}

#[test]
fn a_check_moves_the_valves_in_standby_until_an_alarm_ends_it() {
    let mut rig = Rig::new(None);
    rig.control = Control::new(DeviceKind::Simulated, DEFAULT_PERIOD_US, CORE_HZ).unwrap();
    assert!(matches!(rig.ask(Request::RunSelfTest(Check::Circuit)), Response::SelfTest(_)));
    rig.run(300);
    let fills = rig.control.step(5.0).command;
    assert!(!fills.u_out() && fills.u_in() > 0.0, "{fills:?}");
    rig.control.report_boot(ResetCause::Watchdog, false, &[SlotState::Empty; 2]);
    assert_eq!(rig.control.step(5.0).command, ValveCommand::SAFE);
    assert_eq!(report(&mut rig)[Step::Valves as usize].outcome, Outcome::Failed(Finding::Alarm));
}

#[test]
fn a_measured_zero_is_taken_from_the_recorded_readings() {
    let mut rig = Rig::new(None);
    rig.ask(Request::RunSelfTest(Check::Zero));
    rig.run_at(500, 1.0);
    assert_eq!(report(&mut rig)[Step::Zero as usize].outcome, Outcome::Passed);
    let output = rig.control.step(11.0);
    assert!((rig.control.moment(11.0, &output, 0).reading - 10.0).abs() < 1e-3);
}

#[test]
fn the_flash_is_left_alone_while_it_ventilates_and_while_a_check_moves_the_valves() {
    let mut rig = booted();
    rig.run(100);
    assert_eq!(rig.control.leave(), Leave::Erase, "the sensors' step only reads");
    rig.run(400);
    rig.ask(Request::ApplySettings(Settings::default()));
    rig.ask(Request::Start);
    assert_eq!(rig.control.leave(), Leave::Nothing, "from the answer to the request on");
    rig.run(100);
    assert_eq!(rig.control.leave(), Leave::Nothing);
    rig.run_blocked(800, 70.0);
    assert!(matches!(rig.control.mode(), Mode::Fault(_)));
    assert_eq!(rig.control.leave(), Leave::Write);
    rig.run(500);
    rig.ask(Request::Acknowledge);
    rig.run(1);
    assert_eq!(rig.control.leave(), Leave::Erase);
    for (check, leave) in [(Check::Zero, Leave::Erase), (Check::Circuit, Leave::Nothing)] {
        rig.ask(Request::RunSelfTest(check));
        assert_eq!(rig.control.leave(), leave, "{check:?}");
        rig.run(600);
    }
}
