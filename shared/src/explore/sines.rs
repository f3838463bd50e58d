//! A sweep of sines in the command, breath by breath, from which a host computes the gain of the loop.
//!
//! The control law is told the command that it would have had without the sine: the loop is broken at the valve, and the ratio of
//! the commands before and after the sine is the loop gain with a minus sign, whatever the law does. Several breaths have the same
//! frequency; their phases divide a turn evenly, so that what is the same in every breath cancels in their mean. Like a random
//! perturbation, a sine depends only on the parameters and the breath's number, so device and host know it alike.

use serde::{Deserialize, Serialize};
use thiserror::Error;

use crate::breath::period_s;
use crate::math;

/// Highest amplitude, percent: it suffices beside the play of a valve, and a quick and stiff lung stays below the pressure limit.
/// The self-test opens the valve as far.
pub const AMPLITUDE_MAX: f32 = 20.0;
/// Bounds of all frequencies, Hz.
pub const FREQUENCY_BOUNDS: (f32, f32) = (0.2, 50.0);
/// Most frequencies, and most breaths at each.
pub const COUNT_MAX: u8 = 64;

/// A sweep of sines.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct SineSweep {
    /// Amplitude, percent of the command.
    pub amplitude: f32,
    /// First frequency, Hz.
    pub lowest_hz: f32,
    /// Ratio of each frequency to the one before.
    pub ratio: f32,
    /// Number of frequencies.
    pub frequencies: u8,
    /// Number of breaths at each frequency.
    pub phases: u8,
    /// Number of the first breath with a sine.
    pub first_breath: u32,
    /// Start of the sine within a breath, s; it lasts until the end of the inspiration.
    pub from_s: f32,
}

/// A bounded quantity of a [`SineSweep`]. The order of the variants is part of the link's protocol: append only.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum SweepQuantity {
    /// [`SineSweep::amplitude`].
    Amplitude,
    /// [`SineSweep::lowest_hz`].
    Lowest,
    /// [`SineSweep::ratio`].
    Ratio,
    /// The last frequency.
    Highest,
    /// [`SineSweep::frequencies`].
    Frequencies,
    /// [`SineSweep::phases`].
    Phases,
    /// [`SineSweep::from_s`].
    From,
}

impl SweepQuantity {
    /// Name, as printed.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Amplitude => "amplitude",
            Self::Lowest => "lowest frequency",
            Self::Ratio => "ratio of neighbouring frequencies",
            Self::Highest => "highest frequency",
            Self::Frequencies => "number of frequencies",
            Self::Phases => "number of breaths at a frequency",
            Self::From => "start within the breath",
        }
    }

    /// Unit, as printed.
    pub const fn unit(self) -> &'static str {
        match self {
            Self::Amplitude => "%",
            Self::Lowest | Self::Highest => "Hz",
            Self::Ratio | Self::Frequencies | Self::Phases => "",
            Self::From => "s",
        }
    }

    /// Lowest and highest accepted value.
    pub const fn bounds(self) -> (f32, f32) {
        match self {
            Self::Amplitude => (0.0, AMPLITUDE_MAX),
            Self::Lowest | Self::Highest => FREQUENCY_BOUNDS,
            Self::Ratio => (1.0, 4.0),
            Self::Frequencies => (1.0, COUNT_MAX as f32),
            // With fewer, what is the same in every breath does not cancel.
            Self::Phases => (3.0, COUNT_MAX as f32),
            Self::From => (0.0, 5.0),
        }
    }
}

/// Why a sweep is refused.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Error)]
#[error(
    "the sine's {} is {value} {unit}, allowed are {} to {} {unit}",
    .quantity.name(), .quantity.bounds().0, .quantity.bounds().1, unit = .quantity.unit()
)]
pub struct SweepError {
    /// The quantity that is out of bounds.
    pub quantity: SweepQuantity,
    /// Its value.
    pub value: f32,
}

impl SineSweep {
    /// Checks all values.
    ///
    /// # Errors
    /// The first value out of bounds.
    pub fn validate(&self) -> Result<(), SweepError> {
        let checked = |quantity: SweepQuantity, value: f32| {
            let (min, max) = quantity.bounds();
            // In this form a NaN fails too.
            if value >= min && value <= max { Ok(()) } else { Err(SweepError { quantity, value }) }
        };
        checked(SweepQuantity::Amplitude, self.amplitude)?;
        checked(SweepQuantity::Lowest, self.lowest_hz)?;
        checked(SweepQuantity::Ratio, self.ratio)?;
        checked(SweepQuantity::Frequencies, f32::from(self.frequencies))?;
        checked(SweepQuantity::Phases, f32::from(self.phases))?;
        checked(SweepQuantity::From, self.from_s)?;
        checked(SweepQuantity::Highest, self.hz(self.frequencies - 1))
    }

    /// Frequency with this number, Hz.
    pub fn hz(&self, number: u8) -> f32 {
        (0..number).fold(self.lowest_hz, |hz, _| hz * self.ratio)
    }

    /// Number of breaths with a sine.
    pub fn breaths(&self) -> u32 {
        u32::from(self.frequencies) * u32::from(self.phases)
    }

    /// Whether all breaths with a sine come before the one with this number.
    pub fn has_ended(&self, breath: u32) -> bool {
        breath.checked_sub(self.first_breath).is_some_and(|since| since >= self.breaths())
    }

