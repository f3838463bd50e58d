//! Whose weights a device stores. Verifies: weights-trust.

use super::*;
use crate::weights::PLANT_BYTES;
use crate::weights::trust::tests::{pair, signed, trust, unsigned};
use crate::weights::trust::{KeyId, seal};

/// The answer of a device that trusts the key of seed 1, and plant 1, to the commit of an image.
fn committed(image: &[u8; IMAGE_BYTES]) -> (Response, Rig) {
    let mut rig = Rig::trusting(None, Trust::Key { key: *pair(1).pk, plant: Some([1; PLANT_BYTES]) });
    let id = u32::from_le_bytes(*image.last_chunk().unwrap());
    upload(&mut rig, &(*image, id));
    (rig.ask(Request::CommitWeights), rig)
}

#[test]
fn signed_weights_are_stored_and_others_refused_with_the_reason() {
    let (stored, rig) = committed(&signed(1, 3, 1));
    assert!(matches!(stored, Response::Weights { slot: Slot::B, .. }), "{stored:?}");
    assert_eq!(rig.flash.images, [signed(1, 3, 1)]);
    let mut altered = signed(1, 3, 1);
    let mut signature = [0; 64];
    signature.copy_from_slice(&altered[IMAGE_BYTES - 68..IMAGE_BYTES - 4]);
    seal(&mut altered, 4, |_| signature);
    let refusals = std::vec![
        (unsigned(1), Refusal::Unsigned),
        (signed(1, 3, 2), Refusal::WrongSignature),
        (altered, Refusal::WrongSignature),
        (signed(2, 3, 1), Refusal::OtherPlant),
    ];
    for (image, refusal) in refusals {
        let (answer, rig) = committed(&image);
        assert_eq!(answer, Response::Refused(refusal));
        assert_eq!(rig.flash.images.len(), 0, "{refusal}");
    }
}

#[test]
fn weights_that_are_not_newer_are_refused_with_both_versions() {
    let refusal = Refusal::OldWeights { version: 3, stored: 5 };
    let mut rig = Rig::new(None);
    rig.flash.fails = Some(StoreError::NotNewer { version: 3, stored: 5 });
    upload(&mut rig, &image());
    assert_eq!(rig.ask(Request::CommitWeights), Response::Refused(refusal));
    assert!(std::format!("{refusal}").contains("version 3 are not newer than version 5"));
}

#[test]
fn no_signature_is_looked_at_while_ventilating() {
    let mut rig = Rig::trusting(None, trust(1));
    let image = unsigned(1);
    upload(&mut rig, &(image, u32::from_le_bytes(*image.last_chunk().unwrap())));
    rig.start();
    assert_eq!(rig.ask(Request::CommitWeights), Response::Refused(Refusal::Ventilating));
    rig.ask(Request::Stop);
    assert_eq!(rig.ask(Request::CommitWeights), Response::Refused(Refusal::Unsigned));
}

#[test]
fn the_greeting_names_the_key_or_a_development_build() {
    let key = |trust| match Rig::trusting(None, trust).ask(Request::Identify) {
        Response::Identity(identity) => identity.weights_key,
        other => panic!("{other:?}"),
    };
    assert_eq!(key(Trust::Development), None);
    assert_eq!(key(trust(1)), Some(KeyId(*pair(1).pk.first_chunk().unwrap())));
}
