//! The hard fault handler: it emulates refused accesses, and passes any other fault on to the firmware.
//!
//! It recognises a refused access by its instruction. The core's fault registers would also show it, but in QEMU each access
//! to a register of the core takes longer than the rest of the handler.

use core::arch::naked_asm;
use core::ops::Range;
use core::ptr::{read_volatile, with_exposed_provenance};

use shim::bus;
use shim::decode::{self, Access, Direction};
use shim::store::Width;

use super::files::Files;
use super::{FIRMWARE_HARD_FAULT, registers};

/// Registers that the core has pushed: r0 to r3, r12, lr, pc, status.
type Frame = [u32; 8];
const FRAME_R12: usize = 4;
const FRAME_LR: usize = 5;
const FRAME_PC: usize = 6;
const FRAME_STATUS: usize = 7;
/// Registers that the core does not push: r4 to r11.
type Kept = [u32; 8];

/// Memory in which programs run: flash without the slots, and RAM, each without its last word.
const PROGRAM: [Range<u32>; 2] = [0x0800_0000..0x0807_FFFC, 0x2000_0000..0x2001_FFFC];

/// Start of RAM, and of the firmware's stack.
const RAM: u32 = 0x2000_0000;

/// Switches to the shim's own stack, so that the firmware's stack only needs room for the frame that the core pushes.
#[unsafe(naked)]
pub unsafe extern "C" fn hard_fault() {
    naked_asm!(
        "tst lr, #4",
        "ite eq",
        "mrseq r0, msp",
        "mrsne r0, psp",
        "mov r2, sp",
        "ldr r1, =__shim_stack_top",
        "mov sp, r1",
        "push {{r2, lr}}",
        "push {{r4-r11}}",
        "mov r1, sp",
        "bl {answer}",
        "pop {{r4-r11}}",
        "pop {{r2, lr}}",
        "mov sp, r2",
        "cbz r0, 1f",
        "bx lr",
        "1: ldr r0, ={firmware}",
        "ldr r0, [r0]",
        "bx r0",
        answer = sym answer,
        firmware = sym FIRMWARE_HARD_FAULT,
    )
}

/// Emulates the refused instruction with the models. Returns false if the fault has another cause or the instruction is not
/// supported: then the firmware handles it.
unsafe extern "C" fn answer(frame: *mut Frame, kept: &mut Kept) -> bool {
    if (frame as u32) < RAM {
        // The firmware's stack has overflowed, so there is no frame.
        return false;
    }
    // SAFETY: the frame that the core has pushed is in RAM, since the stack ends where RAM starts; only this handler uses it.
    let frame = unsafe { &mut *frame };
    let Some(access) = instruction(frame[FRAME_PC]) else { return false };
    let address = access.address(|number| *register(number, frame, kept));
    if !bus::is_refused(address, access.direction) {
        // The firmware must see the status of its own fault only.
        registers::forget_refusals();
        return false;
    }
    // SAFETY: the hard fault interrupts only the firmware, and nothing interrupts it.
    let (chip, record) = unsafe { (super::chip(), super::record()) };
    record.traps = record.traps.wrapping_add(1);
    let mut files = Files(record.files);
    let register = register(access.register, frame, kept);
    match access.direction {
        Direction::Store => chip.store(address, access.width, *register, record, &mut files),
        Direction::Load => *register = chip.load(address, access.width, record, &mut files),
        Direction::LoadSigned => {
            let value = chip.load(address, access.width, record, &mut files);
            *register = match access.width {
                Width::Byte => i32::from(value as i8) as u32,
                _ => i32::from(value as i16) as u32,
            };
        }
    }
    frame[FRAME_PC] += access.length;
    frame[FRAME_STATUS] = decode::behind(frame[FRAME_STATUS]);
    true
}

/// The load or store at an address, if a program can be there.
#[inline]
fn instruction(address: u32) -> Option<Access> {
    if !PROGRAM.iter().any(|memory| memory.contains(&address)) {
        return None;
    }
    // SAFETY: the address is in memory, and the range excludes the last word, so both halves can be read.
    let half = |address: u32| unsafe { read_volatile(with_exposed_provenance::<u16>(address as usize)) };
    let first = half(address);
    let second = if decode::is_wide(first) { half(address + 2) } else { 0 };
    decode::decode(first, second)
}

/// Location of a register's value during the handler.
#[inline]
fn register<'a>(number: u8, frame: &'a mut Frame, kept: &'a mut Kept) -> &'a mut u32 {
    match number {
        0..=3 => &mut frame[usize::from(number)],
        4..=11 => &mut kept[usize::from(number - 4)],
        12 => &mut frame[FRAME_R12],
        _ => &mut frame[FRAME_LR],
    }
}
