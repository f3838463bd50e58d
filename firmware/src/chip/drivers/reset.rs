//! The cause of the chip's last reset.

use embassy_stm32::pac::RCC;
use shared::reset::ResetCause;

/// Reads the cause of the reset and clears its flags. Every cause sets the pin's flag too, so the pin is the cause only if
/// no other flag is set.
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
