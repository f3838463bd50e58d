//! Analogue-to-digital converter: the sensors' three channels, converted one after the other in each tick. Fulfils: broken-wire.
//!
//! The injected group of ADC1 takes 14 us. The wait is bounded; a converter that does not finish gives no counts, and the
//! reading is NaN.

use embassy_stm32::adc::{self, AnyAdcChannel, InjectedAdc, SampleTime};
use embassy_stm32::pac::adc::vals::Exten;
use embassy_stm32::peripherals::ADC1;
use embassy_stm32::triggers::TIM1_TRGO;
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
pub struct Adc(InjectedAdc<'static, ADC1, CHANNELS>);

impl Adc {
    /// Starts the converter; [`Self::convert`] returns the counts in the order of the channels.
    pub fn new(converter: Peri<'static, ADC1>, channels: [AnyAdcChannel<'static, ADC1>; CHANNELS]) -> Self {
        let group = channels.map(|channel| (channel, SAMPLE_TIME));
        // No edge starts a conversion, whatever timer is named: the program does.
        Self(adc::Adc::new(converter).setup_injected_conversions(group, TIM1_TRGO, Exten::DISABLED, false))
    }

    /// Converts all channels to counts; none if the converter does not finish in time.
    pub fn convert(&mut self) -> Option<[u16; CHANNELS]> {
        self.0.start_injected_conversions();
        let start = clock::now();
        // Embassy's driver does not say whether a group is finished.
        while !pac::ADC1.sr().read().jeoc() {
            if clock::now().wrapping_sub(start) > TIMEOUT {
                return None;
            }
        }
        Some(self.0.read_injected_samples())
    }
}
