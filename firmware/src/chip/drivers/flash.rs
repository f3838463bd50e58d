//! The flash that holds the weights slots. Where they lie is said by memory.x alone.

use core::ops::Range;
use core::ptr::addr_of;

use embassy_stm32::flash::{Blocking, Flash};

/// The chip's flash; addresses count from its start.
pub type WeightsFlash = Flash<'static, Blocking>;

unsafe extern "C" {
    static __flash_start: u8;
    static __weights_a_start: u8;
    static __weights_a_end: u8;
    static __weights_b_start: u8;
    static __weights_b_end: u8;
}

/// Both slots, in addresses of [`WeightsFlash`].
pub fn slots() -> [Range<u32>; 2] {
    let offset = |symbol: *const u8| (symbol as u32).wrapping_sub(addr_of!(__flash_start) as u32);
    let a = offset(addr_of!(__weights_a_start))..offset(addr_of!(__weights_a_end));
    let b = offset(addr_of!(__weights_b_start))..offset(addr_of!(__weights_b_end));
    [a, b]
}
