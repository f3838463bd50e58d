//! Helpers of the whole-system tests in `tests/tests`: a plant whose results are the same on every machine, the trace of a
//! ventilator on that plant, and a debugger for the board in QEMU.
#![forbid(unsafe_code)]

#[cfg(feature = "host")]
pub mod debugger;
pub mod exact_lung;
pub mod trace;

/// Whether tests write what the code gives into the files that they compare it with.
pub fn blesses() -> bool {
    std::env::var_os("EUPNEA_BLESS").is_some()
}
