//! The shim: a small image that QEMU loads next to an unchanged firmware image and starts first.
//!
//! It lives in the upper 16 KiB of the core-coupled RAM. The firmware must leave that memory, the memory protection unit
//! and the vector table's address alone. Compiled for any other system this is a program that says what it is for.
#![cfg_attr(target_os = "none", no_std)]
#![cfg_attr(target_os = "none", no_main)]

#[cfg(target_os = "none")]
mod chip;

#[cfg(not(target_os = "none"))]
fn main() {
    eprintln!("the shim runs in QEMU only; build it with: cargo xtask firmware");
    std::process::exit(1);
}
