//! The crystal, and the internal oscillator (HSI, 16 MHz) in its place. Fulfils: crystal.
//!
//! The PLL makes the same core clock from either. The internal oscillator may be off by 1 % at room temperature and by several
//! percent in the heat, and all times of the breath with it, but ventilation continues.

use core::sync::atomic::{AtomicBool, Ordering};

use cortex_m_rt::exception;
use embassy_stm32::pac::RCC;
use embassy_stm32::rcc::{PllPreDiv, PllSource, Sysclk};

/// Divides the internal oscillator to the PLL's input of 2 MHz.
pub const INTERNAL_DIVIDER: PllPreDiv = PllPreDiv::DIV8;
/// Cycles of the internal oscillator between two looks at the crystal, 100 us.
const LOOK_CYCLES: u32 = 1_600;
/// Looks at the crystal until it counts as missing: 100 ms, many times the start of a sound one.
const LOOKS: u32 = 1_000;
/// Looks at a ready bit of the clock until the switch counts as failed, far above the PLL's 0.3 ms.
const SWITCH_LOOKS: u32 = 100_000;

/// Whether the crystal has stopped while it was in use.
static LOST: AtomicBool = AtomicBool::new(false);

/// Starts the crystal, or the external clock if `bypass` is set; false if it does not start in time. Called on the internal
/// oscillator, on which the chip starts.
pub fn start_crystal(bypass: bool) -> bool {
    RCC.cr().modify(|w| w.set_hsebyp(bypass));
    RCC.cr().modify(|w| w.set_hseon(true));
    let started = (0..LOOKS).any(|_| {
        cortex_m::asm::delay(LOOK_CYCLES);
        RCC.cr().read().hserdy()
    });
    if !started {
        RCC.cr().modify(|w| w.set_hseon(false));
    }
    started
}

/// Enables the clock security system: if the crystal stops, the chip switches to the internal oscillator, without the PLL, and
/// raises the interrupt below.
pub fn watch() {
    RCC.cr().modify(|w| w.set_csson(true));
}

#[exception]
unsafe fn NonMaskableInt() {
    // Otherwise the interrupt would be raised again and again.
    RCC.cir().modify(|w| w.set_cssc(true));
    LOST.store(true, Ordering::Relaxed);
}

/// Restores the core clock from the internal oscillator if the crystal has stopped; true in that case.
///
/// # Panics
/// The PLL does not start: then the chip restarts.
pub fn recover() -> bool {
    if !LOST.load(Ordering::Relaxed) {
        return false;
    }
    LOST.store(false, Ordering::Relaxed);
    RCC.cfgr().modify(|w| w.set_sw(Sysclk::HSI));
    until(|| RCC.cfgr().read().sws() == Sysclk::HSI);
    RCC.cr().modify(|w| w.set_pllon(false));
    until(|| !RCC.cr().read().pllrdy());
    RCC.pllcfgr().modify(|w| {
        w.set_pllsrc(PllSource::HSI);
        w.set_pllm(INTERNAL_DIVIDER);
    });
    RCC.cr().modify(|w| w.set_pllon(true));
    until(|| RCC.cr().read().pllrdy());
    RCC.cfgr().modify(|w| w.set_sw(Sysclk::PLL1_P));
    until(|| RCC.cfgr().read().sws() == Sysclk::PLL1_P);
    true
}

fn until(ready: impl Fn() -> bool) {
    assert!((0..SWITCH_LOOKS).any(|_| ready()), "the crystal has stopped and the internal oscillator fails");
}
