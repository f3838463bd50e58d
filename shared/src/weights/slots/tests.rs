//! Verifies: weights-commit.

use std::vec::Vec;

use proptest::prelude::*;

use super::*;
use crate::checksum::crc32;
use crate::control::features::FeatureSpec;
use crate::control::network::Network;
use crate::control::pid::PidGains;
use crate::control::residual::{Residual, ResidualSpec};
use crate::weights::trust::tests::{signed, trust, unsigned};
use crate::weights::{Identity, encode};

const SECTOR: usize = 8192;
const STARTS: [u32; 2] = [0, SECTOR as u32];

type Nor<const W: usize> = flash::nor::Nor<W, SECTOR>;

fn image(gain: f32) -> [u8; IMAGE_BYTES] {
    let spec = ResidualSpec {
        period_us: 1000,
        gains: PidGains { p: gain, i: 1.0, d: 0.0 },
        lambda: 1.0,
        authority: 50.0,
        features: FeatureSpec::default(),
    };
    let mut bytes = [0; IMAGE_BYTES];
    encode(&Residual::new(spec, Network::zero()).unwrap(), &Identity::default(), &mut bytes).unwrap();
    bytes
}

/// An image with the right checksum but a wrong golden value.
fn forged(gain: f32) -> [u8; IMAGE_BYTES] {
    let mut forged = image(gain);
    forged[115] ^= 1;
    let checksum = crc32(&forged[..IMAGE_BYTES - 4]);
    forged[IMAGE_BYTES - 4..].copy_from_slice(&checksum.to_le_bytes());
    forged
}

/// Stores an image in slots that trust a key.
fn trusted(flash: &mut Nor<4>, image: &[u8; IMAGE_BYTES]) -> Result<Slot, StoreError> {
    let mut slots = Slots::new(flash.clone(), STARTS).trusting(trust(1));
    let slot = slots.store(image).map(|(slot, _)| slot);
    *flash = slots.flash;
    slot
}

#[test]
fn a_device_with_a_key_stores_only_newer_images() {
    let mut flash = Nor::new();
    assert_eq!(trusted(&mut flash, &signed(1, 5, 1)), Ok(Slot::A));
    for version in [0, 4, 5] {
        let before = flash.cells.clone();
        let refused = Err(StoreError::NotNewer { version, stored: 5 });
        assert_eq!(trusted(&mut flash, &signed(1, version, 1)), refused);
        assert_eq!(flash.cells, before, "nothing is erased");
    }
    let refused = Err(StoreError::NotNewer { version: 1, stored: 5 });
    assert_eq!(trusted(&mut flash, &signed(2, 1, 1)), refused, "another plant");
    assert_eq!(trusted(&mut flash, &signed(1, 6, 1)), Ok(Slot::B));
    assert_eq!(trusted(&mut flash, &signed(1, 6, 1)), Err(StoreError::NotNewer { version: 6, stored: 6 }));
    assert_eq!(trusted(&mut flash, &signed(1, 7, 1)), Ok(Slot::A));
}

#[test]
fn a_programmer_writes_what_the_first_store_leaves() {
    let mut slots = Slots::new(Nor::<4>::new(), STARTS);
    slots.store(&image(2.0)).unwrap();
    for (start, content) in STARTS.into_iter().zip(after_first_store(&image(2.0))) {
        let stored = &slots.flash.cells[start as usize..][..SLOT_BYTES as usize];
        assert_eq!(stored, content.as_slice());
    }
}

#[test]
fn an_image_whose_store_was_cut_off_is_stored_again() {
    let mut flash = Nor::<4>::new();
    assert_eq!(trusted(&mut flash, &signed(1, 5, 1)), Ok(Slot::A));
    flash.supply = SECTOR + COMMIT as usize;
    assert_eq!(
        trusted(&mut flash, &signed(1, 6, 1)),
        Err(StoreError::Flash(FlashError::Operation)),
        "before the commit word"
    );
    flash.supply = usize::MAX;
    assert_eq!(trusted(&mut flash, &signed(1, 6, 1)), Ok(Slot::B));
}

