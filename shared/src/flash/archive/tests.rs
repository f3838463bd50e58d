use std::vec::Vec;

use proptest::prelude::*;

use super::*;

const SECTOR: usize = 8192;
const STARTS: [u32; 2] = [0, SECTOR as u32];
/// Not a multiple of a unit, and more than a step.
const WORDS: usize = STEP_UNITS * UNIT_WORDS + 3;

type Nor<const W: usize> = crate::flash::nor::Nor<W, SECTOR>;
type Archive = super::Archive<WORDS>;

/// The word of a source that is filled with a number.
fn filled(number: u32) -> impl Fn(usize) -> u32 {
    move |index| number.wrapping_mul(1000).wrapping_add(index as u32)
}

/// The number that the newest copy is filled with, after checking each of its words.
fn newest<const W: usize>(flash: &Nor<W>) -> Option<u32> {
    let mut flash = flash.powered();
    let archive = Archive::open(&mut flash, STARTS);
    let number = archive.word(&mut flash, 0)? / 1000;
    let source = filled(number);
    assert!((0..WORDS).all(|index| archive.word(&mut flash, index) == Some(source(index))), "{number}");
    assert_eq!(archive.word(&mut flash, WORDS), None, "no word behind the last");
    Some(number)
}

/// Makes a copy; whether it was completed.
fn copy<const W: usize>(flash: &mut Nor<W>, number: u32) -> Result<(), FlashError> {
    let mut archive = Archive::open(flash, STARTS);
    if !archive.is_erased() {
        archive.erase(flash)?;
    }
    archive.begin();
    while !archive.step(flash, filled(number))? {}
    assert!(!archive.is_running() && !archive.is_erased());
    Ok(())
}

fn copied<const W: usize>(numbers: &[u32]) -> Nor<W> {
    let mut flash = Nor::new();
    for number in numbers {
        copy(&mut flash, *number).unwrap();
    }
    flash
}

#[test]
fn an_erased_flash_holds_no_copy_and_counts_as_erased_only_with_the_mark() {
    let mut flash = Nor::<4>::new();
    let mut archive = Archive::open(&mut flash, STARTS);
    assert!(archive.word(&mut flash, 0).is_none() && !archive.is_erased());
    archive.erase(&mut flash).unwrap();
    assert!(archive.is_erased() && Archive::open(&mut flash, STARTS).is_erased());
    for place in [0, Archive::RECORD, Archive::COMMIT, Archive::MARK - 1, Archive::MARK] {
        let mut used = flash.clone();
        used.cells[place as usize] = 0;
        assert!(!Archive::open(&mut used, STARTS).is_erased(), "{place}");
    }
    let mut unreadable = Nor { unreadable: 0, ..flash };
    assert!(!Archive::open(&mut unreadable, STARTS).is_erased());
}

#[test]
fn a_slot_holds_the_words_their_record_the_commit_word_and_the_mark() {
    assert_eq!((Archive::UNITS, Archive::RECORD), (33, 33 * 32));
    assert_eq!((Archive::COMMIT, Archive::MARK, Archive::BYTES), (34 * 32, 35 * 32, 36 * 32));
    let flash = copied::<4>(&[5]);
    assert_eq!(flash.cells[..8], [136, 19, 0, 0, 137, 19, 0, 0], "5000 and 5001");
    assert_eq!(flash.cells[4 * WORDS..33 * 32], [ERASED; 20]);
    assert_eq!(flash.cells[Archive::BYTES as usize..SECTOR], [ERASED; SECTOR - 36 * 32]);
}

#[test]
fn copies_alternate_and_the_newest_counts() {
    let mut flash = Nor::<4>::new();
    for (number, place) in [(1, 0), (2, 1), (3, 0), (4, 1)] {
        copy(&mut flash, number).unwrap();
        assert_eq!(newest(&flash), Some(number));
        assert_eq!(Archive::open(&mut flash, STARTS).newest, Some((place, number - 1)));
    }
    assert_eq!(flash.erases, 4, "one erase per copy");
}

