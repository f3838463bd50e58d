//! Counts the instructions of the control tick and of its parts, in QEMU; `cargo xtask cost` runs it.
//!
//! QEMU's timer 5 counts nanoseconds of virtual time, and with `-icount shift=3` an instruction takes eight of them: a
//! difference of its counter is an exact number of instructions. On a chip this program means nothing.
#![cfg_attr(target_os = "none", no_std)]
#![cfg_attr(target_os = "none", no_main)]

#[cfg(target_os = "none")]
mod chip;
/// The plant of the golden traces.
#[cfg(target_os = "none")]
#[path = "../../../tests/src/exact_lung.rs"]
mod exact_lung;
#[cfg(target_os = "none")]
mod fixture;

#[cfg(not(target_os = "none"))]
fn main() {
    eprintln!("this image runs in the emulator only: cargo xtask cost");
    std::process::exit(1);
}
