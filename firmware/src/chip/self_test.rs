//! What the start of the chip tests: the program in flash, and RAM.

use core::ops::Range;
use core::ptr::addr_of;

use shared::checksum::CRC_32;
use shared::device::self_test::memory::{Words, is_sound};

/// Stack below the caller of the test of RAM that the test itself uses, bytes.
const OWN_STACK: usize = 4096;
/// Value of an erased byte, which the checksum counts in place of itself.
const ERASED: u8 = 0xFF;

unsafe extern "C" {
    static _stack_end: u8;
    static __ram_start: u8;
    static __ram_end: u8;
    static __flash_start: u8;
    static __weights_a_start: u8;
    static __weights_b_end: u8;
}

/// Length of the program in flash, bytes, and its CRC-32. `cargo xtask firmware` writes them into the finished image; a program
/// that is built otherwise has none.
#[used]
#[unsafe(no_mangle)]
#[unsafe(link_section = ".rodata.program_checksum")]
static PROGRAM_CHECKSUM: [u32; 2] = [u32::MAX; 2];

/// A range of RAM.
struct Ram {
    start: *mut u32,
    words: usize,
}

impl Ram {
    fn new(start: usize, end: usize) -> Self {
        Self { start: start as *mut u32, words: end.saturating_sub(start) / size_of::<u32>() }
    }
}

impl Words for Ram {
    fn length(&self) -> usize {
        self.words
    }

    fn load(&self, index: usize) -> u32 {
        // SAFETY: the index is below the length, see `is_memory_sound`.
        unsafe { self.start.add(index).read_volatile() }
    }

    fn store(&mut self, index: usize, word: u32) {
        // SAFETY: as above.
        unsafe { self.start.add(index).write_volatile(word) }
    }
}

/// Tests the variables and the unused stack; both have their content afterwards. Not the used stack, and not the regions that
/// survive a reset, which have checksums of their own: a supply that fails during the test must not change them. Called first of all.
#[inline(never)]
pub fn is_memory_sound() -> bool {
    let used = cortex_m::register::msp::read() as usize;
    // The ranges are RAM by the linker's map. No interrupt, DMA or other code uses them during the test: it runs before anything
    // is started, on the stack above the range, and every word has its content again when it returns.
    let mut stack = Ram::new(addr_of!(_stack_end) as usize, used.saturating_sub(OWN_STACK));
    let mut variables = Ram::new(addr_of!(__ram_start) as usize, addr_of!(__ram_end) as usize);
    is_sound(&mut stack) & is_sound(&mut variables)
}

/// Whether the program in flash matches its checksum; none if it has none.
#[inline(never)]
pub fn is_program_sound() -> Option<bool> {
    let place = addr_of!(PROGRAM_CHECKSUM);
    // SAFETY: volatile, because the image was changed after the compiler had seen the value.
    let [length, expected] = unsafe { place.read_volatile() };
    if length == u32::MAX {
        return None;
    }
    let start = addr_of!(__flash_start);
    let offset = |address: *const u8| (address as usize).wrapping_sub(start as usize);
    let place = offset(place.cast());
    let slots = offset(addr_of!(__weights_a_start))..offset(addr_of!(__weights_b_end));
    // In a small flash the weights are in the midst of the program.
    let gap = if slots.start < place { slots } else { 0..0 };
    let after = place + size_of::<[u32; 2]>();
    let end = (length as usize + gap.len()).max(after);
    let mut digest = CRC_32.digest();
    // SAFETY: all parts are flash that contains the program, and nothing writes it.
    let part = |part: Range<usize>| unsafe { core::slice::from_raw_parts(start.add(part.start), part.len()) };
    digest.update(part(0..gap.start));
    digest.update(part(gap.end..place));
    digest.update(&[ERASED; size_of::<[u32; 2]>()]);
    digest.update(part(after..end));
    Some(digest.finalize() == expected)
}
