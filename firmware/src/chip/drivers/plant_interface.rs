//! What the control task needs of sensors and valves, or of a plant in their place.

use shared::device::control::PlantChange;
use shared::link::messages::DeviceKind;
use shared::safety::filter::ValveCommand;
use shared::sensor::Readings;

/// Interface of the control task to sensors and valves, or to a plant in their place.
pub trait PlantInterface {
    /// Kind of a device with this interface.
    const KIND: DeviceKind;

    /// Reads the sensors. Takes a bounded time.
    fn read(&mut self, change: &PlantChange) -> Readings;

    /// Drives the valves; only the safety filter can make a command.
    fn drive(&mut self, command: &ValveCommand);
}
