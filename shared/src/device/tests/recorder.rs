//! The flight recorder: what it is told, and how it is read.

use super::*;
use crate::recorder::{RecorderStatus, RecordingState};

#[test]
fn the_flight_recorder_is_told_whose_command_it_was() {
    for learned in [Some(residual()), None] {
        let mut control = control(DeviceKind::Simulated, learned.as_ref());
        let output = control.step(5.0);
        assert_eq!(control.moment(5.0, &output, 0).learned, learned.is_some());
    }
}

fn recorded(rig: &mut Rig) -> RecorderStatus {
    match rig.ask(Request::GetRecorder) {
        Response::Recorder(status) => status,
        other => panic!("{other:?}"),
    }
}

#[test]
fn the_flight_recorder_is_read_while_ventilating_and_emptied_on_request() {
    let mut rig = Rig::new(None);
    rig.start();
    rig.run(100);
    let status = recorded(&mut rig);
    assert_eq!((status.recording, status.fast.next - status.fast.first), (RecordingState::Running, 101));
    let page = rig.ask(Request::ReadRecorder { part: RecorderPart::Fast, from: status.fast.next - 2 });
    assert!(matches!(page, Response::Recorded(page) if page.first == 99 && page.bytes.len() == 12));
    rig.run_blocked(800, 70.0);
    assert_eq!(recorded(&mut rig).recording, RecordingState::Fault(Fault::HardLimit));
    assert_eq!(rig.ask(Request::ClearRecorder), Response::Done);
    rig.run(1);
    assert_eq!(recorded(&mut rig).recording, RecordingState::Nothing);
}
