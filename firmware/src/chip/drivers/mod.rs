//! Drivers: the registers behind each function of the board. What can be computed without them is in `shared`.

#[cfg(not(feature = "hil"))]
pub mod adc;
#[cfg(not(feature = "hil"))]
pub mod bedside;
pub mod clock;
pub mod flash;
pub mod link_uart;
#[cfg(feature = "hil")]
pub mod plant_line;
pub mod reset;
pub mod valves;
pub mod watchdog;

/// Unwraps what the start of the program takes or builds once: it is there, and its configuration is valid.
pub fn taken_once<T>(value: Option<T>) -> T {
    match value {
        Some(value) => value,
        None => unreachable!("taken once, at the start"),
    }
}
