//! The parts of an STM32F405 that QEMU does not model, as pure register models, and the decoder of the instructions that
//! access them.
//!
//! The `shim` program of this package is loaded into QEMU next to an *unchanged* firmware image. It makes the addresses
//! of these parts inaccessible, takes the fault that each access to them then raises, decodes the load or store, and
//! answers as the silicon would. What can be tested without a chip is here; the program holds the rest.
//!
//! | module | part of the chip |
//! |---|---|
//! | [`rcc`] | clocks: ready bits, reset flags |
//! | [`pwr`] | supply: ready bits |
//! | [`flash`] | flash controller, on the two slots for weights |
//! | [`iwdg`] | independent watchdog |
//! | [`plant_port`] | USART2 as the line to the plant |
//! | [`gpio`] | pins of ports A and B, for a debugger to see |
//! | [`bus`] | all of them at their addresses |
#![no_std]
#![forbid(unsafe_code)]

#[cfg(test)]
extern crate std;

pub mod bus;
pub mod decode;
pub mod flash;
pub mod gpio;
pub mod iwdg;
pub mod plant_port;
pub mod pwr;
pub mod rcc;
pub mod record;
pub mod store;

use core::ffi::CStr;

/// The file that holds both slots, in QEMU's working directory as the pipes are. It is made if it is not there.
pub const FLASH_FILE: &CStr = c"flash.bin";
/// Pipe to the plant: for each request its length, u16 little endian, and its bytes. A request without bytes says that
/// the shim has started.
pub const REQUEST_PIPE: &CStr = c"plant.request";
/// Pipe from the plant: one answer to each request in the same form; without bytes for silence. Without the pipes the line
/// is silent.
pub const ANSWER_PIPE: &CStr = c"plant.answer";
/// QEMU's exit code when the shim cannot go on.
pub const EXIT_CODE: u32 = 70;
