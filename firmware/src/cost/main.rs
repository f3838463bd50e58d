//! Counts the instructions of the control tick and of its parts in QEMU; `cargo xtask cost` runs it.
//!
//! QEMU's timer 5 counts nanoseconds of virtual time, and with `-icount shift=3` an instruction takes 8 ns, so the
//! difference of two counts gives an exact number of instructions. On a chip the results are meaningless.
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
    eprintln!("this program runs in QEMU only; run it with: cargo xtask cost");
    std::process::exit(1);
}
