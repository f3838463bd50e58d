//! What breathes: sensors and valves at the bedside; with a feature of the crate a plant on a serial line, or a simulated one.

use embassy_stm32::Peri;
use embassy_stm32::adc::AnyAdcChannel;
use embassy_stm32::peripherals::{ADC1, TIM3, USART2};

use super::selected::{Expiratory, Inspiratory, PlantReceive, PlantTransmit};

#[cfg(bedside)]
pub use super::super::drivers::bedside::Bedside as SelectedPlant;
#[cfg(feature = "desk")]
pub use super::super::drivers::desk::Desk as SelectedPlant;
#[cfg(feature = "hil")]
pub use super::super::drivers::plant_line::PlantLine as SelectedPlant;

#[allow(dead_code, reason = "each image uses its own part of them")]
/// The peripherals and pins of sensors, valves and plant line.
pub struct PlantPins {
    pub converter: Peri<'static, ADC1>,
    /// Airway, outlet, flow.
    pub channels: [AnyAdcChannel<'static, ADC1>; 3],
    pub pwm: Peri<'static, TIM3>,
    pub inspiratory: Peri<'static, Inspiratory>,
    pub expiratory: Peri<'static, Expiratory>,
    pub line: Peri<'static, USART2>,
    pub receive: Peri<'static, PlantReceive>,
    pub transmit: Peri<'static, PlantTransmit>,
}

/// Opens what the image was built for.
#[cfg(bedside)]
pub fn open(pins: PlantPins) -> SelectedPlant {
    use super::super::drivers::{adc::Adc, valves::Valves};

    let valves = Valves::new(pins.pwm, pins.inspiratory, pins.expiratory);
    SelectedPlant::new(Adc::new(pins.converter, pins.channels), valves)
}

/// Opens what the image was built for.
#[cfg(feature = "hil")]
pub fn open(pins: PlantPins) -> SelectedPlant {
    super::super::drivers::open_serial(pins.line, pins.receive, pins.transmit);
    SelectedPlant::new()
}

/// Opens what the image was built for.
#[cfg(feature = "desk")]
pub fn open(_pins: PlantPins) -> SelectedPlant {
    SelectedPlant::new()
}
