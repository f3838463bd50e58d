//! Who may change a device, and what must be sent before it starts.

use super::*;
use crate::device::self_test::Check;
use crate::link::messages::LeaseStatus;

const OTHER: Option<u32> = Some(8);

/// A ventilating device that the first host steers.
fn steered() -> Rig {
    let mut rig = Rig::new(Some(&residual()));
    rig.start();
    rig.run(10);
    rig
}

fn lease(name: &str, take_over: bool) -> Request {
    Request::AcquireLease { name: HostName::new(name), take_over }
}

/// One request of every kind that changes something.
fn changes() -> Vec<Request> {
    std::vec![
        Request::ApplySettings(paper_settings(30.0)),
        Request::QueueSettings(paper_settings(30.0)),
        Request::Start,
        Request::Stop,
        Request::Acknowledge,
        Request::SetController(ControllerChoice::Pid(PidGains::default())),
        Request::SetExploration(Some(Exploration::default())),
        Request::Telemetry { on: false },
        Request::BeginWeights { length: IMAGE_BYTES as u32, id: 3 },
        Request::WeightsChunk { offset: 0, bytes: heapless::Vec::new() },
        Request::CommitWeights,
        Request::CommitBench,
        Request::Reset,
        Request::GetTiming { clear: true },
        Request::ResetPlant { seed: 1 },
        Request::PauseAudio { seconds: 30 },
        Request::RunSelfTest(Check::Zero),
        Request::ClearRecorder,
    ]
}

/// One request of every kind that only reads.
fn reads() -> Vec<Request> {
    std::vec![
        Request::Identify,
        Request::GetSettings,
        Request::GetAlarms,
        Request::GetAudio,
        Request::GetSelfTest,
        Request::Telemetry { on: true },
        Request::GetTiming { clear: false },
        Request::GetRecorder,
        Request::ReadRecorder { part: RecorderPart::Log, from: 0 },
        Request::GetLease,
    ]
}

/// Verifies: lease.
#[test]
fn another_host_reads_and_is_told_who_steers_and_changes_nothing() {
    let mut rig = steered();
    let before = std::format!("{:?}", rig.control);
    for request in changes() {
        let refused = rig.ask_by(OTHER, request.clone());
        assert_eq!(
            refused,
            Response::Refused(Refusal::Lease { holder: HostName::new("test") }),
            "{request:?}"
        );
        assert_eq!(rig.ask_by(None, request.clone()), refused, "without a token: {request:?}");
    }
    assert_eq!(std::format!("{:?}", rig.control), before, "nothing has changed");
    for request in reads() {
        assert!(!matches!(rig.ask_by(OTHER, request.clone()), Response::Refused(_)), "{request:?}");
        assert!(!matches!(rig.ask_by(None, request.clone()), Response::Refused(_)), "{request:?}");
    }
    let status = LeaseStatus { holder: Some(HostName::new("test")), yours: false };
    assert_eq!(rig.ask_by(OTHER, Request::GetLease), Response::Lease(status));
    assert_eq!(rig.ask_by(HOST, Request::GetLease), Response::Lease(LeaseStatus { yours: true, ..status }));
}

#[test]
fn without_a_lease_nothing_changes_but_the_telemetry() {
    let mut rig = Rig::new(None);
    for request in changes() {
        let answer = rig.ask_by(HOST, request.clone());
        let free = matches!(request, Request::Telemetry { .. });
        assert_eq!(answer == Response::Refused(Refusal::NoLease), !free, "{request:?}");
    }
}

#[test]
fn a_host_that_falls_silent_loses_the_lease_and_one_that_only_reads_keeps_it() {
    let mut rig = steered();
    for _ in 0..4 {
        rig.run(4000);
        rig.ask_by(HOST, Request::GetSettings);
    }
    assert!(matches!(rig.ask_by(OTHER, lease("other", false)), Response::Refused(Refusal::Lease { .. })));
    rig.run(5001);
    assert_eq!(rig.ask_by(HOST, Request::Stop), Response::Refused(Refusal::NoLease));
    assert!(matches!(rig.ask_by(OTHER, lease("other", false)), Response::Lease(status) if status.yours));
    assert_eq!(rig.control.mode(), Mode::Ventilating, "it ventilates on meanwhile");
}

#[test]
fn a_released_lease_is_free_at_once() {
    let mut rig = steered();
    let free = Response::Lease(LeaseStatus::default());
    assert_eq!(rig.ask_by(HOST, Request::ReleaseLease), free);
    assert!(matches!(rig.ask_by(OTHER, lease("other", false)), Response::Lease(status) if status.yours));
}

#[test]
fn at_the_bedside_an_operator_takes_over_stops_and_acknowledges() {
    let mut rig = steered();
    assert!(matches!(rig.ask_by(OTHER, lease("bedside", true)), Response::Lease(status) if status.yours));
    assert_eq!(rig.ask_by(OTHER, Request::Stop), Response::Mode(Mode::Standby));
    assert_eq!(rig.ask_by(OTHER, Request::Acknowledge), Response::Refused(Refusal::NoFault), "none is there");
    let refused = Response::Refused(Refusal::Lease { holder: HostName::new("bedside") });
    assert_eq!(rig.ask_by(HOST, Request::Start), refused);
}

#[test]
fn two_hosts_with_the_same_sequence_number_get_their_own_answers() {
    let mut rig = steered();
    assert!(matches!(rig.ask_as(9, HOST, Request::GetSettings), Response::Settings { .. }));
    assert!(matches!(rig.ask_as(9, OTHER, Request::GetAlarms), Response::Alarms(_)));
    assert!(matches!(rig.ask_as(9, None, Request::GetLease), Response::Lease(_)));
}

/// Verifies: chosen-settings.
#[test]
fn a_start_needs_settings_that_were_sent_in_this_standby() {
    let not_confirmed = Response::Refused(Refusal::NotConfirmed);
    let started = Response::Mode(Mode::Ventilating);
    let mut rig = Rig::new(None);
    assert_eq!(rig.ask(Request::Start), not_confirmed, "after power-on");
    assert!(matches!(rig.ask(Request::ApplySettings(paper_settings(f32::NAN))), Response::Refused(_)));
    assert_eq!(rig.ask(Request::Start), not_confirmed, "after refused settings");
    rig.ask(Request::ApplySettings(paper_settings(20.0)));
    assert_eq!(rig.ask(Request::Start), started);
    assert_eq!(rig.ask(Request::Start), started, "it ventilates already");
    rig.run(10);
    rig.ask(Request::Stop);
    assert_eq!(rig.ask(Request::Start), not_confirmed, "after a stop");
    rig.ask(Request::QueueSettings(paper_settings(20.0)));
    assert_eq!(rig.ask(Request::Start), started);
    rig.run_blocked(800, 70.0);
    rig.ask(Request::Acknowledge);
    // Until the sensor counts as sound again.
    rig.run(5100);
    assert_eq!(rig.ask(Request::Start), not_confirmed, "after a latched fault");
}

#[test]
fn a_resumed_ventilation_needs_no_settings() {
    let mut rig = Rig::new(None);
    rig.control.resume(&paper_settings(25.0)).unwrap();
    assert_eq!(rig.ask(Request::Start), Response::Mode(Mode::Ventilating));
    rig.run(1);
    assert_eq!(rig.control.prescription(), Some(paper_settings(25.0)));
}

#[test]
fn a_request_finds_the_mode_that_the_one_before_it_led_to() {
    let mut rig = Rig::new(None);
    rig.start();
    assert!(matches!(rig.ask(Request::Identify), Response::Identity(i) if i.mode == Mode::Ventilating));
}
