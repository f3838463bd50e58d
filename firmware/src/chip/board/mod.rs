//! The board: one file per board names its clocks and pins; nothing else knows them. Which one is built is a feature of
//! the crate; docs/PORTING.md says how to add one.

#[cfg(feature = "stm32f405")]
#[path = "stm32f405.rs"]
mod selected;
#[cfg(feature = "stm32f446")]
#[path = "stm32f446.rs"]
mod selected;

use embassy_stm32::peripherals::{ADC1, FLASH, IWDG, TIM3, USART1, USART2};
use embassy_stm32::rcc::{
    AHBPrescaler, APBPrescaler, Hse, Pll, PllMul, PllPDiv, PllPreDiv, PllQDiv, PllSource, Sysclk,
};
use embassy_stm32::{Config, Peri};
use shared::device::control::PlantChange;
use shared::link::messages::DeviceKind;
use shared::safety::filter::ValveCommand;

pub use selected::CORE_CLOCK;
use selected::{
    Airway, Expiratory, Flow, Inspiratory, LinkReceive, LinkTransmit, Outlet, PlantReceive, PlantTransmit,
};

#[cfg(not(feature = "hil"))]
use super::drivers::adc::Adc;
use super::drivers::flash::WeightsFlash;
#[cfg(not(feature = "hil"))]
use super::drivers::valves::Valves;
use super::drivers::valves::hold_low;
use super::drivers::watchdog::Watchdog;
use super::drivers::{link_uart, taken_once};

#[cfg(not(feature = "hil"))]
pub use super::drivers::bedside::Bedside as SelectedPlant;
#[cfg(feature = "hil")]
pub use super::drivers::plant_line::PlantLine as SelectedPlant;

/// Sensors and valves of the control task, or a plant in their place.
pub trait PlantInterface {
    /// Kind of a device with this interface.
    const KIND: DeviceKind;

    /// Airway pressure, cmH2O; NaN if there is none to believe. Takes a bounded time.
    fn read(&mut self, change: &PlantChange) -> f32;

    /// Moves the valves; only the safety filter makes such a command.
    fn drive(&mut self, command: &ValveCommand);
}

/// Peripherals and pins for the drivers.
struct Parts {
    sensors: SensorParts,
    valves: ValveParts,
    link: LinkParts,
    plant: PlantParts,
    watchdog: Peri<'static, IWDG>,
    flash: Peri<'static, FLASH>,
}

/// The converter and its inputs.
#[cfg_attr(feature = "hil", expect(dead_code, reason = "no sensors are read"))]
pub struct SensorParts {
    /// Converter.
    pub adc: Peri<'static, ADC1>,
    /// Airway pressure.
    pub airway: Peri<'static, Airway>,
    /// Pressure at the outlet.
    pub outlet: Peri<'static, Outlet>,
    /// Pressure across the flow meter.
    pub flow: Peri<'static, Flow>,
}

/// The valves' outputs.
#[cfg_attr(feature = "hil", expect(dead_code, reason = "no valves are moved"))]
pub struct ValveParts {
    /// Makes the pulse width.
    pub pwm: Peri<'static, TIM3>,
    /// Inspiratory valve.
    pub inspiratory: Peri<'static, Inspiratory>,
    /// Expiratory valve.
    pub expiratory: Peri<'static, Expiratory>,
}

/// The link's line.
pub struct LinkParts {
    /// Port.
    pub port: Peri<'static, USART1>,
    /// From the host.
    pub receive: Peri<'static, LinkReceive>,
    /// To the host.
    pub transmit: Peri<'static, LinkTransmit>,
}

/// The plant line.
#[cfg_attr(not(feature = "hil"), expect(dead_code, reason = "only with hardware in the loop"))]
pub struct PlantParts {
    /// Port.
    pub port: Peri<'static, USART2>,
    /// From the plant.
    pub receive: Peri<'static, PlantReceive>,
    /// To the plant.
    pub transmit: Peri<'static, PlantTransmit>,
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

/// Starts clocks, valves (safe) and the link's line.
pub fn start() -> Board {
    let Parts { sensors, valves, link, plant, watchdog, flash } = selected::start();
    let core = taken_once(cortex_m::Peripherals::take());
    link_uart::start(link);
    let plant = select(sensors, valves, plant);
    Board { plant, watchdog: Watchdog::new(watchdog), flash: WeightsFlash::new_blocking(flash), core }
}

#[cfg(not(feature = "hil"))]
fn select(sensors: SensorParts, valves: ValveParts, _line: PlantParts) -> SelectedPlant {
    SelectedPlant::new(Adc::new(sensors), Valves::new(valves))
}

#[cfg(feature = "hil")]
fn select(_sensors: SensorParts, _valves: ValveParts, line: PlantParts) -> SelectedPlant {
    // No valve should hang on this board, but one that does stays safe.
    force_valves_safe();
    SelectedPlant::new(line)
}

/// 168 MHz from a crystal of 8 MHz, on any chip of the F4 family; both serial lines' clocks divide to 1 Mbaud.
fn clocks(crystal: Hse) -> Config {
    let mut config = Config::default();
    config.rcc.hse = Some(crystal);
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

/// Puts both valves in their safe state, whatever else has gone wrong.
pub fn force_valves_safe() {
    // SAFETY: called before a driver of these pins exists, or with interrupts off by a program that will not go on.
    let (inspiratory, expiratory) = unsafe { (Inspiratory::steal(), Expiratory::steal()) };
    hold_low(inspiratory);
    hold_low(expiratory);
}
