//! Storing weights on request: what is stored, and when not.

use super::*;

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
