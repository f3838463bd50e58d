//! A board with an STM32F405RG: clocks and pin map. docs/HARDWARE.md describes the wiring.
//!
//! | pin | function | in reset, and in the safe state |
//! |---|---|---|
//! | PA0 | ADC1 channel 0, airway pressure | input |
//! | PA1 | ADC1 channel 1, pressure at the outlet | input |
//! | PA4 | ADC1 channel 4, pressure across the flow meter | input |
//! | PA6 | inspiratory proportional valve, PWM of TIM3 channel 1 | pulled low: closed |
//! | PB0 | expiratory valve, high closes it | pulled low: open |
//! | PB12 | silences the sounder while it changes its level in every tick | floats: sounds |
//! | PB13 | red alarm lamp | pulled low: off |
//! | PB14 | yellow alarm lamp | pulled low: off |
//! | PA9, PA10 | USART1, the link | idle high by pull-up |
//! | PA2, PA3 | USART2, the plant line (hardware in the loop only) | idle high by pull-up |

use embassy_stm32::adc::AdcChannel;
use embassy_stm32::peripherals::{PA2, PA3, PA6, PB0};
use embassy_stm32::rcc::{Hse, HseMode};
use embassy_stm32::time::Hertz;

use super::super::drivers::{alarm_outputs::AlarmOutputs, core_clock, link_uart, open_serial};
use super::{Board, PlantPins, plant};

/// The board's crystal. The internal oscillator may be off by 1 %, and all times of the breath with it.
const CRYSTAL: Hertz = Hertz(8_000_000);

/// Inspiratory valve.
pub type Inspiratory = PA6;
/// Expiratory valve.
pub type Expiratory = PB0;

/// Receiving end of the plant line.
pub type PlantReceive = PA3;
/// Sending end of the plant line.
pub type PlantTransmit = PA2;

/// Starts the clocks and passes pins and peripherals to their drivers.
pub(super) fn start() -> Board {
    let (chip, crystal) = core_clock::start(Hse { freq: CRYSTAL, mode: HseMode::Oscillator });
    open_serial(chip.USART1, chip.PA10, chip.PA9);
    link_uart::start();
    let plant = plant::open(PlantPins {
        converter: chip.ADC1,
        channels: [chip.PA0.degrade_adc(), chip.PA1.degrade_adc(), chip.PA4.degrade_adc()],
        pwm: chip.TIM3,
        inspiratory: chip.PA6,
        expiratory: chip.PB0,
        line: chip.USART2,
        receive: chip.PA3,
        transmit: chip.PA2,
    });
    let alarms = AlarmOutputs::new([chip.PB12.into(), chip.PB13.into(), chip.PB14.into()]);
    Board::new(plant, alarms, crystal, chip.IWDG, chip.FLASH)
}
