//! Calls to the host: files and the end of the run (Arm: Semihosting for `AArch32` and `AArch64`).

use core::arch::asm;
use core::ffi::CStr;

const OPEN: u32 = 0x01;
const WRITE_TEXT: u32 = 0x04;
const WRITE: u32 = 0x05;
const READ: u32 = 0x06;
const SEEK: u32 = 0x0A;
const LENGTH: u32 = 0x0C;
const EXIT: u32 = 0x20;
const FAILURE: u32 = !0;

/// How a file is opened.
#[derive(Clone, Copy)]
pub enum Mode {
    /// Reading, if it exists.
    Read = 1,
    /// Reading and writing, if it exists.
    Update = 3,
    /// Reading and writing; it is made anew.
    Create = 7,
}

fn call(operation: u32, parameter: u32) -> u32 {
    let result;
    // SAFETY: QEMU takes the break for a call; it reads and writes only where the parameters of the functions below say.
    unsafe { asm!("bkpt #0xAB", inlateout("r0") operation => result, in("r1") parameter) }
    result
}

fn call_with<const N: usize>(operation: u32, parameters: [u32; N]) -> u32 {
    call(operation, parameters.as_ptr() as u32)
}

/// Opens a file in QEMU's working directory; gives its handle, which is never zero.
pub fn open(name: &CStr, mode: Mode) -> Option<u32> {
    let handle = call_with(OPEN, [name.as_ptr() as u32, mode as u32, name.count_bytes() as u32]);
    (handle != FAILURE).then_some(handle)
}

/// Writes everything, or tells that it could not.
pub fn write(file: u32, bytes: &[u8]) -> Result<(), ()> {
    let left = call_with(WRITE, [file, bytes.as_ptr() as u32, bytes.len() as u32]);
    if left == 0 { Ok(()) } else { Err(()) }
}

/// Reads some bytes to an address; gives how many, zero at the end of the file.
///
/// QEMU stores them past the protection of the flash, which the core can only read.
///
/// # Safety
/// The memory must be the caller's to change.
pub unsafe fn read_to(file: u32, address: u32, bytes: u32) -> u32 {
    let left = call_with(READ, [file, address, bytes]);
    // A failure counts as the end.
    bytes.saturating_sub(left)
}

/// As [`read_to`], to a buffer.
pub fn read(file: u32, buffer: &mut [u8]) -> usize {
    // SAFETY: the buffer is borrowed for it.
    unsafe { read_to(file, buffer.as_mut_ptr() as u32, buffer.len() as u32) as usize }
}

/// Goes to a byte of a file.
pub fn seek(file: u32, position: u32) {
    call_with(SEEK, [file, position]);
}

/// Length of a file.
pub fn length(file: u32) -> u32 {
    call_with(LENGTH, [file])
}

/// Writes a text where the host shows it.
pub fn tell(text: &CStr) {
    call(WRITE_TEXT, text.as_ptr() as u32);
}

/// Ends QEMU with an exit code, after a text.
pub fn fail(text: &CStr) -> ! {
    const APPLICATION_EXIT: u32 = 0x20026;
    tell(text);
    call_with(EXIT, [APPLICATION_EXIT, shim::EXIT_CODE]);
    loop {
        core::hint::spin_loop();
    }
}
