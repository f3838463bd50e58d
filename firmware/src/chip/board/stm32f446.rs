//! A Nucleo board with an STM32F446RE: clocks and pin map.
//!
//! | pin | on the board | function | in reset, and in the safe state |
//! |---|---|---|---|
//! | PA0 | A0 | ADC1 channel 0, airway pressure | input |
//! | PA1 | A1 | ADC1 channel 1, pressure at the outlet | input |
//! | PA4 | A2 | ADC1 channel 4, pressure across the flow meter | input |
//! | PA6 | D12 | inspiratory proportional valve, PWM of TIM3 channel 1 | pulled low: closed |
//! | PB10 | D6 | expiratory valve, high closes it | pulled low: open |
//! | PA8 | D7 | silences the sounder while it changes its level in every tick | floats: sounds |
//! | PC7 | D9 | red alarm lamp | pulled low: off |
//! | PB6 | D10 | yellow alarm lamp | pulled low: off |
//! | PA9, PA10 | D8, D2 | USART1, the link | idle high by pull-up |
//! | PA2, PA3 | USB of the debugger | USART2, the plant line (hardware in the loop only) | idle high by pull-up |

use embassy_stm32::adc::AdcChannel;
use embassy_stm32::peripherals::{PA2, PA3, PA6, PB10};
use embassy_stm32::rcc::{Hse, HseMode};
use embassy_stm32::time::Hertz;

use super::super::drivers::{alarm_outputs::AlarmOutputs, core_clock, link_uart, open_serial};
use super::{Board, PlantPins, plant};

/// Clock input from the debugger on the board.
const CRYSTAL: Hertz = Hertz(8_000_000);

/// Inspiratory valve: PA6, as on the main board, and not PB4 (D5): that is NJTRST after a reset, with a pull-up of 40 kOhm on
/// the valve's input.
pub type Inspiratory = PA6;
/// Expiratory valve.
pub type Expiratory = PB10;

/// Receiving end of the plant line.
pub type PlantReceive = PA3;
/// Sending end of the plant line.
pub type PlantTransmit = PA2;

/// Starts the clocks and passes pins and peripherals to their drivers.
pub(super) fn start() -> Board {
    let (chip, crystal) = core_clock::start(Hse { freq: CRYSTAL, mode: HseMode::Bypass });
    open_serial(chip.USART1, chip.PA10, chip.PA9);
    link_uart::start();
    let plant = plant::open(PlantPins {
        converter: chip.ADC1,
        channels: [chip.PA0.degrade_adc(), chip.PA1.degrade_adc(), chip.PA4.degrade_adc()],
        pwm: chip.TIM3,
        inspiratory: chip.PA6,
        expiratory: chip.PB10,
        line: chip.USART2,
        receive: chip.PA3,
        transmit: chip.PA2,
    });
    let alarms = AlarmOutputs::new([chip.PA8.into(), chip.PC7.into(), chip.PB6.into()]);
    Board::new(plant, alarms, crystal, chip.IWDG, chip.FLASH)
}
