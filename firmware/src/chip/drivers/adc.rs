//! Analogue-to-digital converter: the sensors' three channels, converted one after the other in each tick.
//!
//! The injected group of ADC1 takes 14 us. The wait is bounded; a converter that does not finish gives no counts, and the
//! reading is NaN.

use embassy_stm32::adc::{self, AnyAdcChannel, SampleTime};
use embassy_stm32::peripherals::ADC1;
use embassy_stm32::{Peri, pac};

use super::clock;
use super::core_clock::CORE_CLOCK;

/// Timeout for all three conversions, twice their duration, cycles.
const TIMEOUT: u32 = CORE_CLOCK.0 / 1_000_000 * 30;
/// Channels of the injected group.
const CHANNELS: usize = 3;
/// Long enough for a source impedance of 10 kOhm.
const SAMPLE_TIME: SampleTime = SampleTime::CYCLES84;

/// The converter.
pub struct Adc {
    _driver: adc::Adc<'static, ADC1>,
    registers: pac::adc::Adc,
}

impl Adc {
    /// Starts the converter; [`Self::convert`] returns the counts in the order of the channels.
    pub fn new(converter: Peri<'static, ADC1>, channels: [AnyAdcChannel<'static, ADC1>; CHANNELS]) -> Self {
        let driver = adc::Adc::new(converter);
        configure(channels.map(|channel| channel.get_hw_channel()));
        Self { _driver: driver, registers: pac::ADC1 }
    }

    /// Converts all channels to counts; none if the converter does not finish in time.
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

/// Configures the channels as the injected group.
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
        // A group of three uses the last three of the four positions.
        for (rank, channel) in channels.into_iter().enumerate() {
            w.set_jsq(rank + 1, channel);
        }
    });
    pac::ADC1.cr1().modify(|w| w.set_scan(true));
}
