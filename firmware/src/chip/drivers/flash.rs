//! The flash: its accelerator, and the parts that contain the weights slots, the copies of the flight recorder and the
//! calibrations. Only firmware/memory/ defines their addresses.

use core::ptr::addr_of;

use embassy_stm32::Peri;
use embassy_stm32::flash::{Blocking, Error, Flash, get_flash_regions};
use embassy_stm32::pac::FLASH;
use embassy_stm32::peripherals;
use embedded_storage::nor_flash::{ErrorType, NorFlash, ReadNorFlash};
use shared::recorder::keeper::Keeper;

/// Driver of the chip's flash; addresses are offsets from its start.
///
/// The data cache is not updated by an erase, so it is off during each change and empty afterwards: a store reads back what
/// is in the flash. Embassy's driver does that only for chips with two banks.
pub struct BoardFlash(Flash<'static, Blocking>);

impl BoardFlash {
    /// Takes the flash.
    pub fn new(flash: Peri<'static, peripherals::FLASH>) -> Self {
        Self(Flash::new_blocking(flash))
    }
}

impl ErrorType for BoardFlash {
    type Error = Error;
}

impl ReadNorFlash for BoardFlash {
    const READ_SIZE: usize = <Flash<'static, Blocking> as ReadNorFlash>::READ_SIZE;

    fn read(&mut self, offset: u32, bytes: &mut [u8]) -> Result<(), Error> {
        ReadNorFlash::read(&mut self.0, offset, bytes)
    }

    fn capacity(&self) -> usize {
        ReadNorFlash::capacity(&self.0)
    }
}

impl NorFlash for BoardFlash {
    const WRITE_SIZE: usize = <Flash<'static, Blocking> as NorFlash>::WRITE_SIZE;
    /// Length of the shortest sectors, bytes.
    const ERASE_SIZE: usize = 16 * 1024;

    /// Erases whole sectors: sizes differ, and whatever memory.x places has sectors of its own.
    fn erase(&mut self, from: u32, to: u32) -> Result<(), Error> {
        let end = sector_end(to);
        uncached(|| NorFlash::erase(&mut self.0, from, end))
    }

    fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), Error> {
        uncached(|| NorFlash::write(&mut self.0, offset, bytes))
    }
}

/// Offset of the end of the sector to which the byte before an offset belongs.
fn sector_end(offset: u32) -> u32 {
    let regions = get_flash_regions().iter();
    let mut around =
        regions.filter(|region| (region.offset..region.offset + region.size).contains(&(offset - 1)));
    around
        .next()
        .map_or(offset, |region| region.offset + (offset - region.offset).next_multiple_of(region.erase_size))
}

/// Runs a change of the flash without the data cache, which is empty afterwards.
fn uncached<T>(change: impl FnOnce() -> T) -> T {
    FLASH.acr().modify(|w| w.set_dcen(false));
    let result = change();
    // The cache can only be emptied while it is off.
    FLASH.acr().modify(|w| w.set_dcrst(true));
    FLASH.acr().modify(|w| w.set_dcrst(false));
    FLASH.acr().modify(|w| w.set_dcen(true));
    result
}

/// Turns on prefetch and both caches. They are off after a reset, and the start of the clocks, which sets the wait states, leaves
/// them off; without them each jump waits for the flash five cycles.
pub fn accelerate() {
    FLASH.acr().modify(|w| {
        w.set_prften(true);
        w.set_icen(true);
        w.set_dcen(true);
    });
}

unsafe extern "C" {
    static __flash_start: u8;
    static __weights_a_start: u8;
    static __weights_b_start: u8;
    static __recorder_copy_a_start: u8;
    static __recorder_copy_b_start: u8;
    static __recorder_copy_b_end: u8;
    static __calibrations_start: u8;
    static __calibrations_end: u8;
}

/// Offset of an address from the start of the flash.
fn offset(address: *const u8) -> u32 {
    (address as u32).wrapping_sub(addr_of!(__flash_start) as u32)
}

/// Start addresses of both slots, for [`BoardFlash`].
pub fn slots() -> [u32; 2] {
    [addr_of!(__weights_a_start), addr_of!(__weights_b_start)].map(offset)
}

/// Start addresses of both copies of the flight recorder; none on a board whose flash has no room for them.
pub fn copies() -> Option<[u32; 2]> {
    let [a, b, end] = [
        addr_of!(__recorder_copy_a_start),
        addr_of!(__recorder_copy_b_start),
        addr_of!(__recorder_copy_b_end),
    ]
    .map(offset);
    let room = b.saturating_sub(a).min(end.saturating_sub(b));
    (room >= Keeper::BYTES).then_some([a, b])
}

/// Start address and length of the sector of the calibrations, bytes; none on a board whose flash has no room for it.
pub fn calibrations() -> Option<(u32, u32)> {
    let [start, end] = [addr_of!(__calibrations_start), addr_of!(__calibrations_end)].map(offset);
    (end > start).then(|| (start, end - start))
}
