//! The flash that contains the weights slots. Only memory.x defines their addresses.

use core::ptr::addr_of;

use embassy_stm32::flash::{Blocking, Flash};

/// Driver of the chip's flash; addresses are offsets from its start.
pub type WeightsFlash = Flash<'static, Blocking>;

unsafe extern "C" {
    static __flash_start: u8;
    static __weights_a_start: u8;
    static __weights_b_start: u8;
}

/// Start addresses of both slots, for [`WeightsFlash`].
pub fn slots() -> [u32; 2] {
    [addr_of!(__weights_a_start), addr_of!(__weights_b_start)]
        .map(|start| (start as u32).wrapping_sub(addr_of!(__flash_start) as u32))
}