#[test]
fn an_image_that_is_not_trusted_does_not_run_and_holds_no_version() {
    let mut flash = Nor::<4>::new();
    let mut development = Slots::new(flash.clone(), STARTS);
    for image in [signed(1, 9, 2), unsigned(1)] {
        development.store(&image).unwrap();
    }
    assert_eq!(
        development.load(Image::clone).map(|(slot, _)| slot),
        Some(Slot::B),
        "a development build runs it"
    );
    flash = development.flash;
    let mut slots = Slots::new(flash.clone(), STARTS).trusting(trust(1));
    assert_eq!(slots.load(Image::clone).map(|(slot, _)| slot), None);
    let invalid = [ImageProblem::Signature, ImageProblem::Unsigned].map(SlotState::Invalid);
    assert_eq!(slots.states(), invalid);
    assert!(trusted(&mut flash, &signed(1, 1, 1)).is_ok());
    let mut slots = Slots::new(flash, STARTS).trusting(trust(1));
    assert_eq!(slots.load(Image::clone).map(|(_, image)| image.version), Some(1));
}

fn id(image: &[u8; IMAGE_BYTES]) -> u32 {
    identity(image).unwrap()
}

/// The slot and image id that are loaded at a start.
fn boot<const W: usize>(flash: &Nor<W>) -> Option<(Slot, u32)> {
    Slots::new(flash.powered(), STARTS).load(Image::clone).map(|(slot, image)| (slot, image.id))
}

/// Like [`boot`], but by the checksums alone: fast enough to call after every byte.
fn newest<const W: usize>(flash: &Nor<W>) -> Option<(Slot, u32)> {
    let mut slots = Slots::new(flash.powered(), STARTS);
    let states = slots.states();
    by_age(&states).first().map(|&slot| match states[slot as usize] {
        SlotState::Valid { id, .. } => (slot, id),
        other => panic!("{other:?} counts as valid"),
    })
}

fn stored<const W: usize>(flash: Nor<W>, image: &[u8; IMAGE_BYTES]) -> Nor<W> {
    let mut slots = Slots::new(flash, STARTS);
    slots.store(image).unwrap();
    slots.flash
}

#[test]
fn an_erased_flash_holds_nothing() {
    let mut slots = Slots::new(Nor::<4>::new(), STARTS);
    assert_eq!((slots.load(Image::clone), slots.states()), (None, [SlotState::Empty; 2]));
}

#[test]
fn a_slot_holds_an_image_a_record_and_a_commit_word() {
    assert_eq!(SLOT_BYTES as usize, IMAGE_BYTES.next_multiple_of(UNIT) + 2 * UNIT);
}

#[test]
fn stores_alternate_and_the_newest_runs() {
    let mut flash = Nor::<4>::new();
    for (number, slot) in [(0u8, Slot::A), (1, Slot::B), (2, Slot::A), (3, Slot::B)] {
        let image = image(f32::from(number));
        flash = stored(flash, &image);
        assert_eq!(boot(&flash), Some((slot, id(&image))));
    }
}

#[test]
fn generations_wrap() {
    let valid = |generation| SlotState::Valid { generation, id: 0 };
    assert_eq!(by_age(&[valid(u32::MAX), valid(0)])[0], Slot::B);
    assert_eq!(by_age(&[valid(0), valid(u32::MAX)])[0], Slot::A);
    assert_eq!(by_age(&[SlotState::Torn, valid(3)])[..], [Slot::B]);
}

/// Cuts the supply after each byte that a store erases or writes.
fn survives_every_cut<const W: usize>() {
    let (old, new) = (image(1.0), image(2.0));
    let before = stored(stored(Nor::<W>::new(), &image(0.0)), &old);
    assert_eq!(boot(&before), Some((Slot::B, id(&old))));
    let mut finished = 0;
    for supply in 0.. {
        let mut slots = Slots::new(Nor { supply, ..before.clone() }, STARTS);
        let done = slots.store(&new).is_ok();
        match newest(&slots.flash) {
            Some((Slot::B, running)) if running == id(&old) => assert!(!done, "a finished store runs"),
            Some((Slot::A, running)) if running == id(&new) => finished += 1,
            other => panic!("after a cut at {supply} runs {other:?}"),
        }
        // With any content that the cut has left, the next store succeeds.
        if supply % 97 == 0 || done {
            assert_eq!(boot(&slots.flash), newest(&slots.flash));
            let again = stored(Nor { supply: usize::MAX, ..slots.flash }, &image(3.0));
            assert_eq!(boot(&again).unwrap().1, id(&image(3.0)));
        }
        if done {
            break;
        }
    }
    assert!(finished <= UNIT, "only the padding after the commit word may be missing");
}

