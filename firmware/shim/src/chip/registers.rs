//! The core's registers that the shim uses, and the timer that serves as its clock.

use core::ptr::{read_volatile, write_volatile};

use shim::bus::Region;

const VECTOR_TABLE: u32 = 0xE000_ED08;
const FAULT_STATUS: u32 = 0xE000_ED28;
const PROTECTION_CONTROL: u32 = 0xE000_ED94;
const REGION_NUMBER: u32 = 0xE000_ED98;
const REGION_ADDRESS: u32 = 0xE000_ED9C;
const REGION_ATTRIBUTES: u32 = 0xE000_EDA0;
/// TIM5: in QEMU it counts nanoseconds of virtual time, independent of the clock settings.
const TIMER_CONTROL: u32 = 0x4000_0C00;
const TIMER_COUNT: u32 = 0x4000_0C24;

/// Reads a word of memory or a register.
#[inline]
pub fn read(address: u32) -> u32 {
    // SAFETY: called with addresses of the registers above and of the firmware's flash, which may all be read.
    unsafe { read_volatile(address as *const u32) }
}

#[inline]
fn write(address: u32, value: u32) {
    // SAFETY: called with addresses of the registers above, none of which affects memory that Rust manages.
    unsafe { write_volatile(address as *mut u32, value) }
}

/// Sets the address of the vector table.
pub fn set_vectors(address: u32) {
    write(VECTOR_TABLE, address);
}

/// Makes accesses to a region fault.
pub fn protect(number: u32, region: &Region) {
    const EXECUTE_NEVER: u32 = 1 << 28;
    const READ_ONLY: u32 = 5 << 24;
    /// Normal memory; otherwise the core could not execute code or make unaligned loads there.
    const NORMAL: u32 = 1 << 17;
    const ENABLE: u32 = 1;
    let access = if region.readable { READ_ONLY | NORMAL } else { EXECUTE_NEVER };
    write(REGION_NUMBER, number);
    write(REGION_ADDRESS, region.address);
    let open = (1 << region.open_eighths) - 1;
    write(REGION_ATTRIBUTES, access | open << 8 | (region.bytes.ilog2() - 1) << 1 | ENABLE);
}

/// Enables the protection of the regions only; the hard fault handler is exempt.
pub fn enable_protection() {
    const ENABLE: u32 = 1;
    const ELSEWHERE_AS_WITHOUT: u32 = 1 << 2;
    write(PROTECTION_CONTROL, ENABLE | ELSEWHERE_AS_WITHOUT);
}

/// Raises the non-maskable interrupt.
pub fn raise_non_maskable() {
    const INTERRUPT_CONTROL: u32 = 0xE000_ED04;
    const RAISE: u32 = 1 << 31;
    write(INTERRUPT_CONTROL, RAISE);
}

/// Raises the interrupt of the supply voltage detector, if its line is enabled and triggers on a rising edge.
pub fn raise_supply() {
    const LINE_ENABLE: u32 = 0x4001_3C00;
    const LINE_RISING: u32 = 0x4001_3C08;
    const LINE: u32 = 1 << 16;
    const SET_PENDING: u32 = 0xE000_E200;
    const INTERRUPT: u32 = 1 << 1;
    if read(LINE_ENABLE) & read(LINE_RISING) & LINE != 0 {
        write(SET_PENDING, INTERRUPT);
    }
}

/// Clears the status of refused accesses.
pub fn forget_refusals() {
    const REFUSED_AT_ADDRESS: u32 = 1 << 7 | 1 << 1;
    write(FAULT_STATUS, REFUSED_AT_ADDRESS);
}

/// Starts the clock behind [`now`].
pub fn start_clock() {
    write(TIMER_CONTROL, 1);
}

/// Current time in nanoseconds, wrapping.
#[inline]
pub fn now() -> u32 {
    read(TIMER_COUNT)
}
