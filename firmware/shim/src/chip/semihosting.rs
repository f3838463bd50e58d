//! Calls to the host: files and the end of the run (Arm: Semihosting for `AArch32` and `AArch64`).

use core::ffi::CStr;

use cortex_m_semihosting::nr::{self, open};
use cortex_m_semihosting::{syscall, syscall1};

/// `SYS_EXIT_EXTENDED`, whose exit code the host sees.
const EXIT: usize = 0x20;
const FAILURE: u32 = !0;

/// Reading, if the file exists.
pub const READ: usize = open::R_BINARY;
/// Reading and writing, if the file exists.
pub const UPDATE: usize = open::RW_BINARY;
/// Reading and writing a new file.
pub const CREATE: usize = open::RW_TRUNC_BINARY;

fn call<const N: usize>(operation: usize, parameters: [u32; N]) -> u32 {
    // SAFETY: QEMU reads and writes only where the parameters of the functions below say.
    unsafe { syscall(operation, &parameters) as u32 }
}

/// Opens a file in QEMU's working directory; gives its handle, which is never zero.
pub fn open(name: &CStr, mode: usize) -> Option<u32> {
    let handle = call(nr::OPEN, [name.as_ptr() as u32, mode as u32, name.count_bytes() as u32]);
    (handle != FAILURE).then_some(handle)
}

/// Writes everything, or ends QEMU.
pub fn write(file: u32, bytes: &[u8]) {
    let left = call(nr::WRITE, [file, bytes.as_ptr() as u32, bytes.len() as u32]);
    if left != 0 {
        fail(c"shim: cannot write\n");
    }
}

/// Reads some bytes to an address; gives how many, zero at the end of the file.
///
/// QEMU stores them past the protection of the flash, which the core can only read.
///
/// # Safety
/// The memory must be the caller's to change.
pub unsafe fn read_to(file: u32, address: u32, bytes: u32) -> u32 {
    let left = call(nr::READ, [file, address, bytes]);
    // A failure counts as the end.
    bytes.saturating_sub(left)
}

/// As [`read_to`], to a buffer. Not inlined: that would make every trap longer, and few of them read.
#[inline(never)]
pub fn read(file: u32, buffer: &mut [u8]) -> usize {
    // SAFETY: the buffer is borrowed for it.
    unsafe { read_to(file, buffer.as_mut_ptr() as u32, buffer.len() as u32) as usize }
}

/// Goes to a byte of a file.
pub fn seek(file: u32, position: u32) {
    call(nr::SEEK, [file, position]);
}

/// Length of a file.
pub fn length(file: u32) -> u32 {
    call(nr::FLEN, [file])
}

/// Ends QEMU with an exit code, after a text that the host shows.
pub fn fail(text: &CStr) -> ! {
    const APPLICATION_EXIT: u32 = 0x20026;
    // SAFETY: QEMU reads the text up to its end.
    unsafe { syscall1(nr::WRITE0, text.as_ptr() as usize) };
    call(EXIT, [APPLICATION_EXIT, shim::EXIT_CODE]);
    loop {
        core::hint::spin_loop();
    }
}
