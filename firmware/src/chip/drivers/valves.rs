//! Both valves: the proportional inspiratory valve by PWM, the expiratory on/off valve by a level. Fulfils: tick-watchdog.
//!
//! They are wired so that the de-energised state is the safe one (inspiratory closed, expiratory open). The inputs of their
//! power stages are pulled low, so that they are also safe while the chip is in reset and its pins float.

use embassy_stm32::Peri;
use embassy_stm32::gpio::{Level, Output, OutputType, Pin, Speed};
use embassy_stm32::peripherals::TIM3;
use embassy_stm32::time::Hertz;
use embassy_stm32::timer::low_level::CountingMode;
use embassy_stm32::timer::simple_pwm::{PwmPin, SimplePwm};
use embassy_stm32::timer::{Ch1, TimerPin};
use shared::control::COMMAND_MAX;
use shared::safety::filter::ValveCommand;

/// Above the audible range, and far above the bandwidth of a solenoid.
const PWM_FREQUENCY: Hertz = Hertz(20_000);

/// Both valves.
pub struct Valves {
    inspiratory: SimplePwm<'static, TIM3>,
    expiratory: Output<'static>,
}

impl Valves {
    /// Both valves in their safe state, on a board's pins `I` (inspiratory) and `E` (expiratory).
    pub fn new<I: TimerPin<TIM3, Ch1>, E: Pin>(
        pwm: Peri<'static, TIM3>,
        inspiratory: Peri<'static, I>,
        expiratory: Peri<'static, E>,
    ) -> Self {
        let expiratory = Output::new(expiratory, Level::Low, Speed::Low);
        let pin = PwmPin::new(inspiratory, OutputType::PushPull);
        let up = CountingMode::EdgeAlignedUp;
        let mut inspiratory = SimplePwm::new(pwm, Some(pin), None, None, None, PWM_FREQUENCY, up);
        inspiratory.ch1().set_duty_cycle_fully_off();
        inspiratory.ch1().enable();
        Self { inspiratory, expiratory }
    }

    /// Drives the valves; only the safety filter can make a command.
    ///
    /// Never inlined, so that a debugger can stop at every command (the tests of the image do).
    #[inline(never)]
    pub fn apply(&mut self, command: &ValveCommand) {
        let mut inspiratory = self.inspiratory.ch1();
        // The command is within 0 to COMMAND_MAX, and the conversion rounds down.
        let duty = command.u_in() / COMMAND_MAX * inspiratory.max_duty_cycle() as f32;
        inspiratory.set_duty_cycle(duty as u32);
        let closed = !command.u_out();
        self.expiratory.set_level(closed.into());
    }
}
