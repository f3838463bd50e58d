//! The prescription's memory: a region in memory.x without any section, so that a reset does not change it.

use core::ptr::addr_of;

use shared::device::prescription::{Interruption, Prescription, PrescriptionMemory};

unsafe extern "C" {
    static __prescription_start: PrescriptionMemory;
    static __prescription_end: u8;
}

/// Attaches to the content that the last run left. Called once.
pub fn attach(interruption: Option<Interruption>) -> Prescription<'static> {
    let room = addr_of!(__prescription_end) as usize - addr_of!(__prescription_start) as usize;
    assert!(room >= size_of::<PrescriptionMemory>(), "PRESCRIPTION in memory.x is too small");
    // SAFETY: the region is RAM that nothing else uses and is aligned to words, its length is checked, and every bit pattern
    // is valid because it consists of atomics.
    Prescription::attach(unsafe { &__prescription_start }, interruption)
}
