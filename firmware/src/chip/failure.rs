//! Failures of the program (panic, hard fault): the valves go to their safe state, the reason is kept, and the chip restarts
//! in standby.
//!
//! After the restart nothing moves until a host requests it, and the greeting contains the reason.

use core::fmt::Write;
use core::mem::MaybeUninit;
use core::panic::PanicInfo;
use core::ptr::addr_of_mut;

use cortex_m::peripheral::SCB;
use cortex_m_rt::{ExceptionFrame, exception};
use defmt::{Display2Format, error};
use heapless::String;
use shared::link::messages::FAILURE_BYTES;

use super::board;

/// Marks a note that this program has written.
const MARK: u32 = 0x4661_696C;

/// Reason of a failure, in memory that the program's start does not initialise.
struct Note {
    mark: u32,
    length: usize,
    text: [u8; FAILURE_BYTES],
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

#[exception]
unsafe fn HardFault(frame: &ExceptionFrame) -> ! {
    stop_safely();
    let mut text = Text(String::new());
    let _ = write!(text, "hard fault at {:#010x}, called from {:#010x}", frame.pc(), frame.lr());
    restart(&text.0)
}

fn stop_safely() {
    cortex_m::interrupt::disable();
    board::force_valves_safe();
}

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
