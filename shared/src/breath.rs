//! The breath: its timing in control ticks and its target pressure.
//!
//! A breath is an inspiration at PIP (peak inspiratory pressure), a linear fall, and an expiration at PEEP (positive
//! end-expiratory pressure). Here too: the paper's six waveforms and the pressure-control rows of the test standard.

use serde::{Deserialize, Serialize};

use crate::math;
use crate::settings::{Settings, SettingsError};

/// Default control period, microseconds.
pub const DEFAULT_PERIOD_US: u32 = 1000;
/// Shortest and longest control period accepted, microseconds.
pub const PERIOD_BOUNDS_US: (u32, u32) = (250, 50_000);

/// Peak pressures of the paper's six waveforms, cmH2O (Suo et al. 2021, section 5).
pub const PAPER_PIPS: [f32; 6] = [10.0, 15.0, 20.0, 25.0, 30.0, 35.0];

/// Phase of a breath.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Phase {
    /// The controller drives gas into the lung; the expiratory valve is closed.
    Inspiration,
    /// The target falls from PIP to PEEP; the expiratory valve is open.
    Fall,
    /// The target is PEEP; the expiratory valve is open.
    Expiration,
}

/// A breath built from validated settings, with times in ticks.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Breath {
    settings: Settings,
    period_us: u32,
    rise_ticks: u32,
    inspiration_ticks: u32,
    fall_ticks: u32,
    total_ticks: u32,
}

impl Breath {
    /// Builds a breath at a control period in microseconds.
    ///
    /// # Errors
    /// An error of [`Settings::validate`], or a control period outside [`PERIOD_BOUNDS_US`].
    pub fn new(settings: &Settings, period_us: u32) -> Result<Self, SettingsError> {
        settings.validate()?;
        if period_us < PERIOD_BOUNDS_US.0 || period_us > PERIOD_BOUNDS_US.1 {
            return Err(SettingsError::Period { period_us });
        }
        let inspiration_ticks = math::ticks(settings.inspiratory_time, period_us);
        let fall_ticks = math::ticks(settings.fall_time, period_us);
        let total_ticks = math::ticks(60.0 / settings.rate, period_us).max(inspiration_ticks + fall_ticks);
        let rise_ticks = math::ticks(settings.rise_time, period_us).min(inspiration_ticks);
        debug_assert!(inspiration_ticks > 0 && inspiration_ticks + fall_ticks <= total_ticks);
        Ok(Self { settings: *settings, period_us, rise_ticks, inspiration_ticks, fall_ticks, total_ticks })
    }

    /// Settings from which the breath was built.
    pub fn settings(&self) -> &Settings {
        &self.settings
    }

    /// Control period, microseconds.
    pub fn period_us(&self) -> u32 {
        self.period_us
    }

    /// Control period, seconds.
    pub fn period_s(&self) -> f32 {
        period_s(self.period_us)
    }

    /// Length of the inspiration, ticks.
    pub fn inspiration_ticks(&self) -> u32 {
        self.inspiration_ticks
    }

    /// Length of the rise from PEEP to PIP, ticks.
    pub fn rise_ticks(&self) -> u32 {
        self.rise_ticks
    }

    /// Length of the whole breath, ticks.
    pub fn total_ticks(&self) -> u32 {
        self.total_ticks
    }

    /// The moment at a tick, counted from the start of the breath.
    #[inline]
    pub fn at(&self, tick: u32) -> Moment<'_> {
        Moment { breath: self, tick, phase: self.phase(tick) }
    }

    /// Phase at a tick, counted from the start of the breath.
    pub fn phase(&self, tick: u32) -> Phase {
        if tick < self.inspiration_ticks {
            Phase::Inspiration
        } else if tick - self.inspiration_ticks < self.fall_ticks {
            Phase::Fall
        } else {
            Phase::Expiration
        }
    }

    /// Target pressure at a tick, counted from the start of the breath, cmH2O.
    pub fn target(&self, tick: u32) -> f32 {
        let Settings { pip, peep, .. } = self.settings;
        match self.phase(tick) {
            Phase::Inspiration => rising(pip, peep, self.rise_ticks, tick),
            Phase::Fall => {
                let done = (tick - self.inspiration_ticks) as f32 / self.fall_ticks as f32;
                pip + (peep - pip) * done
            }
            Phase::Expiration => peep,
        }
    }
}

