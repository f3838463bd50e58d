//! The cause of the chip's start.

use embassy_stm32::pac::RCC;
use shared::reset::ResetCause;

/// Reads the cause of the start, and clears the flags for the next one. The pin's flag is set by every cause, so it counts
/// only alone.
pub fn cause() -> ResetCause {
    let flags = RCC.csr().read();
    RCC.csr().modify(|w| w.set_rmvf(true));
    if flags.wdgrstf() || flags.wwdgrstf() {
        ResetCause::Watchdog
    } else if flags.sftrstf() {
        ResetCause::Software
    } else if flags.porrstf() {
        ResetCause::PowerOn
    } else if flags.borrstf() {
        ResetCause::BrownOut
    } else if flags.padrstf() {
        ResetCause::Pin
    } else {
        ResetCause::Other
    }
}
