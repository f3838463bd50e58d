use std::vec::Vec;

use proptest::prelude::*;

use super::*;
use crate::flash::nor;

/// Room for the mark and three records.
const SECTOR: usize = 4 * RECORD_BYTES;
const PAYLOAD: usize = 40;

type Nor<const W: usize> = nor::Nor<W, SECTOR>;
type Record = [u8; PAYLOAD];

fn open<const W: usize>(flash: &mut Nor<W>) -> Journal<PAYLOAD> {
    Journal::open(flash, SECTOR as u32, SECTOR as u32)
}

/// The first bytes of all records after a start, the newest first.
fn boot<const W: usize>(flash: &Nor<W>) -> Vec<u8> {
    let mut flash = flash.powered();
    let journal = open(&mut flash);
    let records: Vec<u8> =
        (0..).map_while(|back| journal.get(&mut flash, back)).map(|bytes| bytes[0]).collect();
    assert_eq!(usize::from(journal.count()), records.len());
    records
}

/// Stores records of these values, each after a start of its own.
fn stored<const W: usize>(mut flash: Nor<W>, values: &[u8]) -> Nor<W> {
    for value in values {
        open(&mut flash).store(&mut flash, &[*value; PAYLOAD]).unwrap();
    }
    flash
}

#[test]
fn a_new_flash_holds_nothing_and_the_first_store_erases_it() {
    let mut flash = Nor::<4>::new();
    let mut journal = open(&mut flash);
    assert_eq!((journal.count(), journal.get(&mut flash, 0), journal.erases_next()), (0, None, true));
    journal.store(&mut flash, &[1; PAYLOAD]).unwrap();
    assert_eq!((boot(&flash), flash.erases, journal.erases_next()), (std::vec![1], 1, false));
}

#[test]
fn records_are_kept_and_read_back_to_the_oldest() {
    let mut flash = stored(Nor::<4>::new(), &[1, 2, 3]);
    assert_eq!((boot(&flash), flash.erases), (std::vec![3, 2, 1], 1));
    let journal = open(&mut flash);
    assert_eq!(journal.get(&mut flash, 2), Some([1; PAYLOAD]));
    assert_eq!(journal.get(&mut flash, 3), None);
    assert_eq!(flash.cells[..SECTOR], [ERASED; SECTOR], "the sector beside it stays");
}

#[test]
fn a_full_journal_is_erased_by_the_next_store_which_loses_the_history() {
    let mut flash = stored(Nor::<4>::new(), &[1, 2, 3]);
    assert!(open(&mut flash).erases_next());
    let flash = stored(flash, &[4, 5]);
    assert_eq!((boot(&flash), flash.erases), (std::vec![5, 4], 2));
}

#[test]
fn stores_without_a_restart_are_those_of_a_restart_each() {
    let mut flash = Nor::<4>::new();
    let mut journal = open(&mut flash);
    for value in [1, 2, 3, 4, 5] {
        journal.store(&mut flash, &[value; PAYLOAD]).unwrap();
        let newest = journal.get(&mut flash, 0);
        assert_eq!((newest, usize::from(journal.count())), (Some([value; PAYLOAD]), boot(&flash).len()));
    }
    assert_eq!(flash.cells, stored(Nor::<4>::new(), &[1, 2, 3, 4, 5]).cells);
}

#[test]
fn a_damaged_record_does_not_count() {
    let flash = stored(Nor::<4>::new(), &[1, 2, 3]);
    let record = SECTOR + 2 * RECORD_BYTES;
    for bit in 0..8 * Journal::<PAYLOAD>::CONTENT {
        let mut damaged = flash.clone();
        damaged.cells[record + bit / 8] ^= 1 << (bit % 8);
        assert_eq!(boot(&damaged), [3, 1], "bit {bit}");
    }
}

#[test]
fn a_sector_whose_erase_was_cut_off_is_erased_again() {
    // It reads as erased, but has no mark.
    let flash = stored(Nor::<4>::new(), &[1]);
    assert_eq!((boot(&flash), flash.erases), (std::vec![1], 1));
    let mut flash = flash;
    flash.cells[SECTOR..].fill(ERASED);
    let flash = stored(flash, &[2]);
    assert_eq!((boot(&flash), flash.erases), (std::vec![2], 2));
}

#[test]
fn flash_that_does_not_keep_what_was_written_is_noticed() {
    let mut flash = stored(Nor::<1>::new(), &[1]);
    let mut journal = open(&mut flash);
    flash.cells[SECTOR + 2 * RECORD_BYTES + SEQUENCE_BYTES] = 0;
    assert_eq!(journal.store(&mut flash, &[2; PAYLOAD]), Err(FlashError::Readback));
    assert_eq!((boot(&flash), journal.count()), (std::vec![1], 1));
    journal.store(&mut flash, &[3; PAYLOAD]).unwrap();
    assert_eq!(boot(&flash), [3, 1], "the next place works");
}

/// Cuts the supply after each byte that a store onto `values` erases or writes.
fn survives_every_cut<const W: usize>(values: &[u8]) {
    let before = stored(Nor::<W>::new(), values);
    let old = boot(&before);
    let erases = open(&mut before.clone()).erases_next();
    let new: Vec<u8> = [9].into_iter().chain(if erases { Vec::new() } else { old.clone() }).collect();
    for supply in 0.. {
        let mut flash = Nor { supply, ..before.clone() };
        let done = open(&mut flash).store(&mut flash, &[9; PAYLOAD]).is_ok();
        let after = boot(&flash);
        let nothing = erases && after.is_empty();
        // An erase that is cut off right away may have changed nothing that counts.
        let part = erases && old.ends_with(&after);
        assert!(
            after == new || (!done && (after == old || nothing || part)),
            "{after:?} after a cut at {supply}"
        );
        let again = boot(&stored(flash.powered(), &[7]));
        assert_eq!(again.first(), Some(&7), "the next store succeeds after a cut at {supply}");
        if done {
            return;
        }
    }
}

#[test]
fn a_cut_at_any_byte_leaves_the_old_or_the_new_record() {
    for values in [&[1][..], &[1, 2]] {
        survives_every_cut::<1>(values);
        survives_every_cut::<4>(values);
        survives_every_cut::<32>(values);
    }
}

#[test]
fn a_cut_at_any_byte_of_a_store_that_erases_leaves_nothing_wrong() {
    for values in [&[][..], &[1, 2, 3]] {
        survives_every_cut::<1>(values);
        survives_every_cut::<4>(values);
    }
}

proptest! {
    /// With stores and cuts in any order, the newest record is that of the last store that has ended, unless an erase took it.
    #[test]
    fn after_any_stores_and_cuts_the_last_store_is_the_newest(events in prop::collection::vec((any::<u8>(), 0usize..700), 1..12)) {
        let mut flash = Nor::<4>::new();
        let mut newest = None;
        for (value, supply) in events {
            flash.supply = supply;
            let mut journal = open(&mut flash);
            let erases = journal.erases_next();
            let record: Record = [value; PAYLOAD];
            if journal.store(&mut flash, &record).is_ok() || boot(&flash).first() == Some(&value) {
                newest = Some(value);
            } else if erases {
                newest = boot(&flash).first().copied();
            }
            prop_assert_eq!(boot(&flash).first().copied(), newest);
        }
    }
}
