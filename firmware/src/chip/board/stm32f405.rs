//! A board with an STM32F405RG: clocks and pin map. The wiring is in docs/HARDWARE.md.
//!
//! | pin | function | in reset, and in the safe state |
//! |---|---|---|
//! | PA0 | ADC1 channel 0, airway pressure | input |
//! | PA1 | ADC1 channel 1, pressure at the outlet | input |
//! | PA4 | ADC1 channel 4, flow | input |
//! | PA6 | inspiratory proportional valve, PWM of TIM3 channel 1 | pulled low: closed |
//! | PB0 | expiratory valve, high closes it | pulled low: open |
//! | PA9, PA10 | USART1, the link | idle high by pull-up |
//! | PA2, PA3 | USART2, the plant line (hardware in the loop only) | idle high by pull-up |

use embassy_stm32::Config;
use embassy_stm32::peripherals::{PA6, PB0};
use embassy_stm32::rcc::{
    AHBPrescaler, APBPrescaler, Hse, HseMode, Pll, PllMul, PllPDiv, PllPreDiv, PllQDiv, PllSource, Sysclk,
};
use embassy_stm32::time::Hertz;

use super::super::drivers::flash::WeightsFlash;
use super::super::drivers::valves::hold_low;
use super::super::drivers::watchdog::Watchdog;
use super::super::drivers::{link_uart, usable};
use super::{Board, SelectedPlant};

/// Clock of the core, and of `SysTick`.
pub const CORE_CLOCK: Hertz = Hertz(168_000_000);
/// The board's crystal. The internal oscillator may be wrong by 1 %, and with it every time of the breath.
const CRYSTAL: Hertz = Hertz(8_000_000);

/// Starts clocks, valves (safe) and the link's line.
pub fn start() -> Board {
    let chip = embassy_stm32::init(clocks());
    let core = usable(cortex_m::Peripherals::take());
    link_uart::start(chip.USART1, chip.PA10, chip.PA9);
    #[cfg(not(feature = "hil"))]
    let plant = {
        use super::super::drivers::adc::Adc;
        use super::super::drivers::valves::Valves;
        let adc = Adc::new(chip.ADC1, chip.PA0, chip.PA1, chip.PA4);
        SelectedPlant::new(adc, Valves::new(chip.TIM3, chip.PA6, chip.PB0))
    };
    #[cfg(feature = "hil")]
    let plant = {
        // No valve hangs on this board, but one that does stays safe.
        force_valves_safe();
        SelectedPlant::new(chip.USART2, chip.PA3, chip.PA2)
    };
    Board { plant, watchdog: Watchdog::new(chip.IWDG), flash: WeightsFlash::new_blocking(chip.FLASH), core }
}

fn clocks() -> Config {
    let mut config = Config::default();
    config.rcc.hse = Some(Hse { freq: CRYSTAL, mode: HseMode::Oscillator });
    config.rcc.pll_src = PllSource::HSE;
    config.rcc.pll = Some(Pll {
        prediv: PllPreDiv::DIV4,
        mul: PllMul::MUL168,
        divp: Some(PllPDiv::DIV2),
        divq: Some(PllQDiv::DIV7),
        divr: None,
    });
    config.rcc.sys = Sysclk::PLL1_P;
    config.rcc.ahb_pre = AHBPrescaler::DIV1;
    config.rcc.apb1_pre = APBPrescaler::DIV4;
    config.rcc.apb2_pre = APBPrescaler::DIV2;
    config
}

/// Puts both valves in their safe state, whatever else has gone wrong.
pub fn force_valves_safe() {
    // SAFETY: called before the drivers of these pins exist, or with interrupts off by a program that will not go on.
    let (inspiratory, expiratory) = unsafe { (PA6::steal(), PB0::steal()) };
    hold_low(inspiratory);
    hold_low(expiratory);
}
