//! The flight recorder's memory: a region of its own, which memory.x keeps from every section, so that a reset leaves it
//! as it is.

use core::ptr::addr_of;

use shared::recorder::{Boot, Recorder, RecorderMemory};
use shared::reset::ResetCause;
use shared::weights::slots::{Slot, SlotState};

unsafe extern "C" {
    static __recorder_start: RecorderMemory;
    static __recorder_end: u8;
}

/// The recorder's memory, for readers. [`attach`] makes it a recorder.
pub fn memory() -> &'static RecorderMemory {
    // SAFETY: the region is RAM that nothing else uses, it begins at a word's boundary, `attach` checks its length before
    // anyone reads, and every bit pattern in it is valid, for it consists of atomics.
    unsafe { &__recorder_start }
}

/// Takes over what the last run left. Called once, before anyone reads.
pub fn attach(
    cause: ResetCause,
    failed: bool,
    slots: &[SlotState; 2],
    running: Option<Slot>,
) -> Recorder<'static> {
    let room = addr_of!(__recorder_end) as usize - addr_of!(__recorder_start) as usize;
    assert!(room >= size_of::<RecorderMemory>(), "memory.x leaves too little room for the flight recorder");
    let weights = running.and_then(|slot| slots[slot as usize].id());
    Recorder::attach(memory(), Boot { cause, failed, weights })
}
