//! The backup domain, which a cell at VBAT supplies while the main supply is away: memory of 4 KiB, and a calendar clock that a
//! crystal of 32,768 Hz (LSE) drives.
//!
//! The chip's own slow oscillator (LSI) never drives the clock: it stops with the supply, so the clock would report a long
//! absence as a short one. Without the crystal there is no clock.

use embassy_stm32::pac::rcc::vals::Rtcsel;
use embassy_stm32::pac::rtc::regs::{Dr, Tr};
use embassy_stm32::pac::{PWR, RCC, RTC};
use embassy_stm32::rcc::LsConfig;
use shared::device::absence::ClockTime;

/// Keys that open the clock's registers; any other value closes them.
const KEYS: [u8; 2] = [0xCA, 0x53];
const CLOSE: u8 = 0xFF;
/// Looks at a ready bit until it counts as missing: several milliseconds. Those of the clock take two of its cycles, 61 us.
const LOOKS: u32 = 100_000;

/// Configuration with which the start of the clocks leaves a running calendar clock alone. With any other than the present one
/// it stops the clock and clears its time; the memory keeps its content.
pub fn present_configuration() -> LsConfig {
    let control = RCC.bdcr().read();
    let is_driven = control.rtcen() && control.rtcsel() == Rtcsel::LSE;
    if is_driven && control.lseon() && !control.lsebyp() { LsConfig::default_lse() } else { LsConfig::off() }
}

/// Opens the memory and starts the crystal, which may take seconds. Called once, before any access to the memory.
pub fn open() {
    PWR.cr1().modify(|w| w.set_dbp(true));
    RCC.ahb1enr().modify(|w| w.set_bkpsramen(true));
    PWR.csr1().modify(|w| w.set_bre(true));
    // If the regulator fails, the memory works until the supply is lost, and its checksums tell the rest.
    let _ = (0..LOOKS).any(|_| PWR.csr1().read().brr());
    RCC.bdcr().modify(|w| w.set_lseon(true));
}

/// Time of the clock; none if it was not set since it last stopped, or does not run.
pub fn time() -> Option<ClockTime> {
    // After a reset the registers for reading first have to follow the clock.
    if !is_set() || !(0..LOOKS).any(|_| RTC.isr().read().rsf()) {
        return None;
    }
    // In this order: reading the time holds the date until it is read.
    let time = RTC.tr().read().0;
    Some(ClockTime { time, date: RTC.dr().read().0 })
}

/// Whether the clock's crystal runs and its time was set.
fn is_set() -> bool {
    let control = RCC.bdcr().read();
    control.lserdy() && control.rtcen() && control.rtcsel() == Rtcsel::LSE && RTC.isr().read().inits()
}

/// Sets a clock without a time to its first, as soon as the crystal runs; call it again and again while there is no time.
pub fn set_clock() {
    if !RCC.bdcr().read().lserdy() || is_set() {
        return;
    }
    RCC.bdcr().modify(|w| {
        w.set_rtcsel(Rtcsel::LSE);
        w.set_rtcen(true);
    });
    for key in KEYS {
        RTC.wpr().write(|w| w.set_key(key));
    }
    RTC.isr().modify(|w| w.set_init(true));
    // Its dividers for 1 Hz and its format of 24 hours are the defaults of a clock without a time.
    if (0..LOOKS).any(|_| RTC.isr().read().initf()) {
        RTC.tr().write_value(Tr(ClockTime::FIRST.time));
        RTC.dr().write_value(Dr(ClockTime::FIRST.date));
    }
    RTC.isr().modify(|w| w.set_init(false));
    RTC.wpr().write(|w| w.set_key(CLOSE));
}
