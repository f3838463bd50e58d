//! The ventilator's firmware for an STM32F405: pins, interrupts and tasks around the ventilator of `shared`.
//!
//! Computations that need no chip stand in `shared`, where host and tests use them too. Build with
//! `cargo xtask firmware`. Compiled for any other system this is a program that says so, which keeps
//! `cargo check --workspace` working.
#![cfg_attr(target_os = "none", no_std)]
#![cfg_attr(target_os = "none", no_main)]

#[cfg(target_os = "none")]
mod chip;

#[cfg(not(target_os = "none"))]
fn main() {
    eprintln!("the firmware runs on the chip only; build it with: cargo xtask firmware");
    std::process::exit(1);
}
