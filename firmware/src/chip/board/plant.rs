//! What breathes: sensors and valves at the bedside; with a feature of the crate a plant on a serial line, or a simulated one.

use super::PlantPins;

#[cfg(bedside)]
pub use super::super::drivers::bedside::Bedside as SelectedPlant;
#[cfg(feature = "desk")]
pub use super::super::drivers::desk::Desk as SelectedPlant;
#[cfg(feature = "hil")]
pub use super::super::drivers::plant_line::PlantLine as SelectedPlant;

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
