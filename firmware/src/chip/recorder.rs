//! The flight recorder's memory: a region without any section, so that a reset does not change it.

use core::ptr::addr_of;

use shared::recorder::keeper::Keeper;
use shared::recorder::{Boot, Recorder, RecorderMemory};
use shared::reset::ResetCause;
use shared::weights::slots::{Slot, SlotState};

use super::drivers::flash::{self, BoardFlash};

unsafe extern "C" {
    static __recorder_start: RecorderMemory;
    static __recorder_end: u8;
}

/// The recorder's memory, for readers; [`attach`] initialises it.
pub fn memory() -> &'static RecorderMemory {
    // SAFETY: the region is RAM that nothing else uses and is aligned to words, `attach` checks its length before the first
    // access, and every bit pattern is valid because it consists of atomics.
    unsafe { &__recorder_start }
}

/// Attaches to the content that the last run left, or to its copy in flash if the memory has lost it; returns the keeper of
/// that copy, on a board with room for it. Called once, before the first reader.
pub fn attach(
    cause: ResetCause,
    failed: bool,
    slots: &[SlotState; 2],
    running: Option<Slot>,
    flash: &mut BoardFlash,
) -> (Recorder<'static>, Option<Keeper>) {
    let room = addr_of!(__recorder_end) as usize - addr_of!(__recorder_start) as usize;
    assert!(room >= size_of::<RecorderMemory>(), "the region RECORDER is too small for the flight recorder");
    let weights = running.and_then(|slot| slots[slot as usize].id());
    let kept = flash::copies().map(|starts| Keeper::attach(flash, starts, memory(), cause));
    let (keeper, restored) = kept.map_or((None, false), |(keeper, restored)| (Some(keeper), restored));
    (Recorder::attach(memory(), Boot { cause, failed, weights, restored }), keeper)
}
