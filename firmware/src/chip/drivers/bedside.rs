//! The ventilator's real sensors and valves.

use shared::device::control::PlantChange;
use shared::link::messages::DeviceKind;
use shared::safety::filter::ValveCommand;
use shared::sensor::{Counts, Readings};

use super::adc::Adc;
use super::plant_interface::PlantInterface;
use super::valves::Valves;

/// Sensors and valves of the board.
pub struct Bedside {
    adc: Adc,
    valves: Valves,
}

impl Bedside {
    /// Combines the drivers of a board.
    pub fn new(adc: Adc, valves: Valves) -> Self {
        Self { adc, valves }
    }
}

impl PlantInterface for Bedside {
    const KIND: DeviceKind = DeviceKind::Ventilator;

    fn read(&mut self, _cue: &PlantChange) -> Readings {
        match self.adc.convert() {
            Some([airway, outlet, flow]) => Counts { airway, outlet, flow }.into(),
            None => f32::NAN.into(),
        }
    }

    fn drive(&mut self, command: &ValveCommand) {
        self.valves.apply(command);
    }
}
