//! The system tick handler: it keeps the host's pace and checks the watchdog, then jumps to the firmware's own handler.
//!
//! So a firmware that hangs with its system tick running and unmasked is reset. A firmware that masks all interrupts
//! permanently is not, unlike on the chip.

use core::arch::naked_asm;

use super::files::Files;
use super::{FIRMWARE_SYSTEM_TICK, registers};

#[unsafe(naked)]
pub unsafe extern "C" fn system_tick() {
    naked_asm!(
        "push {{r0, lr}}",
        "bl {look}",
        "pop {{r0, lr}}",
        "ldr r0, ={firmware}",
        "ldr r0, [r0]",
        "bx r0",
        look = sym look,
        firmware = sym FIRMWARE_SYSTEM_TICK,
    )
}

/// Resets the system if the watchdog has expired, and applies the conditions that a debugger has set.
extern "C" fn look() {
    // SAFETY: the tick interrupts only the firmware, and makes no access that faults.
    let (chip, record) = unsafe { (super::chip(), super::record()) };
    let interrupts = chip.suffer(record);
    if interrupts.non_maskable {
        registers::raise_non_maskable();
    }
    if interrupts.supply {
        registers::raise_supply();
    }
    let mut files = Files(record.files);
    chip.pace(&mut files);
    chip.run_clock(record, &mut files);
    let watchdog = &mut chip.iwdg;
    if watchdog.expired(registers::now()) {
        record.expire();
        cortex_m::peripheral::SCB::sys_reset();
    }
}