#[test]
fn a_copy_is_written_in_pieces_and_its_last_words_are_read_last() {
    let mut flash = Nor::<4>::new();
    let mut archive = Archive::open(&mut flash, STARTS);
    archive.begin();
    assert!(!archive.is_running(), "not erased");
    archive.erase(&mut flash).unwrap();
    archive.begin();
    assert!(archive.is_running() && archive.is_erased());
    let before = flash.written.iter().filter(|written| **written).count();
    assert_eq!(archive.step(&mut flash, filled(1)), Ok(false));
    let written = flash.written.iter().filter(|written| **written).count();
    assert_eq!(written - before, STEP_UNITS * UNIT);
    assert!(archive.is_running() && !archive.is_erased());
    // The source changes meanwhile.
    assert_eq!(archive.step(&mut flash, filled(2)), Ok(false));
    assert_eq!((newest(&flash), archive.step(&mut flash, filled(2))), (None, Ok(true)));
    let words = [WORDS - 4, WORDS - 3, WORDS - 1].map(|index| archive.word(&mut flash, index).unwrap());
    assert_eq!(words, [1255, 2256, 2258]);
    assert_eq!(archive.step(&mut flash, filled(3)), Ok(false), "nothing runs");
}

#[test]
fn an_abandoned_copy_leaves_the_newest_and_its_slot_is_erased_again() {
    let mut flash = copied::<4>(&[1]);
    let mut archive = Archive::open(&mut flash, STARTS);
    archive.erase(&mut flash).unwrap();
    archive.begin();
    archive.step(&mut flash, filled(2)).unwrap();
    archive.abandon();
    assert!(!archive.is_running() && !archive.is_erased());
    archive.begin();
    assert!(!archive.is_running());
    assert_eq!(newest(&flash), Some(1));
    copy(&mut flash, 3).unwrap();
    assert_eq!(newest(&flash), Some(3));
}

/// Cuts the supply after each byte that a copy erases or writes.
fn survives_every_cut<const W: usize>() {
    let before = copied::<W>(&[0, 1]);
    let mut finished = 0;
    for supply in 0.. {
        let mut flash = Nor { supply, ..before.clone() };
        let done = copy(&mut flash, 2).is_ok();
        match newest(&flash) {
            Some(1) => assert!(!done, "a finished copy counts"),
            Some(2) => finished += 1,
            other => panic!("after a cut at {supply}: {other:?}"),
        }
        if supply % 97 == 0 || done {
            // With any content that the cut has left, the next copy succeeds.
            let mut again = flash.powered();
            copy(&mut again, 3).unwrap();
            assert_eq!(newest(&again), Some(3));
        }
        if done {
            break;
        }
    }
    assert!(finished <= UNIT, "only the padding after the commit word may be missing");
}

#[test]
fn a_cut_at_any_byte_leaves_the_old_or_the_new_copy() {
    survives_every_cut::<1>();
    survives_every_cut::<4>();
    survives_every_cut::<32>();
}

#[test]
fn a_damaged_copy_is_refused_and_the_older_one_counts() {
    let flash = copied::<4>(&[1, 2]);
    for place in (0..4 * WORDS).chain([Archive::RECORD as usize, Archive::COMMIT as usize]) {
        let mut damaged = flash.clone();
        damaged.cells[SECTOR + place] ^= 0x10;
        assert_eq!(newest(&damaged), Some(1), "byte {place}");
    }
}

#[test]
fn flash_that_does_not_keep_what_was_written_ends_the_copy() {
    let mut flash = Nor::<1>::new();
    let mut archive = Archive::open(&mut flash, STARTS);
    archive.erase(&mut flash).unwrap();
    flash.cells[100] = 0;
    archive.begin();
    assert_eq!(archive.step(&mut flash, filled(1)), Err(FlashError::Readback));
    assert!(!archive.is_running() && !archive.is_erased());
    flash.supply = 0;
    assert_eq!(archive.erase(&mut flash), Err(FlashError::Operation));
    assert!(!archive.is_erased());
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    /// With copies and cuts in any order, the last committed copy is always the newest.
    #[test]
    fn after_any_copies_and_cuts_the_last_commit_counts(cuts in prop::collection::vec(0usize..10_000, 1..8)) {
        let (mut flash, mut committed) = (Nor::<4>::new(), Vec::new());
        for (number, supply) in (1..).zip(cuts) {
            let mut cut = Nor { supply, ..flash };
            if copy(&mut cut, number).is_ok() || newest(&cut) == Some(number) {
                committed.push(number);
            }
            flash = cut.powered();
            prop_assert_eq!(newest(&flash), committed.last().copied());
        }
    }
}
