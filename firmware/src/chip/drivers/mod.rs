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
#[cfg(not(feature = "hil"))]
pub mod valves;
pub mod watchdog;

use embassy_stm32::Peri;
use embassy_stm32::usart::{Config, Instance, RxPin, TxPin, Uart};

/// Speed of both serial lines, baud.
const BAUD: u32 = 1_000_000;

/// Sets up pins, clock and speed of a serial line whose registers a driver uses itself.
pub fn open_serial<P: Instance>(
    port: Peri<'static, P>,
    receive: Peri<'static, impl RxPin<P>>,
    transmit: Peri<'static, impl TxPin<P>>,
) {
    let mut config = Config::default();
    config.baudrate = BAUD;
    // Dropping it would close the line.
    core::mem::forget(taken_once(Uart::new_blocking(port, receive, transmit, config).ok()));
}

/// Unwraps what the start of the program takes or builds once: it is there, and its configuration is valid.
pub fn taken_once<T>(value: Option<T>) -> T {
    match value {
        Some(value) => value,
        None => unreachable!("taken once, at the start"),
    }
}
