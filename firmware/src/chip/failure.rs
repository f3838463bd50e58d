//! Failures of the program (panic, hard fault, stack overflow): the valves go to their safe state, the reason is kept, and
//! the chip restarts in standby. Fulfils: tick-watchdog, stack-guard.
//!
//! After the restart nothing moves until a host requests it, and the greeting contains the reason.

use core::arch::naked_asm;
use core::fmt::Write;
use core::mem::MaybeUninit;
use core::panic::PanicInfo;
use core::ptr::{addr_of, addr_of_mut};

use cortex_m::peripheral::SCB;
use defmt::{Display2Format, error};
use heapless::String;
use shared::link::messages::FAILURE_BYTES;

use super::board;

/// Marks a note that this program has written.
const MARK: u32 = 0x4661_696C;

/// Reason of a restart because the supply voltage fell.
pub const SUPPLY_LOW: &str = "the supply voltage fell below 2.9 V";

/// Reason of a failure, in memory that the program's start does not initialise.
struct Note {
    mark: u32,
    length: usize,
    text: [u8; FAILURE_BYTES],
}

/// With less than this left of the stack, a fault is taken for an overflow, bytes: more than the largest frame of the core.
const STACK_MARGIN: u32 = 256;

unsafe extern "C" {
    /// Lower end of the stack, from memory.x. Below it there is no memory.
    static _stack_end: u8;
}

#[unsafe(link_section = ".uninit.failure")]
static mut NOTE: MaybeUninit<Note> = MaybeUninit::uninit();

/// Returns the reason of the last failure once; none if the program did not fail. Called before anything else runs.
pub fn of_last_run() -> Option<String<FAILURE_BYTES>> {
    // SAFETY: nothing else runs yet, and every bit pattern is a valid note; memory that was never written lacks the mark.
    let note = unsafe { (*addr_of_mut!(NOTE)).assume_init_mut() };
    let kept = core::mem::replace(&mut note.mark, 0) == MARK;
    let text = note.text.get(..note.length).filter(|_| kept)?;
    String::try_from(core::str::from_utf8(text).ok()?).ok()
}

#[panic_handler]
fn panic(info: &PanicInfo) -> ! {
    stop_safely();
    let place = info.location().map_or(("", 0), |place| (place.file(), place.line()));
    let mut text = Text(String::new());
    // Text that does not fit is cut off.
    let _ = write!(text, "{}:{}: {}", place.0, place.1, info.message());
    restart(&text.0)
}

/// Entry of the hard fault. After a stack overflow neither the stack nor the frame that the core pushed is usable, so this
/// begins at the top of the stack again, which no other code will use: the program does not continue.
#[unsafe(no_mangle)]
#[unsafe(naked)]
extern "C" fn HardFault() -> ! {
    naked_asm!(
        "mov r2, sp",
        "movs r0, #0",
        "movs r1, #0",
        "ldr r3, =_stack_end",
        "cmp r2, r3",
        "blo 1f",
        // The frame is in the stack: program counter and link register.
        "ldr r0, [r2, #24]",
        "ldr r1, [r2, #20]",
        "1: ldr r3, =_stack_start",
        "mov sp, r3",
        "b {handler}",
        handler = sym hard_fault,
    )
}

/// Handles a hard fault that pushed its frame at `stack`.
extern "C" fn hard_fault(pc: u32, lr: u32, stack: u32) -> ! {
    stop_safely();
    let mut text = Text(String::new());
    let _ = if stack < addr_of!(_stack_end) as u32 + STACK_MARGIN {
        write!(text, "stack overflow at {pc:#010x}, called from {lr:#010x}")
    } else {
        write!(text, "hard fault at {pc:#010x}, called from {lr:#010x}")
    };
    restart(&text.0)
}

/// The supply voltage is falling: makes the valves safe at once, and restarts.
pub fn supply_low() -> ! {
    stop_safely();
    restart(SUPPLY_LOW)
}

/// Masks interrupts and puts the valves in their safe state.
#[inline(never)]
fn stop_safely() {
    cortex_m::interrupt::disable();
    board::force_valves_safe();
}

/// Keeps the reason and restarts the chip. Not inlined, so that a debugger can halt before the restart.
#[inline(never)]
fn restart(text: &str) -> ! {
    error!("{}", Display2Format(text));
    let mut note = Note { mark: MARK, length: text.len(), text: [0; FAILURE_BYTES] };
    note.text[..text.len()].copy_from_slice(text.as_bytes());
    // SAFETY: interrupts are off, so no other code uses the note.
    unsafe { addr_of_mut!(NOTE).write(MaybeUninit::new(note)) };
    SCB::sys_reset()
}

/// Text that is cut off at the capacity.
struct Text(String<FAILURE_BYTES>);

impl Write for Text {
    fn write_str(&mut self, text: &str) -> core::fmt::Result {
        for character in text.chars() {
            self.0.push(character).map_err(|_| core::fmt::Error)?;
        }
        Ok(())
    }
}