#[test]
fn a_cut_at_any_byte_leaves_the_old_or_the_new_weights() {
    survives_every_cut::<1>();
    survives_every_cut::<4>();
    survives_every_cut::<8>();
    survives_every_cut::<32>();
}

#[test]
fn a_damaged_image_is_refused_and_the_older_one_runs() {
    let (old, new) = (image(1.0), image(2.0));
    let flash = stored(stored(Nor::<4>::new(), &old), &new);
    for place in (0..IMAGE_BYTES).step_by(7).chain([RECORD as usize, COMMIT as usize]) {
        let mut damaged = flash.clone();
        damaged.cells[SECTOR + place] ^= 0x10;
        assert_eq!(boot(&damaged), Some((Slot::A, id(&old))), "byte {place}");
    }
}

#[test]
fn a_sound_image_that_the_decoder_refuses_falls_back_and_is_the_one_overwritten() {
    let (old, forged) = (image(1.0), forged(2.0));
    let mut slots = Slots::new(stored(stored(Nor::<4>::new(), &old), &forged), STARTS);
    assert_eq!(slots.load(Image::clone).unwrap().0, Slot::A);
    assert_eq!(slots.states()[1], SlotState::Invalid(ImageProblem::Golden));
    let new = image(3.0);
    assert_eq!(slots.store(&new).unwrap().0, Slot::B, "the slot that runs stays");
    // The refusal was that of the image before.
    assert_eq!(slots.states()[1], SlotState::Valid { generation: 1, id: id(&new) });
    assert_eq!(slots.load(|image| image.id), Some((Slot::B, id(&new))));
}

#[test]
fn an_unreadable_slot_is_not_overwritten() {
    let (old, new) = (image(1.0), image(2.0));
    let before = stored(stored(Nor::<4>::new(), &old), &new);
    let mut slots = Slots::new(Nor { unreadable: SECTOR, ..before.clone() }, STARTS);
    assert_eq!(slots.states()[1], SlotState::Torn);
    assert_eq!(slots.store(&image(3.0)), Err(StoreError::Flash(FlashError::Operation)));
    assert_eq!(slots.flash.cells, before.cells);
}

#[test]
fn a_refused_image_stays_refused_when_its_erase_fails() {
    let (old, forged) = (image(1.0), forged(2.0));
    let mut slots = Slots::new(stored(stored(Nor::<4>::new(), &old), &forged), STARTS);
    slots.load(Image::clone).unwrap();
    let sound = slots.flash.cells.clone();
    slots.flash.supply = 0;
    assert_eq!(slots.store(&image(3.0)), Err(StoreError::Flash(FlashError::Operation)));
    // The erase had no effect at all.
    (slots.flash.cells, slots.flash.supply) = (sound, usize::MAX);
    assert_eq!(slots.states()[1], SlotState::Invalid(ImageProblem::Golden));
    assert_eq!(slots.store(&image(4.0)).unwrap().0, Slot::B, "the slot that runs stays");
}

#[test]
fn an_image_without_its_commit_word_is_torn() {
    let mut flash = stored(Nor::<4>::new(), &image(1.0));
    flash.cells[COMMIT as usize..][..4].fill(ERASED);
    assert_eq!(Slots::new(flash, STARTS).states()[0], SlotState::Torn);
}

#[test]
fn flash_that_does_not_keep_what_was_written_is_noticed() {
    let mut flash = Nor::<1>::new();
    flash.cells[100] = 0; // stuck bits: no erase in this test restores them
    let mut slots = Slots::new(flash, STARTS);
    assert_eq!(slots.write(96, &[0xAA; 8]), Err(FlashError::Readback));
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(32))]

    /// With stores and cuts in any order, the last committed image is always the one that runs.
    #[test]
    fn after_any_stores_and_cuts_the_last_commit_runs(events in prop::collection::vec((0u8..50, 0usize..15_000), 1..8)) {
        let mut flash = Nor::<4>::new();
        let mut committed: Vec<u32> = Vec::new();
        for (number, supply) in events {
            let image = image(f32::from(number));
            let mut slots = Slots::new(Nor { supply, ..flash }, STARTS);
            slots.load(Image::clone);
            if slots.store(&image).is_ok() || boot(&slots.flash).map(|b| b.1) == Some(id(&image)) {
                committed.push(id(&image));
            }
            flash = slots.flash;
            prop_assert_eq!(boot(&flash).map(|(_, id)| id), committed.last().copied());
        }
    }
}
