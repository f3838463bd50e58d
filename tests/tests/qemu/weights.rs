//! Weights in the flash: stored, damaged, cut off.

use super::*;

/// Length of a weights slot, bytes.
const SLOT: usize = 128 * 1024;

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
        damage(&mut flash[SLOT..]);
        let (_board, mut device) = breathing(EmulatorConfig { flash: Some(flash), ..config("hil") }, &lung());
        assert_eq!(running(&mut device), Some(renamed(1).1), "{name}");
    }
    let mut flash = good;
    flash[1000] ^= 1;
    flash[SLOT + 1000] ^= 1;
    let (_board, mut device) = breathing(EmulatorConfig { flash: Some(flash), ..config("hil") }, &lung());
    let identity = device.identify().unwrap();
    assert_eq!((identity.running, identity.controller), (None, ControllerChoice::Pid(KNOWN_GOOD)));
    assert!(identity.slots.iter().all(|slot| matches!(slot, SlotState::Invalid(_))), "{:?}", identity.slots);
}

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
