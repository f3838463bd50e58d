//! The board: one file per board names its pins and clocks; the drivers do not know it.
//!
//! A board file gives [`CORE_CLOCK`](stm32f405::CORE_CLOCK) and `start`, which makes a [`Board`]. Which one is built is a
//! feature of the crate; docs/PORTING.md says how to add one.

#[cfg(feature = "stm32f405")]
mod stm32f405;
#[cfg(feature = "stm32f446")]
mod stm32f446;

#[cfg(feature = "stm32f405")]
pub use stm32f405::{CORE_CLOCK, force_valves_safe, start};
#[cfg(feature = "stm32f446")]
pub use stm32f446::{CORE_CLOCK, force_valves_safe, start};

use shared::device::control::Cue;
use shared::link::messages::DeviceKind;
use shared::safety::filter::ValveCommand;

use super::drivers::flash::WeightsFlash;
use super::drivers::watchdog::Watchdog;

#[cfg(not(feature = "hil"))]
pub use super::drivers::bedside::Bedside as SelectedPlant;
#[cfg(feature = "hil")]
pub use super::drivers::plant_line::PlantLine as SelectedPlant;

/// What the control task breathes with: sensors and valves, or what takes their place.
pub trait Plant {
    /// What a device with this plant is.
    const KIND: DeviceKind;

    /// Airway pressure, cmH2O; NaN if there is none to believe. Takes a bounded time.
    fn read(&mut self, cue: &Cue) -> f32;

    /// Moves the valves; only the safety filter makes such a command.
    fn drive(&mut self, command: &ValveCommand);
}

/// A started board: clocks run, the valves are safe, the link's line is open.
pub struct Board {
    /// Sensors and valves.
    pub plant: SelectedPlant,
    /// Not yet running.
    pub watchdog: Watchdog,
    /// Holds the weights slots.
    pub flash: WeightsFlash,
    /// The core's own peripherals.
    pub core: cortex_m::Peripherals,
}
