//! The prescription's memory: the chip's backup memory, which neither a reset nor, with a cell at VBAT, a power cut changes.

use core::ptr::addr_of;

use shared::device::prescription::{Interruption, Prescription, PrescriptionMemory};

use super::drivers::backup;

unsafe extern "C" {
    static __prescription_start: PrescriptionMemory;
    static __prescription_end: u8;
}

/// The memory; [`attach`] opens it.
fn memory() -> &'static PrescriptionMemory {
    // SAFETY: the region is memory that nothing else uses and is aligned to words, `attach` checks its length before the first
    // access, and every bit pattern is valid because it consists of atomics.
    unsafe { &__prescription_start }
}

/// Attaches to the content that the last run left. Called once, before [`tend`].
pub fn attach(interruption: Option<Interruption>) -> Prescription<'static> {
    let room = addr_of!(__prescription_end) as usize - addr_of!(__prescription_start) as usize;
    assert!(room >= size_of::<PrescriptionMemory>(), "the region PRESCRIPTION is too small");
    backup::open();
    Prescription::attach(memory(), interruption, backup::time())
}

/// Notes the time while the device ventilates, and starts a clock that has no time. Call it several times a second.
pub fn tend(ventilates: bool) {
    match backup::time() {
        Some(now) if ventilates => memory().ventilates_at(now),
        Some(_) => {}
        None => backup::set_clock(),
    }
}
