//! The clock of the core: 168 MHz, from a crystal or, in its place, from the internal oscillator.

use embassy_stm32::rcc::{
    AHBPrescaler, APBPrescaler, Hse, HseMode, Pll, PllMul, PllPDiv, PllPreDiv, PllQDiv, PllSource, Sysclk,
};
use embassy_stm32::time::Hertz;
use embassy_stm32::{Config, Peripherals};

use super::flash::accelerate;
use super::{backup, oscillator};

/// Clock of the core and of `SysTick`.
pub const CORE_CLOCK: Hertz = Hertz(168_000_000);

/// Starts 168 MHz from an 8 MHz crystal or, if it does not start, from the internal oscillator, for chips of
/// the F4 family that allow it; both serial lines' clocks divide to 1 Mbaud. Returns the peripherals, and
/// whether the crystal runs.
pub fn start(crystal: Hse) -> (Peripherals, bool) {
    let runs = oscillator::start_crystal(crystal.mode != HseMode::Oscillator);
    let mut config = Config::default();
    let (source, prediv) = if runs {
        config.rcc.hse = Some(crystal);
        (PllSource::HSE, PllPreDiv::DIV4)
    } else {
        (PllSource::HSI, oscillator::INTERNAL_DIVIDER)
    };
    config.rcc.pll_src = source;
    config.rcc.pll = Some(Pll {
        prediv,
        mul: PllMul::MUL168,
        divp: Some(PllPDiv::DIV2),
        divq: Some(PllQDiv::DIV7),
        divr: None,
    });
    config.rcc.sys = Sysclk::PLL1_P;
    config.rcc.ahb_pre = AHBPrescaler::DIV1;
    config.rcc.apb1_pre = APBPrescaler::DIV4;
    config.rcc.apb2_pre = APBPrescaler::DIV2;
    config.rcc.ls = backup::present_configuration();
    let chip = embassy_stm32::init(config);
    accelerate();
    if runs {
        oscillator::watch();
    }
    (chip, runs)
}
