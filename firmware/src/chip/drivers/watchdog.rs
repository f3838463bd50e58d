//! The independent watchdog: it restarts a chip whose control tick does not end.

use embassy_stm32::pac::IWDG;
use embassy_stm32::pac::iwdg::vals::{Key, Pr};
use embassy_stm32::peripherals;
use embassy_stm32::wdg::IndependentWatchdog;

/// Longest tick before the chip restarts, microseconds. The watchdog's oscillator is off by up to a factor
/// of two, so that this is 25 to 100 ms.
pub const TIMEOUT_US: u32 = 50_000;
/// Frequency of the watchdog's oscillator, Hz.
const OSCILLATOR: u32 = 32_000;
/// Prescaler of the long timeout.
const LONG_TIMEOUT_PRESCALER: Pr = Pr::DIVIDE_BY256;
/// Reload value of the long timeout: 16 s, for erasing a sector takes up to 4 s.
const LONG_TIMEOUT_RELOAD: u16 = (16 * OSCILLATOR / 256 - 1) as u16;

/// The watchdog. Once unleashed nothing but a reset stops it; it is fed once per tick, last.
pub type Watchdog = IndependentWatchdog<'static, peripherals::IWDG>;

/// Runs something that stalls the core for seconds, such as erasing flash, under a long timeout. Only in standby.
pub fn with_long_timeout<T>(work: impl FnOnce() -> T) -> T {
    let (prescaler, reload) = (IWDG.pr().read().pr(), IWDG.rlr().read().rl());
    set(LONG_TIMEOUT_PRESCALER, LONG_TIMEOUT_RELOAD);
    let result = work();
    set(prescaler, reload);
    result
}

fn set(prescaler: Pr, reload: u16) {
    // Together: a tick that fed the watchdog in between would lock the registers again.
    cortex_m::interrupt::free(|_| {
        IWDG.kr().write(|w| w.set_key(Key::ENABLE));
        IWDG.pr().write(|w| w.set_pr(prescaler));
        IWDG.rlr().write(|w| w.set_rl(reload));
    });
    // The watchdog takes the new values over in its own time.
    while IWDG.sr().read().pvu() || IWDG.sr().read().rvu() {}
    IWDG.kr().write(|w| w.set_key(Key::RESET));
}
