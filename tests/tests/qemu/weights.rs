//! Weights in the flash: stored, damaged, cut off.

use ed25519_compact::{KeyPair, Seed};
use shared::weights::trust::seal;
use shared::weights::{ImageProblem, PLANT_BYTES};

use super::*;

/// Places of both slots in the flash.
const SLOTS: [usize; 2] = [WEIGHTS as usize, (WEIGHTS + SECTOR_BYTES) as usize];

/// Description of a damage, and a function that applies it to a slot.
type Damage = (&'static str, fn(&mut [u8]));

#[test]
fn weights_are_stored_survive_a_reset_and_a_power_cut_and_alternate() {
    let folder = tempfile::tempdir().unwrap();
    let config = || EmulatorConfig { folder: Some(folder.path().to_owned()), ..config("hil") };
    let (board, mut device) = breathing(config(), &lung());
    assert_eq!(upload(&mut device, 1), (renamed(1).1, Slot::A));
    assert_eq!(running(&mut device), None, "they run after a reset");
    let identity = device.restart().unwrap();
    assert_eq!((identity.reset, identity.running), (ResetCause::Software, Some(Slot::A)));
    assert_eq!(identity.controller, ControllerChoice::Learned);
    assert_eq!(upload(&mut device, 2), (renamed(2).1, Slot::B));
    // A dropped board loses its power.
    drop((device, board));
    let (_board, mut device) = breathing(config(), &lung());
    assert_eq!(
        (running(&mut device), device.identify().unwrap().reset),
        (Some(renamed(2).1), ResetCause::PowerOn)
    );
}

/// Seed of the key pair that the image `signed` trusts.
pub const TRUSTED: u8 = 42;

/// The key pair of a seed.
fn pair(seed: u8) -> KeyPair {
    KeyPair::from_seed(Seed::new([seed; 32]))
}

/// The committed weights with a version, signed with the key of a seed.
pub fn signed(version: u32, seed: u8) -> [u8; IMAGE_BYTES] {
    sealed(renamed(1).0, version, seed)
}

fn sealed(mut image: [u8; IMAGE_BYTES], version: u32, seed: u8) -> [u8; IMAGE_BYTES] {
    seal(&mut image, version, |bytes| *pair(seed).sk.sign(bytes, None));
    image
}

/// The committed weights as those of another plant than the one that the image `signed` is built for.
fn of_another_plant() -> [u8; IMAGE_BYTES] {
    let image = decode(trace::LEARNED).unwrap();
    let mut bytes = [0; IMAGE_BYTES];
    encode(&image.residual, &Identity { plant: [1; PLANT_BYTES], ..image.identity }, &mut bytes).unwrap();
    bytes
}

/// Verifies: weights-trust.
#[test]
fn a_board_with_a_key_runs_only_signed_weights_that_are_newer() {
    let folder = tempfile::tempdir().unwrap();
    let on = |firmware| EmulatorConfig { folder: Some(folder.path().to_owned()), ..config(firmware) };
    let (board, mut device) = breathing(on("signed"), &lung());
    let key = device.identify().unwrap().weights_key.expect("a key");
    assert_eq!(key.0, pair(TRUSTED).pk[..8]);
    let mut send = |image: &[u8; IMAGE_BYTES]| {
        device.upload(image, &Progress::silent()).map(|uploaded| uploaded.slot).map_err(|e| e.to_string())
    };
    let unsigned = send(&renamed(1).0).unwrap_err();
    assert!(unsigned.contains("runs only signed weights"), "{unsigned}");
    let foreign = send(&signed(5, 7)).unwrap_err();
    assert!(foreign.contains("signature of the weights does not match"), "{foreign}");
    let other = send(&sealed(of_another_plant(), 5, TRUSTED)).unwrap_err();
    assert!(other.contains("signed for another plant"), "{other}");
    assert_eq!(send(&signed(5, TRUSTED)), Ok(Slot::A));
    let old = send(&signed(5, TRUSTED)).unwrap_err();
    assert!(old.contains("version 5 are not newer than version 5"), "{old}");
    assert_eq!(send(&signed(6, TRUSTED)), Ok(Slot::B));
    let identity = device.restart().unwrap();
    assert_eq!((identity.running, identity.controller), (Some(Slot::B), ControllerChoice::Learned));
    drop((device, board));
    // A development build stores anything; the same flash under the other firmware runs only what it trusts.
    let (board, mut device) = breathing(on("hil"), &lung());
    assert_eq!(device.identify().unwrap().weights_key, None);
    upload(&mut device, 1);
    drop((device, board));
    let (_board, mut device) = breathing(on("signed"), &lung());
    let identity = device.identify().unwrap();
    assert_eq!(identity.running, Some(Slot::B));
    assert!(identity.slots.contains(&SlotState::Invalid(ImageProblem::Unsigned)), "{:?}", identity.slots);
}

#[test]
fn torn_and_damaged_images_are_refused_and_the_older_weights_run() {
    let (board, mut device) = breathing(config("hil"), &lung());
    upload(&mut device, 1);
    device.restart().unwrap();
    upload(&mut device, 2);
    let good = board.flash().unwrap();
    drop((device, board));
    let damages: [Damage; 4] = [
        ("a flipped bit of a weight", |slot| slot[1000] ^= 1),
        ("a torn write", |slot| slot[3000..IMAGE_BYTES].fill(0xFF)),
        ("no commit word", |slot| slot[IMAGE_BYTES.next_multiple_of(32) + 32..][..4].fill(0xFF)),
        ("an erased sector", |slot| slot.fill(0xFF)),
    ];
    for (name, damage) in damages {
        let mut flash = good.clone();
        damage(&mut flash[SLOTS[1]..]);
        let (_board, mut device) = breathing(EmulatorConfig { flash: Some(flash), ..config("hil") }, &lung());
        assert_eq!(running(&mut device), Some(renamed(1).1), "{name}");
    }
    let mut flash = good;
    for slot in SLOTS {
        flash[slot + 1000] ^= 1;
    }
    let (_board, mut device) = breathing(EmulatorConfig { flash: Some(flash), ..config("hil") }, &lung());
    let identity = device.identify().unwrap();
    assert_eq!((identity.running, identity.controller), (None, ControllerChoice::Pid(KNOWN_GOOD)));
    assert!(identity.slots.iter().all(|slot| matches!(slot, SlotState::Invalid(_))), "{:?}", identity.slots);
}

/// Verifies: weights-commit.
#[test]
fn a_cut_in_the_middle_of_a_store_leaves_the_old_or_the_new_weights() {
    let folder = tempfile::tempdir().unwrap();
    let config =
        || EmulatorConfig { folder: Some(folder.path().to_owned()), debugger: true, ..config("hil") };
    let (board, mut device) = breathing(config(), &lung());
    upload(&mut device, 1);
    // The sector erase, then the words in order; the first word of the last unit is the commit word.
    let operations = debugger(&board).record().unwrap().flash_operations;
    let commit = operations + 1 - UNIT as u32 / 4;
    assert!(commit as usize > IMAGE_BYTES / 4, "{commit}");
    drop((device, board));
    let old = renamed(1).1;
    for (training, cut) in (2..).zip([1, 2, commit / 2, commit - 1, commit, operations]) {
        let (mut board, mut device) = breathing(config(), &lung());
        debugger(&board).cut_power_at(cut).unwrap();
        let (image, new) = renamed(training);
        assert!(device.upload(&image, &Progress::silent()).is_err(), "the line closes when the power is cut");
        board.wait().unwrap();
        assert!(board.log().ends_with("power cut"), "{}", board.log());
        drop((device, board));
        let (_board, mut device) = breathing(config(), &lung());
        let expected = if cut < commit { old } else { new };
        assert_eq!(running(&mut device), Some(expected), "after a cut at {cut} of {operations}");
    }
}
