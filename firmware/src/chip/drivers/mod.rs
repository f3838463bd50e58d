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

/// A thing that the start of the program takes once, so that it is there.
pub fn usable<T>(thing: Option<T>) -> T {
    match thing {
        Some(thing) => thing,
        None => unreachable!("taken once, at the start"),
    }
}
