//! The board: clocks, pin map, valves.
//!
//! | pin | function | without current |
//! |---|---|---|
//! | PA6 | inspiratory proportional valve, PWM of TIM3 channel 1 | closed |
//! | PB0 | expiratory valve, high closes it | open |
//!
//! Both valves are wired so that the de-energised state is the safe one. The drivers' inputs are pulled low, so the
//! valves are safe as well while the chip is in reset and its pins float.

use embassy_stm32::Config;
use embassy_stm32::gpio::{Level, Output, OutputType, Speed};
use embassy_stm32::peripherals::{PA6, PB0, TIM3};
use embassy_stm32::rcc::{
    AHBPrescaler, APBPrescaler, Hse, HseMode, Pll, PllMul, PllPDiv, PllPreDiv, PllQDiv, PllSource, Sysclk,
};
use embassy_stm32::time::Hertz;
use embassy_stm32::timer::low_level::CountingMode;
use embassy_stm32::timer::simple_pwm::{PwmPin, SimplePwm};
use shared::control::COMMAND_MAX;
use shared::safety::filter::ValveCommand;

/// Clock of the core, and of `SysTick`.
pub const CORE_CLOCK: Hertz = Hertz(168_000_000);
/// The board's crystal. The internal oscillator may be wrong by 1 %, and with it every time of the breath.
const CRYSTAL: Hertz = Hertz(8_000_000);
/// Above hearing, and far above what a solenoid follows.
const PWM_FREQUENCY: Hertz = Hertz(20_000);

/// Both valves.
pub struct Valves {
    inspiratory: SimplePwm<'static, TIM3>,
    expiratory: Output<'static>,
}

/// Starts clocks and valves, the latter safe.
pub fn init() -> (Valves, cortex_m::Peripherals) {
    let mut config = Config::default();
    config.rcc.hse = Some(Hse { freq: CRYSTAL, mode: HseMode::Oscillator });
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
    let chip = embassy_stm32::init(config);
    let core = cortex_m::Peripherals::take().expect("nobody took the core's peripherals before");
    (Valves::new(chip.PA6, chip.PB0, chip.TIM3), core)
}

impl Valves {
    fn new(
        inspiratory: embassy_stm32::Peri<'static, PA6>,
        expiratory: embassy_stm32::Peri<'static, PB0>,
        timer: embassy_stm32::Peri<'static, TIM3>,
    ) -> Self {
        let expiratory = Output::new(expiratory, Level::Low, Speed::Low);
        let pin = PwmPin::new(inspiratory, OutputType::PushPull);
        let up = CountingMode::EdgeAlignedUp;
        let mut inspiratory = SimplePwm::new(timer, Some(pin), None, None, None, PWM_FREQUENCY, up);
        inspiratory.ch1().set_duty_cycle_fully_off();
        inspiratory.ch1().enable();
        Self { inspiratory, expiratory }
    }

    /// Drives the valves; only the safety filter makes such a command.
    pub fn apply(&mut self, command: &ValveCommand) {
        let mut inspiratory = self.inspiratory.ch1();
        // The command lies within 0 to COMMAND_MAX, and the conversion rounds down.
        let duty = command.u_in() / COMMAND_MAX * inspiratory.max_duty_cycle() as f32;
        inspiratory.set_duty_cycle(duty as u32);
        let closed = !command.u_out();
        self.expiratory.set_level(closed.into());
    }
}

/// Puts both valves in their safe state, whatever else has gone wrong.
pub fn force_valves_safe() {
    // SAFETY: called with interrupts off by a program that will not go on, so no owner of the pins runs again.
    let (inspiratory, expiratory) = unsafe { (PA6::steal(), PB0::steal()) };
    // As plain outputs: whatever the timer does no longer reaches the pin.
    for output in
        [Output::new(inspiratory, Level::Low, Speed::Low), Output::new(expiratory, Level::Low, Speed::Low)]
    {
        // Dropping an output would let its pin float.
        core::mem::forget(output);
    }
}
