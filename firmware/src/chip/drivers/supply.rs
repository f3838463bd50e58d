//! The supply voltage: the detector stops the valves while the core still works, and the brown-out reset holds the chip in reset
//! below that. The brown-out level is in the option bytes, which a new chip has set to off. Fulfils: supply-detector.

use embassy_stm32::interrupt::{self, InterruptExt, Priority};
use embassy_stm32::pac::{EXTI, FLASH, PWR};

use super::super::failure;
use super::core_clock::CORE_CLOCK;

/// Threshold of the detector, its highest: 2.9 V.
const DETECTOR_LEVEL: u8 = 7;
/// Line of the detector in the interrupt controller; it rises when the voltage falls.
const DETECTOR_LINE: usize = 16;
/// Time in which the detector settles, 100 us in cycles.
const SETTLING: u32 = CORE_CLOCK.0 / 10_000;

/// Code of the brown-out level 3: reset below 2.7 V.
const BROWN_OUT_LEVEL_3: u8 = 0;
const OPTION_KEYS: [u32; 2] = [0x0819_2A3B, 0x4C5D_6E7F];
/// Read protection with which the option bytes can never be changed.
const SEALED: u8 = 0xCC;
/// Looks at the busy flag until the option bytes count as not programmed, a few seconds.
const LOOKS: u32 = 50_000_000;

/// Whether the supply is sound again, once [`is_low`] has started the detector.
pub fn has_returned() -> bool {
    !PWR.csr1().read().pvdo()
}

/// Starts the detector; true if the voltage is low.
pub fn is_low() -> bool {
    PWR.cr1().modify(|w| {
        w.set_pls(DETECTOR_LEVEL);
        w.set_pvde(true);
    });
    cortex_m::asm::delay(SETTLING);
    PWR.csr1().read().pvdo()
}

/// Enables the detector's interrupt.
pub fn watch() {
    EXTI.rtsr(0).modify(|w| w.set_line(DETECTOR_LINE, true));
    EXTI.pr(0).write(|w| w.set_line(DETECTOR_LINE, true));
    EXTI.imr(0).modify(|w| w.set_line(DETECTOR_LINE, true));
    interrupt::PVD.set_priority(Priority::P0);
    // SAFETY: the handler is defined below, and no critical section of this program masks interrupts by priority.
    unsafe { interrupt::PVD.enable() };
}

#[embassy_stm32::interrupt]
fn PVD() {
    failure::supply_low();
}

/// Whether the brown-out level is the one that the board needs.
pub fn is_brown_out_level_set() -> bool {
    FLASH.optcr().read().bor_lev() == BROWN_OUT_LEVEL_3
}

/// Programs the brown-out level, once; true if it is set afterwards. Only in standby, with a sound supply, and before the
/// detector's interrupt is enabled: a reset in between would leave option bytes that the chip replaces by its defaults.
pub fn set_brown_out_level() -> bool {
    if FLASH.optcr().read().rdp() == SEALED {
        return false;
    }
    for key in OPTION_KEYS {
        FLASH.optkeyr().write_value(key);
    }
    // All other options keep their values.
    FLASH.optcr().modify(|w| w.set_bor_lev(BROWN_OUT_LEVEL_3));
    FLASH.optcr().modify(|w| w.set_optstrt(true));
    let done = (0..LOOKS).any(|_| !FLASH.sr().read().bsy());
    FLASH.optcr().modify(|w| w.set_optlock(true));
    done && is_brown_out_level_set()
}
