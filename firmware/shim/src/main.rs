//! The shim: a small image that QEMU loads next to an unchanged firmware image, and that runs first.
//!
//! It uses the upper 21 KiB of the core-coupled RAM. The firmware must not use that memory or the memory protection unit,
//! or move the vector table. Compiled for any other system it only prints its purpose.
#![cfg_attr(target_os = "none", no_std)]
#![cfg_attr(target_os = "none", no_main)]

#[cfg(target_os = "none")]
mod chip;

#[cfg(not(target_os = "none"))]
fn main() {
    eprintln!("the shim runs in QEMU only; build it with: cargo xtask firmware");
    std::process::exit(1);
}