/// A tick of a breath; [`Breath::at`] gives it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Moment<'a> {
    /// The breath.
    pub breath: &'a Breath,
    /// Tick since its start.
    pub tick: u32,
    /// Its phase in that tick.
    pub phase: Phase,
}

impl<'a> Moment<'a> {
    /// Settings of the breath.
    pub fn settings(&self) -> &'a Settings {
        &self.breath.settings
    }

    /// Whether the inspiration runs.
    pub fn inspires(&self) -> bool {
        self.phase == Phase::Inspiration
    }

    /// Whether this is the last tick of the inspiration.
    pub fn ends_inspiration(&self) -> bool {
        self.tick + 1 == self.breath.inspiration_ticks
    }

    /// Ticks until the next breath is due, with this one; none in an expiration that lasts longer.
    pub fn left(&self) -> u32 {
        self.breath.total_ticks.saturating_sub(self.tick)
    }

    /// The next tick.
    #[must_use]
    pub fn next(&self) -> Self {
        self.breath.at(self.tick + 1)
    }

    /// Target pressure, cmH2O.
    pub fn target(&self) -> f32 {
        self.breath.target(self.tick)
    }
}

/// Target pressure at a tick of an inspiration without end, whose rise to PIP takes this many ticks, cmH2O.
#[inline]
pub fn rising(pip: f32, peep: f32, rise_ticks: u32, tick: u32) -> f32 {
    if tick < rise_ticks { peep + (pip - peep) * (tick as f32 / rise_ticks as f32) } else { pip }
}

/// A control period in seconds.
pub fn period_s(period_us: u32) -> f32 {
    period_us as f32 * 1.0e-6
}

/// The paper's protocol at one peak pressure: PEEP 5 cmH2O, 20 breaths a minute, 1 s inspiration, 0.5 s fall.
pub fn paper_settings(pip: f32) -> Settings {
    Settings { pip, ..Settings::default() }
}

/// A row of the pressure-control test table (ISO 80601-2-12, table 201.105, as transcribed by the
/// open-ventilator community; not checked against the standard itself).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct IsoRow {
    /// Row number, from 1.
    pub number: u8,
    /// Compliance of the test lung, mL/cmH2O.
    pub compliance: f32,
    /// Resistance of the test lung, cmH2O/(L/s).
    pub resistance: f32,
    /// Breaths per minute.
    pub rate: f32,
    /// Inspiratory over expiratory time.
    pub i_to_e: f32,
    /// Peak inspiratory pressure, cmH2O.
    pub pip: f32,
    /// Positive end-expiratory pressure, cmH2O.
    pub peep: f32,
    /// Tidal volume that the row is expected to deliver, mL.
    pub tidal_volume: f32,
}

impl IsoRow {
    /// Settings for this row. The fall takes a sixth of the breath, as in the paper's protocol.
    pub fn settings(&self) -> Settings {
        let breath = 60.0 / self.rate;
        Settings {
            pip: self.pip,
            peep: self.peep,
            rate: self.rate,
            inspiratory_time: breath * self.i_to_e / (1.0 + self.i_to_e),
            fall_time: breath / 6.0,
            ..Settings::default()
        }
    }
}

const fn row(number: u8, lung: (f32, f32), timing: (f32, f32), pressure: (f32, f32), volume: f32) -> IsoRow {
    IsoRow {
        number,
        compliance: lung.0,
        resistance: lung.1,
        rate: timing.0,
        i_to_e: timing.1,
        pip: pressure.0,
        peep: pressure.1,
        tidal_volume: volume,
    }
}