    /// Numbers of the frequency and of the phase in the breath with this number; none before and after the sweep.
    pub fn place(&self, breath: u32) -> Option<(u8, u8)> {
        let since = breath.checked_sub(self.first_breath).filter(|_| !self.has_ended(breath))?;
        let phases = u32::from(self.phases);
        Some(((since / phases) as u8, (since % phases) as u8))
    }

    /// Sine of the breath with this number; none before and after the sweep.
    pub fn sine(&self, breath: u32, period_us: u32) -> Option<Sine> {
        let (frequency, phase) = self.place(breath)?;
        Some(Sine {
            amplitude: self.amplitude,
            step: self.hz(frequency) * period_s(period_us),
            phase: f32::from(phase) / f32::from(self.phases),
            from: math::ticks(self.from_s, period_us),
        })
    }
}

/// The sine of a breath.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sine {
    amplitude: f32,
    /// Turns in a tick.
    step: f32,
    /// Turns at the start.
    phase: f32,
    /// First tick.
    from: u32,
}

impl Sine {
    /// Command to add at `tick` of the breath, percent.
    #[inline]
    pub fn at(&self, tick: u32) -> f32 {
        tick.checked_sub(self.from).map_or(0.0, |ticks| self.amplitude * math::sine(self.turns(ticks)))
    }

    /// Angle at `tick` of the breath, turns; none before the start.
    pub fn angle(&self, tick: u32) -> Option<f32> {
        tick.checked_sub(self.from).map(|ticks| self.turns(ticks))
    }

    #[inline]
    fn turns(&self, ticks: u32) -> f32 {
        self.phase + ticks as f32 * self.step
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::breath::DEFAULT_PERIOD_US;
    use core::f64::consts::TAU;
    use proptest::prelude::*;
    use std::string::ToString;
    use std::vec::Vec;

    fn sweep() -> SineSweep {
        SineSweep {
            amplitude: 10.0,
            lowest_hz: 2.0,
            ratio: 1.5,
            frequencies: 3,
            phases: 4,
            first_breath: 5,
            from_s: 0.3,
        }
    }

    #[test]
    fn frequency_follows_frequency_and_the_phases_divide_a_turn() {
        let places: Vec<_> = (0..20).map(|breath| sweep().place(breath)).collect();
        assert_eq!(places[..5], [None; 5]);
        assert_eq!((places[5], places[8], places[9]), (Some((0, 0)), Some((0, 3)), Some((1, 0))));
        assert_eq!((places[16], places[17]), (Some((2, 3)), None));
        assert_eq!([0, 1, 2].map(|number| sweep().hz(number).to_bits()), [2.0, 3.0, 4.5].map(f32::to_bits));
        for breath in 5..17 {
            let sine = sweep().sine(breath, DEFAULT_PERIOD_US).unwrap();
            let (frequency, phase) = sweep().place(breath).unwrap();
            let hz = f64::from(sweep().hz(frequency));
            assert!((0..300).all(|tick| sine.at(tick) == 0.0 && sine.angle(tick).is_none()));
            for tick in 300..3000 {
                let turns = 1e-3 * hz * f64::from(tick - 300) + 0.25 * f64::from(phase);
                assert!((f64::from(sine.at(tick)) - 10.0 * (TAU * turns).sin()).abs() < 1e-3, "{tick}");
                assert!((f64::from(sine.angle(tick).unwrap()) - turns).abs() < 1e-4, "{tick}");
            }
        }
    }

    #[test]
    fn a_sine_that_would_exceed_a_limit_is_refused_with_it() {
        assert_eq!(sweep().validate(), Ok(()));
        let too_high = SineSweep { amplitude: 30.0, ..sweep() }.validate().unwrap_err();
        assert_eq!(too_high.to_string(), "the sine's amplitude is 30 %, allowed are 0 to 20 %");
        for (wrong, quantity) in [
            (SineSweep { amplitude: f32::NAN, ..sweep() }, SweepQuantity::Amplitude),
            (SineSweep { amplitude: -1.0, ..sweep() }, SweepQuantity::Amplitude),
            (SineSweep { lowest_hz: 0.1, ..sweep() }, SweepQuantity::Lowest),
            (SineSweep { ratio: 0.9, ..sweep() }, SweepQuantity::Ratio),
            (SineSweep { frequencies: 0, ..sweep() }, SweepQuantity::Frequencies),
            (SineSweep { phases: 2, ..sweep() }, SweepQuantity::Phases),
            (SineSweep { from_s: -0.1, ..sweep() }, SweepQuantity::From),
            (SineSweep { lowest_hz: 20.0, ratio: 2.0, ..sweep() }, SweepQuantity::Highest),
        ] {
            assert_eq!(wrong.validate().unwrap_err().quantity, quantity, "{wrong:?}");
        }
    }

    proptest! {
        #[test]
        fn no_sine_exceeds_its_amplitude(
            amplitude in 0.0f32..20.0, hz in 0.2f32..50.0, breath: u32, tick: u32, first_breath in 0u32..100,
        ) {
            let sweep = SineSweep { amplitude, lowest_hz: hz, ratio: 1.0, first_breath, ..sweep() };
            let sine = sweep.sine(first_breath + breath % sweep.breaths(), DEFAULT_PERIOD_US).unwrap();
            prop_assert!(sine.at(tick).abs() <= amplitude * 1.00001);
        }
    }
}
