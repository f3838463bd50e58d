//! Register models of the parts of an STM32F405 that QEMU lacks, and a decoder for the instructions that access them.
//!
//! QEMU loads the `shim` program of this package next to an *unchanged* firmware image. The shim makes the addresses of
//! these parts inaccessible, handles the fault that each access then raises, decodes the load or store, and emulates it.
//! Code that can be tested without a chip is in this library; the program contains the rest.
//!
//! | module | part of the chip |
//! |---|---|
//! | [`rcc`] | clocks: ready bits, reset flags |
//! | [`pwr`] | supply: ready bits |
//! | [`flash`] | flash controller, for the copies of the flight recorder and the weights slots |
//! | [`iwdg`] | independent watchdog |
//! | [`backup`] | memory and calendar clock that a cell supplies |
//! | [`plant_port`] | USART2 as the line to the plant |
//! | [`gpio`] | pins of ports A and B, for a debugger |
//! | [`bus`] | routing of accesses to these parts |
#![no_std]
#![forbid(unsafe_code)]

#[cfg(test)]
extern crate std;

pub mod backup;
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

/// File with the changeable sectors of the flash, in QEMU's working directory like the pipes. It is created if it does not exist.
pub const FLASH_FILE: &CStr = c"flash.bin";
/// File with the part of the chip that a cell supplies, [`backup::BYTES`] long. It is created if it does not exist.
pub const BACKUP_FILE: &CStr = c"backup.bin";
/// Pipe to the plant: for each request its length, u16 little endian, and its bytes. A request without bytes reports
/// the shim's start.
pub const REQUEST_PIPE: &CStr = c"plant.request";
/// Pipe from the plant: one answer to each request in the same form, empty if the plant does not answer. Without the pipes
/// no plant is connected.
pub const ANSWER_PIPE: &CStr = c"plant.answer";
/// QEMU's exit code when the shim cannot continue.
pub const EXIT_CODE: u32 = 70;
