//! The ventilator's firmware for an STM32F405 or STM32F446: pins, interrupts and tasks around the device of `shared`.
//!
//! Computations that need no chip are in `shared`, where host and tests use them too. Build it with
//! `cargo xtask firmware`. Compiled for any other system it only prints how to build it, so that
//! `cargo check --workspace` works.
#![cfg_attr(target_os = "none", no_std)]
#![cfg_attr(target_os = "none", no_main)]

#[cfg(target_os = "none")]
mod chip;

#[cfg(not(target_os = "none"))]
fn main() {
    eprintln!("the firmware runs on the chip only; build it with: cargo xtask firmware");
    std::process::exit(1);
}
