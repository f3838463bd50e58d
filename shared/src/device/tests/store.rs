//! Storing weights on request: what is stored, and when not. Verifies: store-refused.

use super::*;
use crate::calibration::tests::SOUND;
use crate::device::prescription::{Interruption, Prescription, PrescriptionMemory};
use crate::device::server::{Answer, NextStep};

#[test]
fn an_uploaded_image_is_stored_and_named() {
    let (mut rig, image) = (Rig::new(None), image());
    upload(&mut rig, &image);
    assert_eq!(rig.ask(Request::CommitWeights), Response::Weights { id: image.1, slot: Slot::B });
    assert_eq!(rig.flash.images, [image.0]);
    let Response::Identity(identity) = rig.ask(Request::Identify) else { panic!("no greeting") };
    assert_eq!(identity.slots[1], SlotState::Valid { generation: 4, id: image.1 });
}

#[test]
fn a_failed_store_is_refused_and_the_greeting_shows_both_slots() {
    let (mut rig, image) = (Rig { flash: Flash::failing(), ..Rig::new(None) }, image());
    upload(&mut rig, &image);
    assert_eq!(rig.ask(Request::CommitWeights), Response::Refused(Refusal::Storage));
    let Response::Identity(identity) = rig.ask(Request::Identify) else { panic!("no greeting") };
    assert_eq!(identity.slots, [SlotState::Empty, SlotState::Torn]);
}

#[test]
fn nothing_is_stored_and_nothing_restarts_while_ventilating() {
    let (mut rig, image) = (Rig::new(None), image());
    upload(&mut rig, &image);
    rig.start();
    let refused = Response::Refused(Refusal::Ventilating);
    assert_eq!(rig.ask(Request::CommitWeights), refused);
    assert_eq!(rig.ask(Request::BeginWeights { length: IMAGE_BYTES as u32, id: 1 }), refused);
    assert_eq!(rig.ask(Request::Reset), refused);
    assert_eq!((rig.flash.images.len(), rig.restarts), (0, 0));
    rig.ask(Request::Stop);
    assert_eq!(rig.ask(Request::Reset), Response::Done);
    assert_eq!(rig.restarts, 1);
}

#[test]
fn nothing_is_stored_while_a_check_moves_the_valves() {
    let (mut rig, image) = (Rig::new(None), image());
    upload(&mut rig, &image);
    assert!(matches!(rig.ask(Request::RunSelfTest(Check::Circuit)), Response::SelfTest(_)));
    assert_eq!(rig.ask(Request::CommitWeights), Response::Refused(Refusal::SelfTestRuns));
    assert_eq!(rig.flash.images.len(), 0);
}

#[test]
fn a_bench_is_taken_over_in_standby_by_a_device_that_simulates_one() {
    let (mut rig, description) = (Rig::new(None), [1_u8, 2, 3]);
    let send = |rig: &mut Rig| {
        let begin = Request::BeginWeights { length: 3, id: crate::checksum::crc32(&description) };
        assert_eq!(rig.ask(begin), Response::Progress { offset: 0 });
        let bytes = description.into_iter().collect();
        assert_eq!(rig.ask(Request::WeightsChunk { offset: 0, bytes }), Response::Progress { offset: 3 });
    };
    send(&mut rig);
    assert_eq!(rig.ask(Request::CommitBench), Response::Refused(Refusal::NoBench));
    rig.flash.benches = Some(Vec::new());
    rig.start();
    assert_eq!(rig.ask(Request::CommitBench), Response::Refused(Refusal::Ventilating));
    rig.ask(Request::Stop);
    assert_eq!(rig.ask(Request::CommitBench), Response::Done);
    assert_eq!(rig.flash.benches, Some(std::vec![description.to_vec()]));
    assert_eq!(rig.ask(Request::CommitBench), Response::Done, "a host whose answer was lost asks again");
}

/// A request to a device whose control half may wait to resume.
fn ask_through(rig: &mut Rig, prescription: &mut Prescription, request: Request) -> Response {
    rig.sequence += 1;
    let message = ToDevice { sequence: rig.sequence, request, host: HOST };
    let mut step = rig.server.receive(&message, rig.ticks, &mut rig.flash);
    loop {
        step = match step {
            NextStep::Control(request, role) => {
                let reply = prescription.execute(&mut rig.control, &request, role);
                rig.server.control_replied(reply, &mut rig.flash)
            }
            NextStep::Answer(Answer { message: ToHost::Response { response, .. }, restart }) => {
                rig.restarts += usize::from(restart);
                return response;
            }
            NextStep::Answer(other) => panic!("no answer: {other:?}"),
        };
    }
}

/// With a low supply: an erase would run into the resumption, and a restart would end what nobody stopped.
#[test]
fn nothing_is_stored_and_nothing_restarts_while_ventilation_waits_to_resume() {
    let memory = PrescriptionMemory::new();
    let mut first = Prescription::attach(&memory, None, None);
    let mut ventilated = control(DeviceKind::Simulated, None);
    begin(&mut ventilated);
    for _ in 0..2 {
        let output = ventilated.step(5.0);
        first.keep(&ventilated, &output);
    }
    let (mut rig, image) = (Rig::new(None), image());
    upload(&mut rig, &image);
    let mut waiting = Prescription::attach(&memory, Some(Interruption::Supply), None);
    assert!(waiting.is_due());
    let stores = [
        Request::CommitWeights,
        Request::StoreCalibration(SOUND),
        Request::BeginWeights { length: IMAGE_BYTES as u32, id: 1 },
        Request::Reset,
    ];
    for request in stores.clone() {
        let refused = ask_through(&mut rig, &mut waiting, request.clone());
        assert_eq!(refused, Response::Refused(Refusal::Ventilating), "{request:?}");
    }
    assert_eq!((rig.flash.images.len(), rig.flash.calibrations.count(), rig.restarts), (0, 0, 0));
    assert!(waiting.is_due());
    assert_eq!(ask_through(&mut rig, &mut waiting, Request::Stop), Response::Mode(Mode::Standby));
    for request in stores {
        let answer = ask_through(&mut rig, &mut waiting, request.clone());
        assert!(!matches!(answer, Response::Refused(_)), "{request:?}: {answer:?}");
    }
    assert_eq!((rig.flash.images.len(), rig.flash.calibrations.count(), rig.restarts), (1, 1, 1));
}

#[test]
fn no_weights_are_stored_in_the_safe_state() {
    let (mut rig, image) = (Rig::new(None), image());
    upload(&mut rig, &image);
    rig.start();
    rig.run(20);
    rig.run_blocked(800, 70.0);
    assert_eq!(rig.ask(Request::CommitWeights), Response::Refused(Refusal::FaultLatched));
    rig.ask(Request::Acknowledge);
    assert_eq!(rig.ask(Request::CommitWeights), Response::Weights { id: image.1, slot: Slot::B });
}
