//! The board: one file per board defines its clocks and pins, which no other code depends on. A feature of the crate selects
//! the board; docs/PORTING.md explains how to add one.

#[cfg(feature = "stm32f405")]
#[path = "stm32f405.rs"]
mod selected;
#[cfg(feature = "stm32f446")]
#[path = "stm32f446.rs"]
mod selected;

use embassy_stm32::gpio::{AnyPin, Level, Output, Speed};
use embassy_stm32::peripherals::{FLASH, IWDG};
use embassy_stm32::rcc::{
    AHBPrescaler, APBPrescaler, Hse, HseMode, Pll, PllMul, PllPDiv, PllPreDiv, PllQDiv, PllSource, Sysclk,
};
use embassy_stm32::{Config, Peri, Peripherals};
use shared::device::control::PlantChange;
use shared::link::messages::DeviceKind;
use shared::safety::filter::ValveCommand;
use shared::sensor::Readings;
use shared::timing::WATCHDOG_US;

pub use selected::{CORE_CLOCK, Expiratory, Inspiratory};

use super::drivers::alarm_outputs::AlarmOutputs;
use super::drivers::flash::{BoardFlash, accelerate};
use super::drivers::watchdog::Watchdog;
use super::drivers::{backup, oscillator, taken_once};

#[cfg(not(feature = "hil"))]
pub use super::drivers::bedside::Bedside as SelectedPlant;
#[cfg(feature = "hil")]
pub use super::drivers::plant_line::PlantLine as SelectedPlant;

/// Interface of the control task to sensors and valves, or to a plant in their place.
pub trait PlantInterface {
    /// Kind of a device with this interface.
    const KIND: DeviceKind;

    /// Reads the sensors. Takes a bounded time.
    fn read(&mut self, change: &PlantChange) -> Readings;

    /// Drives the valves; only the safety filter can make a command.
    fn drive(&mut self, command: &ValveCommand);
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
    if cfg!(feature = "hil") {
        // No valve should be connected to this board; if one is, it stays safe.
        force_valves_safe();
    }
    board
}

/// Starts 168 MHz from an 8 MHz crystal or, if it does not start, from the internal oscillator, for chips of the F4 family that
/// allow it; both serial lines' clocks divide to 1 Mbaud. Returns the peripherals, and whether the crystal runs.
fn start_clocks(crystal: Hse) -> (Peripherals, bool) {
    let runs = oscillator::start_crystal(crystal.mode != HseMode::Oscillator);
    let mut config = Config::default();
    let (source, prediv) = if runs {
        config.rcc.hse = Some(crystal);
        (PllSource::HSE, PllPreDiv::DIV4)
    } else {
        (PllSource::HSI, oscillator::INTERNAL_DIVIDER)
    };
    config.rcc.pll_src = source;
    config.rcc.pll = Some(Pll {
        prediv,
        mul: PllMul::MUL168,
        divp: Some(PllPDiv::DIV2),
        divq: Some(PllQDiv::DIV7),
        divr: None,
    });
    config.rcc.sys = Sysclk::PLL1_P;
    config.rcc.ahb_pre = AHBPrescaler::DIV1;
    config.rcc.apb1_pre = APBPrescaler::DIV4;
    config.rcc.apb2_pre = APBPrescaler::DIV2;
    config.rcc.ls = backup::present_configuration();
    let chip = embassy_stm32::init(config);
    accelerate();
    if runs {
        oscillator::watch();
    }
    (chip, runs)
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
