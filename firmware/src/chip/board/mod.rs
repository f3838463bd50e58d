//! The board: one file per board defines its crystal and pins, which no other code depends on. A feature of the crate selects
//! the board; docs/PORTING.md explains how to add one.

mod plant;
#[cfg(feature = "stm32f405")]
#[path = "stm32f405.rs"]
mod selected;
#[cfg(feature = "stm32f446")]
#[path = "stm32f446.rs"]
mod selected;

use embassy_stm32::Peri;
use embassy_stm32::adc::AnyAdcChannel;
use embassy_stm32::gpio::{AnyPin, Level, Output, Speed};
use embassy_stm32::peripherals::{ADC1, FLASH, IWDG, TIM3, USART2};
use shared::timing::WATCHDOG_US;

pub use selected::{Expiratory, Inspiratory, PlantReceive, PlantTransmit};

use super::drivers::alarm_outputs::AlarmOutputs;
use super::drivers::flash::BoardFlash;
use super::drivers::taken_once;
use super::drivers::watchdog::Watchdog;

pub use plant::SelectedPlant;

/// The peripherals and pins of sensors, valves and plant line.
#[allow(dead_code, reason = "each image uses its own part of them")]
pub struct PlantPins {
    /// Converter of the sensors.
    pub converter: Peri<'static, ADC1>,
    /// Airway, outlet, flow.
    pub channels: [AnyAdcChannel<'static, ADC1>; 3],
    /// Timer of the inspiratory valve's pulses.
    pub pwm: Peri<'static, TIM3>,
    /// Inspiratory valve.
    pub inspiratory: Peri<'static, Inspiratory>,
    /// Expiratory valve.
    pub expiratory: Peri<'static, Expiratory>,
    /// Plant line.
    pub line: Peri<'static, USART2>,
    /// Its receiving end.
    pub receive: Peri<'static, PlantReceive>,
    /// Its sending end.
    pub transmit: Peri<'static, PlantTransmit>,
}

/// A started board: the clocks run, the valves are safe, the link's line is open.
pub struct Board {
    /// Sensors and valves.
    pub plant: SelectedPlant,
    /// Sounder and alarm lamps.
    pub alarms: AlarmOutputs,
    /// The watchdog, not yet started.
    pub watchdog: Watchdog,
    /// The flash with the weights slots and the copies of the flight recorder.
    pub flash: BoardFlash,
    /// Whether the crystal runs; otherwise the internal oscillator.
    pub crystal: bool,
    /// The core's own peripherals.
    pub core: cortex_m::Peripherals,
}

impl Board {
    fn new(
        plant: SelectedPlant,
        alarms: AlarmOutputs,
        crystal: bool,
        watchdog: Peri<'static, IWDG>,
        flash: Peri<'static, FLASH>,
    ) -> Self {
        Self {
            plant,
            alarms,
            watchdog: Watchdog::new(watchdog, WATCHDOG_US),
            flash: BoardFlash::new(flash),
            crystal,
            core: taken_once(cortex_m::Peripherals::take()),
        }
    }
}

/// Starts clocks, valves (safe) and the link's line.
pub fn start() -> Board {
    let board = selected::start();
    if !cfg!(bedside) {
        // No valve should be connected to this board; if one is, it stays safe.
        force_valves_safe();
    }
    board
}

/// Puts both valves in their safe state, after any failure.
pub fn force_valves_safe() {
    // SAFETY: called before a driver of these pins exists, or with interrupts off by a program that does not continue.
    let (inspiratory, expiratory) = unsafe { (Inspiratory::steal(), Expiratory::steal()) };
    let valves: [Peri<'static, AnyPin>; 2] = [inspiratory.into(), expiratory.into()];
    for pin in valves {
        // A dropped output would let its pin float.
        core::mem::forget(Output::new(pin, Level::Low, Speed::Low));
    }
}
