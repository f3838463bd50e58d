//! The sensors' three analogue channels, converted one after the other at the start of each tick.
//!
//! The injected group of ADC1 does it in 14 us. A converter that does not answer costs a bounded time and gives no
//! counts: what was not measured is no number.

use embassy_stm32::adc::{self, AnyAdcChannel, SampleTime};
use embassy_stm32::peripherals::ADC1;
use embassy_stm32::{Peri, pac};

use super::super::board::CORE_CLOCK;
use super::clock;

/// Time for all three conversions, with as much again in reserve, cycles.
const TIMEOUT: u32 = CORE_CLOCK.0 / 1_000_000 * 30;
/// Channels of the injected group.
const CHANNELS: usize = 3;
/// Long enough for a source of 10 kOhm.
const SAMPLE_TIME: SampleTime = SampleTime::CYCLES84;

/// The converter.
pub struct Adc {
    _driver: adc::Adc<'static, ADC1>,
    registers: pac::adc::Adc,
}

/// A channel of the converter, for good.
pub type Channel = AnyAdcChannel<'static, ADC1>;

impl Adc {
    /// Starts the converter; the counts come in the order of the channels.
    pub fn new(converter: Peri<'static, ADC1>, channels: [Channel; CHANNELS]) -> Self {
        let driver = adc::Adc::new(converter);
        configure(channels.map(|channel| channel.get_hw_channel()));
        Self { _driver: driver, registers: pac::ADC1 }
    }

    /// Counts of all channels; none if the converter does not answer.
    pub fn convert(&mut self) -> Option<[u16; CHANNELS]> {
        self.registers.sr().modify(|w| w.set_jeoc(false));
        self.registers.cr2().modify(|w| w.set_jswstart(true));
        let start = clock::now();
        while !self.registers.sr().read().jeoc() {
            if clock::now().wrapping_sub(start) > TIMEOUT {
                return None;
            }
        }
        Some([0, 1, 2].map(|rank| self.registers.jdr(rank).read().jdata()))
    }
}

/// Puts the channels into the injected group.
fn configure(channels: [u8; CHANNELS]) {
    for channel in channels {
        let index = usize::from(channel) % 10;
        if channel >= 10 {
            pac::ADC1.smpr1().modify(|w| w.set_smp(index, SAMPLE_TIME));
        } else {
            pac::ADC1.smpr2().modify(|w| w.set_smp(index, SAMPLE_TIME));
        }
    }
    pac::ADC1.jsqr().modify(|w| {
        w.set_jl(CHANNELS as u8 - 1);
        // A group of three fills the last three of four places.
        for (rank, channel) in channels.into_iter().enumerate() {
            w.set_jsq(rank + 1, channel);
        }
    });
    pac::ADC1.cr1().modify(|w| w.set_scan(true));
}
