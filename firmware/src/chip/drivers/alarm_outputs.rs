//! Sounder and alarm lamps. Fulfils: lamps-and-sounder.
//!
//! The sounder has no output that makes it sound: it sounds unless the program silences it in every tick, by a change of level
//! of its line. So it also sounds if the chip is in reset or dead, if the program hangs, and if the line breaks.
//! docs/HARDWARE.md describes the circuit.

use embassy_stm32::Peri;
use embassy_stm32::gpio::{AnyPin, Level, Output, Speed};
use shared::device::annunciator::Signals;

/// The pins of sounder and lamps.
pub struct AlarmOutputs {
    silence: Output<'static>,
    red: Output<'static>,
    yellow: Output<'static>,
    shown: Signals,
}

impl AlarmOutputs {
    /// The pins of sounder, red and yellow lamp. The lamps are off, and the sounder sounds until the first tick.
    pub fn new(pins: [Peri<'static, AnyPin>; 3]) -> Self {
        let [silence, red, yellow] = pins.map(|pin| Output::new(pin, Level::Low, Speed::Low));
        Self { silence, red, yellow, shown: Signals::default() }
    }

    /// Drives the outputs; once per tick, together with the watchdog. Not inlined, so that a debugger can halt in each tick, and
    /// at each change.
    #[inline(never)]
    pub fn apply(&mut self, signals: Signals) {
        if !signals.sounder {
            self.silence.toggle();
        }
        if signals != self.shown {
            self.show(signals);
        }
    }

    #[inline(never)]
    fn show(&mut self, signals: Signals) {
        self.red.set_level(signals.red.into());
        self.yellow.set_level(signals.yellow.into());
        self.shown = signals;
    }
}
