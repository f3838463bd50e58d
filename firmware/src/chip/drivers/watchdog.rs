//! The independent watchdog: it restarts the chip when a control tick does not end.

use embassy_stm32::pac::IWDG;
use embassy_stm32::pac::iwdg::vals::{Key, Pr};
use embassy_stm32::peripherals;
use embassy_stm32::wdg::IndependentWatchdog;

/// Nominal frequency of the watchdog's oscillator, Hz.
const OSCILLATOR: u32 = 32_000;
/// Prescaler of the long timeout.
const LONG_TIMEOUT_PRESCALER: Pr = Pr::DIVIDE_BY256;
/// Reload value of the long timeout: nominally 16 s, since erasing a sector takes up to 4 s.
const LONG_TIMEOUT_RELOAD: u16 = (16 * OSCILLATOR / 256 - 1) as u16;

/// The watchdog. Once started, only a reset stops it; the control task feeds it at the end of each tick.
pub type Watchdog = IndependentWatchdog<'static, peripherals::IWDG>;

/// Runs work that stalls the core for seconds, such as erasing flash, with the long timeout. Only in standby.
pub fn with_long_timeout<T>(work: impl FnOnce() -> T) -> T {
    let (prescaler, reload) = (IWDG.pr().read().pr(), IWDG.rlr().read().rl());
    set(LONG_TIMEOUT_PRESCALER, LONG_TIMEOUT_RELOAD);
    let result = work();
    set(prescaler, reload);
    result
}

fn set(prescaler: Pr, reload: u16) {
    // In a critical section: a tick that feeds the watchdog in between would lock the registers again.
    cortex_m::interrupt::free(|_| {
        IWDG.kr().write(|w| w.set_key(Key::ENABLE));
        IWDG.pr().write(|w| w.set_pr(prescaler));
        IWDG.rlr().write(|w| w.set_rl(reload));
    });
    // The watchdog adopts the new values after some of its own clock cycles.
    while IWDG.sr().read().pvu() || IWDG.sr().read().rvu() {}
    IWDG.kr().write(|w| w.set_key(Key::RESET));
}