/// All pressure-control rows: lung (compliance, resistance), timing (rate, I:E), pressures (PIP, PEEP), tidal volume.
pub const ISO_ROWS: [IsoRow; 21] = [
    row(1, (50.0, 5.0), (20.0, 0.5), (15.0, 5.0), 500.0),
    row(2, (50.0, 20.0), (12.0, 0.25), (25.0, 10.0), 500.0),
    row(3, (20.0, 5.0), (20.0, 0.5), (30.0, 5.0), 500.0),
    row(4, (20.0, 20.0), (20.0, 0.5), (35.0, 10.0), 500.0),
    row(5, (20.0, 20.0), (20.0, 0.5), (20.0, 5.0), 300.0),
    row(6, (20.0, 50.0), (12.0, 0.25), (35.0, 10.0), 300.0),
    row(7, (10.0, 50.0), (20.0, 0.5), (35.0, 5.0), 300.0),
    row(8, (10.0, 10.0), (20.0, 0.5), (35.0, 10.0), 200.0),
    row(9, (3.0, 10.0), (30.0, 0.43), (20.0, 5.0), 50.0),
    row(10, (3.0, 20.0), (30.0, 0.43), (25.0, 10.0), 50.0),
    row(11, (3.0, 50.0), (20.0, 0.25), (30.0, 5.0), 50.0),
    row(12, (3.0, 20.0), (30.0, 0.43), (15.0, 5.0), 30.0),
    row(13, (3.0, 50.0), (20.0, 0.25), (25.0, 10.0), 30.0),
    row(14, (1.0, 20.0), (30.0, 0.43), (35.0, 5.0), 30.0),
    row(15, (1.0, 100.0), (30.0, 0.43), (40.0, 10.0), 30.0),
    row(16, (1.0, 200.0), (50.0, 0.5), (25.0, 5.0), 20.0),
    row(17, (1.0, 200.0), (50.0, 0.5), (25.0, 10.0), 15.0),
    row(18, (1.0, 50.0), (60.0, 0.67), (15.0, 5.0), 10.0),
    row(19, (0.5, 50.0), (60.0, 0.67), (25.0, 10.0), 5.0),
    row(20, (0.5, 50.0), (30.0, 0.25), (15.0, 5.0), 5.0),
    row(21, (0.5, 200.0), (60.0, 0.67), (25.0, 10.0), 5.0),
];

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn the_papers_breath_rises_holds_falls_and_rests() {
        let breath = Breath::new(&paper_settings(35.0), DEFAULT_PERIOD_US).unwrap();
        let at = |tick| breath.target(tick);
        assert_eq!(
            [0, 999, 1000, 1500, 2999].map(|tick| at(tick).to_bits()),
            [35.0, 35.0, 35.0, 5.0, 5.0].map(f32::to_bits)
        );
        assert!((at(1250) - 20.0).abs() < 1e-4);
        assert_eq!(breath.total_ticks(), 3000);
        assert_eq!(breath.phase(999), Phase::Inspiration);
        assert_eq!(breath.phase(1000), Phase::Fall);
        assert_eq!(breath.phase(1500), Phase::Expiration);
    }

    #[test]
    fn a_ramp_takes_its_rise_time() {
        let settings = Settings { rise_time: 0.2, ..paper_settings(25.0) };
        let breath = Breath::new(&settings, DEFAULT_PERIOD_US).unwrap();
        assert_eq!(
            [0, 100, 200].map(|tick| breath.target(tick).to_bits()),
            [5.0, 15.0, 25.0].map(f32::to_bits)
        );
    }

    #[test]
    fn the_papers_control_period_gives_33_ticks() {
        let breath = Breath::new(&paper_settings(35.0), 30_000).unwrap();
        assert_eq!((breath.inspiration_ticks(), breath.total_ticks()), (33, 100));
    }

    #[test]
    fn all_rows_of_the_test_table_are_valid_settings() {
        for (index, row) in ISO_ROWS.iter().enumerate() {
            assert_eq!(usize::from(row.number), index + 1);
            let breath = Breath::new(&row.settings(), DEFAULT_PERIOD_US).unwrap();
            assert!(breath.inspiration_ticks() < breath.total_ticks());
        }
    }

    #[test]
    fn an_absurd_period_is_refused() {
        let refused = Breath::new(&Settings::default(), 0);
        assert_eq!(refused, Err(SettingsError::Period { period_us: 0 }));
    }

    proptest! {
        #[test]
        fn the_target_stays_between_peep_and_pip(pip in 10.0f32..45.0, rate in 6.0f32..30.0, tick in 0u32..20_000) {
            let breath = Breath::new(&Settings { pip, rate, ..Settings::default() }, DEFAULT_PERIOD_US).unwrap();
            let target = breath.target(tick);
            prop_assert!((5.0..=pip).contains(&target));
        }
    }
}
