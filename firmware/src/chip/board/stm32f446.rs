//! A Nucleo board with an STM32F446RE: clocks and pin map.
//!
//! | pin | on the board | function | in reset, and in the safe state |
//! |---|---|---|---|
//! | PA0 | A0 | ADC1 channel 0, airway pressure | input |
//! | PA1 | A1 | ADC1 channel 1, pressure at the outlet | input |
//! | PA4 | A2 | ADC1 channel 4, pressure across the flow meter | input |
//! | PB4 | D5 | inspiratory proportional valve, PWM of TIM3 channel 1 | pulled low: closed |
//! | PB10 | D6 | expiratory valve, high closes it | pulled low: open |
//! | PA9, PA10 | D8, D2 | USART1, the link | idle high by pull-up |
//! | PA2, PA3 | USB of the debugger | USART2, the plant line (hardware in the loop only) | idle high by pull-up |

use embassy_stm32::Config;
use embassy_stm32::peripherals::{PA0, PA1, PA2, PA3, PA4, PA9, PA10, PB4, PB10};
use embassy_stm32::rcc::{
    AHBPrescaler, APBPrescaler, Hse, HseMode, Pll, PllMul, PllPDiv, PllPreDiv, PllQDiv, PllSource, Sysclk,
};
use embassy_stm32::time::Hertz;

use super::{LinkParts, Parts, PlantParts, SensorParts, ValveParts};

/// Clock of the core, and of `SysTick`.
pub const CORE_CLOCK: Hertz = Hertz(168_000_000);
/// The debugger's crystal, which the board feeds in.
const CRYSTAL: Hertz = Hertz(8_000_000);

/// Airway pressure.
pub type Airway = PA0;
/// Pressure at the outlet.
pub type Outlet = PA1;
/// Pressure across the flow meter.
pub type Flow = PA4;
/// Inspiratory valve.
pub type Inspiratory = PB4;
/// Expiratory valve.
pub type Expiratory = PB10;
/// Link, from the host.
pub type LinkReceive = PA10;
/// Link, to the host.
pub type LinkTransmit = PA9;
/// Plant line, from the plant.
pub type PlantReceive = PA3;
/// Plant line, to the plant.
pub type PlantTransmit = PA2;

/// Starts the clocks and hands out pins and peripherals.
pub(super) fn start() -> Parts {
    let chip = embassy_stm32::init(clocks());
    Parts {
        sensors: SensorParts { adc: chip.ADC1, airway: chip.PA0, outlet: chip.PA1, flow: chip.PA4 },
        valves: ValveParts { pwm: chip.TIM3, inspiratory: chip.PB4, expiratory: chip.PB10 },
        link: LinkParts { port: chip.USART1, receive: chip.PA10, transmit: chip.PA9 },
        plant: PlantParts { port: chip.USART2, receive: chip.PA3, transmit: chip.PA2 },
        watchdog: chip.IWDG,
        flash: chip.FLASH,
    }
}

fn clocks() -> Config {
    let mut config = Config::default();
    config.rcc.hse = Some(Hse { freq: CRYSTAL, mode: HseMode::Bypass });
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
