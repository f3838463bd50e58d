//! The shim's start and state.
//!
//! All code here runs before the firmware, in the hard fault handler (only the firmware's instructions raise that fault), or
//! in the system tick, which raises none. So at most one of them uses the state at any time.

mod fault;
mod files;
mod registers;
mod semihosting;
mod tick;

use core::arch::{asm, naked_asm};
use core::mem::MaybeUninit;
use core::panic::PanicInfo;
use core::ptr::addr_of_mut;

use shim::backup::Domain;
use shim::bus::{Chip, REGIONS};
use shim::record::Record;

/// Address of the firmware's vector table, which begins with its stack pointer and its entry.
const FIRMWARE: u32 = 0x0800_0000;
/// Number of vectors: at least those of the core and of 82 interrupts.
const VECTORS: usize = 112;
const HARD_FAULT: usize = 3;
const SYSTEM_TICK: usize = 15;

#[repr(C, align(512))]
struct VectorTable([u32; VECTORS]);

#[unsafe(link_section = ".vector_table")]
static mut VECTOR_TABLE: VectorTable = VectorTable([0; VECTORS]);
/// The firmware's own handlers.
static mut FIRMWARE_HARD_FAULT: u32 = 0;
static mut FIRMWARE_SYSTEM_TICK: u32 = 0;
static mut CHIP: Chip = Chip::new(0);
#[unsafe(link_section = ".record")]
static mut RECORD: MaybeUninit<Record> = MaybeUninit::uninit();
#[unsafe(link_section = ".backup")]
static mut BACKUP: MaybeUninit<Domain> = MaybeUninit::uninit();

/// The modelled parts.
///
/// # Safety
/// Only one caller may use it at a time; see the module documentation.
unsafe fn chip() -> &'static mut Chip {
    // SAFETY: by contract there is no other reference.
    unsafe { &mut *addr_of_mut!(CHIP) }
}

/// The record. Before [`Record::begin`] it has any content; all bit patterns are valid.
///
/// # Safety
/// As for [`chip`].
unsafe fn record() -> &'static mut Record {
    // SAFETY: by contract there is no other reference, and the record consists of words, which are valid with any content.
    unsafe { (*addr_of_mut!(RECORD)).assume_init_mut() }
}

/// The part of the chip that the cell supplies. Before [`files::open`] it has any content; all bit patterns are valid.
///
/// # Safety
/// As for [`chip`].
unsafe fn domain() -> &'static mut Domain {
    // SAFETY: by contract there is no other reference, and the domain consists of words, which are valid with any content.
    unsafe { (*addr_of_mut!(BACKUP)).assume_init_mut() }
}

/// Entry after every reset. It does not use the firmware's stack.
#[unsafe(no_mangle)]
#[unsafe(naked)]
extern "C" fn shim_entry() -> ! {
    naked_asm!("ldr r0, =__shim_stack_top", "mov sp, r0", "b {start}", start = sym start)
}

extern "C" fn start() -> ! {
    // SAFETY: nothing else runs yet.
    let (chip, record) = unsafe { (chip(), record()) };
    record.begin();
    *chip = Chip::of(record);
    files::open(record);
    take_vectors();
    registers::start_clock();
    for (number, region) in REGIONS.iter().enumerate() {
        registers::protect(number as u32, region);
    }
    registers::enable_protection();
    let [stack, entry] = [FIRMWARE, FIRMWARE + 4].map(registers::read);
    // SAFETY: these are the firmware's own initial stack pointer and entry, as the core would load them from its vectors.
    unsafe { asm!("dsb", "isb", "msr msp, {}", "bx {}", in(reg) stack, in(reg) entry, options(noreturn)) }
}

/// Replaces the firmware's vector table by a copy with the shim's two handlers.
fn take_vectors() {
    // SAFETY: nothing else runs yet.
    let table = unsafe { &mut (*addr_of_mut!(VECTOR_TABLE)).0 };
    for (number, vector) in (0..).zip(table.iter_mut()) {
        *vector = registers::read(FIRMWARE + 4 * number);
    }
    // SAFETY: as above.
    unsafe {
        FIRMWARE_HARD_FAULT = table[HARD_FAULT];
        FIRMWARE_SYSTEM_TICK = table[SYSTEM_TICK];
    }
    table[HARD_FAULT] = fault::hard_fault as *const () as u32;
    table[SYSTEM_TICK] = tick::system_tick as *const () as u32;
    registers::set_vectors(table.as_ptr() as u32);
}

#[panic_handler]
fn panic(_: &PanicInfo) -> ! {
    semihosting::fail(c"shim: panic\n")
}
