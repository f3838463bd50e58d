//! Drivers: one for each function of the board. Computations without registers are in `shared`.
//!
//! They use those of `embassy-stm32`, and access registers themselves only where those do not serve:
//!
//! | driver | registers for |
//! |---|---|
//! | `adc` | the end of a conversion, which embassy's waits for without bound or does not tell |
//! | `backup` | clock and memory at VBAT: embassy's wait without bound for a crystal or a regulator that may be missing |
//! | `clock` | a tick in the highest priority and cycle counts; embassy's time driver needs a timer and its own interrupt |
//! | `flash` | the accelerator; the data cache, which embassy's handles only on chips with two banks |
//! | `link_uart`, `plant_line` | one interrupt per byte that never writes the status register; a polled exchange with a timeout |
//! | `oscillator`, `reset`, `supply` | a crystal that stops at run time, the cause of a reset, supply detector and option bytes: embassy has none |
//! | `watchdog` | the timeout of a watchdog that runs, which embassy's sets once |

#[cfg(bedside)]
pub mod adc;
pub mod alarm_outputs;
pub mod backup;
#[cfg(bedside)]
pub mod bedside;
pub mod clock;
pub mod core_clock;
#[cfg(feature = "desk")]
pub mod desk;
pub mod flash;
pub mod link_uart;
pub mod oscillator;
pub mod plant_interface;
#[cfg(feature = "hil")]
pub mod plant_line;
pub mod reset;
pub mod supply;
#[cfg(bedside)]
pub mod valves;
pub mod watchdog;

use embassy_stm32::Peri;
use embassy_stm32::usart::{Config, Instance, RxPin, TxPin, Uart};

/// Baud rate of both serial lines.
const BAUD: u32 = 1_000_000;

/// Configures pins, clock and baud rate of a serial line whose registers a driver accesses itself.
pub fn open_serial<P: Instance>(
    port: Peri<'static, P>,
    receive: Peri<'static, impl RxPin<P>>,
    transmit: Peri<'static, impl TxPin<P>>,
) {
    let mut config = Config::default();
    config.baudrate = BAUD;
    // Dropping the driver would close the line.
    core::mem::forget(taken_once(Uart::new_blocking(port, receive, transmit, config).ok()));
}

/// Unwraps a value that the start of the program takes or builds once, from a valid configuration.
pub fn taken_once<T>(value: Option<T>) -> T {
    match value {
        Some(value) => value,
        None => unreachable!("taken once, at the start"),
    }
}
