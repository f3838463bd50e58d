//! Semihosting calls to the host: files and exit (Arm: Semihosting for `AArch32` and `AArch64`).

use core::ffi::CStr;

use cortex_m_semihosting::nr::{self, open};
use cortex_m_semihosting::{syscall, syscall1};

/// `SYS_EXIT_EXTENDED`, which passes an exit code to the host.
const EXIT: usize = 0x20;
const FAILURE: u32 = !0;

/// Mode: read an existing file.
pub const READ: usize = open::R_BINARY;
/// Mode: read and write an existing file.
pub const UPDATE: usize = open::RW_BINARY;
/// Mode: read and write a new file.
pub const CREATE: usize = open::RW_TRUNC_BINARY;

fn call<const N: usize>(operation: usize, parameters: [u32; N]) -> u32 {
    // SAFETY: QEMU accesses only the memory that the parameters of the functions below specify.
    unsafe { syscall(operation, &parameters) as u32 }
}

/// Opens a file in QEMU's working directory; returns its handle, which is never zero.
pub fn open(name: &CStr, mode: usize) -> Option<u32> {
    let handle = call(nr::OPEN, [name.as_ptr() as u32, mode as u32, name.count_bytes() as u32]);
    (handle != FAILURE).then_some(handle)
}

/// Writes all bytes; ends QEMU on failure.
pub fn write(file: u32, bytes: &[u8]) {
    let left = call(nr::WRITE, [file, bytes.as_ptr() as u32, bytes.len() as u32]);
    if left != 0 {
        fail(c"shim: cannot write to flash.bin, backup.bin or the plant's pipe\n");
    }
}

/// Reads up to `bytes` bytes to an address; returns their number, zero at the end of the file.
///
/// QEMU bypasses the protection of the flash, which is read-only for the core.
///
/// # Safety
/// The caller must be allowed to change the memory.
pub unsafe fn read_to(file: u32, address: u32, bytes: u32) -> u32 {
    let left = call(nr::READ, [file, address, bytes]);
    // A failure counts as the end of the file.
    bytes.saturating_sub(left)
}

/// Like [`read_to`], but to a buffer. Not inlined: that would slow down every trap, and few of them read.
#[inline(never)]
pub fn read(file: u32, buffer: &mut [u8]) -> usize {
    // SAFETY: the buffer is mutably borrowed for the call.
    unsafe { read_to(file, buffer.as_mut_ptr() as u32, buffer.len() as u32) as usize }
}

/// Sets the position in a file.
pub fn seek(file: u32, position: u32) {
    call(nr::SEEK, [file, position]);
}

/// Length of a file, bytes.
pub fn length(file: u32) -> u32 {
    call(nr::FLEN, [file])
}

/// Prints a text on the host and ends QEMU with [`shim::EXIT_CODE`].
pub fn fail(text: &CStr) -> ! {
    const APPLICATION_EXIT: u32 = 0x20026;
    // SAFETY: QEMU reads the text up to its terminating zero.
    unsafe { syscall1(nr::WRITE0, text.as_ptr() as usize) };
    call(EXIT, [APPLICATION_EXIT, shim::EXIT_CODE]);
    loop {
        core::hint::spin_loop();
    }
}
