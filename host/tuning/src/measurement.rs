//! A measurement, breath by breath: what is measured, and what becomes of the samples of each breath. It asks nothing of a unit.
//!
//! While the pressure of a test lung rises along a ramp, gas flows at a nearly constant rate, however small the lung is: the valve is
//! open, and the sine is not cut. A plateau needs almost no flow. The first breaths bring the lung to its rhythm, and a learned
//! controller to what it remembers, which perturbed breaths do not change. Then the sine must fit between the valve's limits.

use std::ops::{Range, RangeInclusive};

use serde::Serialize;
use shared::control::COMMAND_MAX;
use shared::explore::sines::{SineSweep, SweepError};
use shared::settings::{Settings, SettingsError};
use shared::ventilator::Sample;
use thiserror::Error;
use verdict::response::Inspiration;

use super::advice::{Advice, Evidence, advice};
use super::estimate::{Correlated, Estimate, Moment};
use super::interval::SureMargins;

/// Breaths before the first sine: those that a learned controller remembers, and two for the lung.
pub const WARM_UP: u32 = shared::control::memory::LEARNING as u32 + 2;
/// Start of the sine within a breath, s: the first command of the breath has reached the lung.
const FROM_S: f32 = 0.05;
/// Time from the start of the sine until the loop has settled into it, s.
const SETTLES_S: f32 = 0.3;
/// Periods of the lowest frequency in a window, at least: fewer look like a trend.
const PERIODS: f32 = 1.0;
/// Shortest window, s.
const SHORTEST_S: f32 = 0.3;
/// Time over which commands are averaged to find the room for the sine, s: the noise of a sensor is no reason to refuse it.
const SMOOTH_S: f32 = 0.05;
/// Room for the sine, in amplitudes: feedback makes it larger around the crossover.
const ROOM: f32 = 1.2;

/// Bounds of the number of frequencies, and of the breaths at each.
pub const FREQUENCIES: RangeInclusive<u8> = 8..=40;
/// See [`FREQUENCIES`].
pub const PHASES: RangeInclusive<u8> = 5..=24;

/// What is measured.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Plan {
    /// Settings of the breaths.
    pub settings: Settings,
    /// Amplitude of the sine, percent.
    pub amplitude: f32,
    /// Lowest and highest frequency, Hz.
    pub band_hz: (f32, f32),
    /// Number of frequencies, spaced evenly by their logarithm.
    pub frequencies: u8,
    /// Breaths at each frequency.
    pub phases: u8,
    /// Seed of the intervals' draws.
    pub seed: u64,
}

impl Default for Plan {
    fn default() -> Self {
        Self {
            settings: Settings {
                rise_time: 1.0,
                // A test lung makes no efforts.
                trigger_pressure: 0.0,
                trigger_flow: 0.0,
                ..Settings::default()
            },
            amplitude: 10.0,
            band_hz: (1.6, 25.0),
            frequencies: 20,
            phases: 6,
            seed: 1,
        }
    }
}

/// Why a plan cannot be measured.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum PlanError {
    /// The settings are refused.
    #[error(transparent)]
    Settings(#[from] SettingsError),
    /// The sweep is refused.
    #[error(transparent)]
    Sweep(#[from] SweepError),
    /// The inspiration leaves no room for a window.
    #[error(
        "an inspiration of {inspiration} s is too short: the lowest frequency needs at least {least:.2} s"
    )]
    TooShort {
        /// Inspiratory time, s.
        inspiration: f32,
        /// The shortest that allows the lowest frequency, s.
        least: f32,
    },
    /// The breath has no room for the amplitude.
    #[error(
        "a sine of {amplitude} % around commands of {low:.0} to {high:.0} % would reach the valve's limits of 0 and {COMMAND_MAX} %: at most {allowed:.1} % are allowed here; choose a smaller amplitude, or another flow by a higher or lower PIP"
    )]
    NoRoom {
        /// Amplitude, percent.
        amplitude: f32,
        /// Lowest and highest command of the breaths without a sine, percent.
        low: f32,
        /// The highest.
        high: f32,
        /// Highest amplitude for which there is room, percent.
        allowed: f32,
    },
}

/// Why a measurement ended before its last breath.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Ended {
    /// The user asked to stop.
    Stopped,
    /// An alarm ended the sine, or the ventilator left the chosen controller.
    Alarm(String),
    /// The source failed.
    Failed(String),
}

/// A measured loop.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Measured {
    /// What was measured.
    pub plan: Plan,
    /// Control period, microseconds.
    pub period_us: u32,
    /// The frequencies, from the lowest on.
    pub estimates: Vec<Estimate>,
    /// The margins.
    pub margins: SureMargins,
    /// Where the loop was measured.
    pub point: WorkingPoint,
    /// The last breath without a sine.
    pub breath: Vec<Moments>,
    /// What limits the loop.
    pub advice: Vec<Advice>,
    /// Why there are not more frequencies; none after the whole sweep.
    pub ended: Option<Ended>,
}

/// The mean of the windows.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct WorkingPoint {
    /// Pressure, cmH2O.
    pub pressure: f64,
    /// Command, percent.
    pub command: f64,
    /// Movement of the command in the breaths without a sine, percent per second: how hard the valve works.
    pub effort: f64,
}

/// A moment of a breath without a sine.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Moments {
    /// Time since the start of the breath, s.
    pub time_s: f32,
    /// Target, cmH2O.
    pub target: f32,
    /// Pressure, cmH2O.
    pub pressure: f32,
    /// Command, percent.
    pub command: f32,
}

impl Plan {
    /// The settings of a measurement of a unit with these: a ramp of its pressures, and no efforts.
    #[must_use]
    pub fn ramp(of: &Settings) -> Settings {
        let Settings { inspiratory_time, rise_time, trigger_pressure, trigger_flow, .. } =
            Self::default().settings;
        Settings { inspiratory_time, rise_time, trigger_pressure, trigger_flow, ..*of }
    }

    /// The sweep.
    pub fn sweep(&self) -> SineSweep {
        let steps = f32::from(self.frequencies.max(2) - 1);
        SineSweep {
            amplitude: self.amplitude,
            lowest_hz: self.band_hz.0,
            ratio: (self.band_hz.1 / self.band_hz.0).powf(1.0 / steps),
            frequencies: self.frequencies,
            phases: self.phases,
            first_breath: WARM_UP,
            from_s: FROM_S,
        }
    }

    /// Breaths of the whole measurement.
    pub fn breaths(&self) -> u32 {
        WARM_UP + self.sweep().breaths()
    }

    /// Checks everything that does not depend on the unit.
    ///
    /// # Errors
    /// Settings or a sine out of bounds, or an inspiration that is too short for them.
    pub fn validate(&self) -> Result<(), PlanError> {
        self.settings.validate()?;
        self.sweep().validate()?;
        let least = FROM_S + SETTLES_S + SHORTEST_S.max(PERIODS / self.band_hz.0);
        let inspiration = self.settings.inspiratory_time;
        if inspiration >= least { Ok(()) } else { Err(PlanError::TooShort { inspiration, least }) }
    }

    /// Ticks of a breath in which its signals are correlated with the sine.
    pub fn window(&self, period_us: u32) -> Range<u32> {
        let ticks = |seconds| shared::math::ticks(seconds, period_us);
        ticks(FROM_S + SETTLES_S)..ticks(self.settings.inspiratory_time)
    }

    /// The room for the sine in a breath without one.
    fn check_room(&self, samples: &[Sample], period_us: u32) -> Result<(), PlanError> {
        let smooth = shared::math::ticks(SMOOTH_S, period_us).max(1) as usize;
        let commands: Vec<f32> = within(samples, &self.window(period_us)).map(|sample| sample.u_in).collect();
        let means = commands
            .windows(smooth.min(commands.len()).max(1))
            .map(|some| some.iter().sum::<f32>() / some.len() as f32);
        let (low, high) = means
            .fold((f32::INFINITY, f32::NEG_INFINITY), |(low, high), mean| (low.min(mean), high.max(mean)));
        let allowed = (low.min(COMMAND_MAX - high) / ROOM).max(0.0);
        let amplitude = self.amplitude;
        // In this form a NaN fails too.
        if amplitude <= allowed { Ok(()) } else { Err(PlanError::NoRoom { amplitude, low, high, allowed }) }
    }
}

/// The samples of these ticks.
fn within<'a>(samples: &'a [Sample], ticks: &'a Range<u32>) -> impl Iterator<Item = &'a Sample> {
    samples.iter().filter(|sample| ticks.contains(&sample.tick) && !sample.u_out)
}

/// A measurement under way.
#[derive(Debug)]
pub struct Measurement {
    plan: Plan,
    period_us: u32,
    sweep: SineSweep,
    /// Breaths so far.
    number: u32,
    windows: u32,
    point: WorkingPoint,
    estimates: Vec<Estimate>,
    /// The breaths of the present frequency.
    breaths: Vec<Correlated>,
    /// The breaths of a slow frequency, which show the valve's play.
    excited: Vec<Inspiration>,
    /// The last breath without a sine.
    last: Vec<Sample>,
}

impl Measurement {
    /// Before its first breath.
    ///
    /// # Errors
    /// A plan that is refused.
    pub fn new(plan: Plan, period_us: u32) -> Result<Self, PlanError> {
        plan.validate()?;
        Ok(Self {
            plan,
            period_us,
            sweep: plan.sweep(),
            number: 0,
            windows: 0,
            point: WorkingPoint::default(),
            estimates: Vec::new(),
            breaths: Vec::new(),
            excited: Vec::new(),
            last: Vec::new(),
        })
    }

    /// What is measured.
    pub fn plan(&self) -> &Plan {
        &self.plan
    }

    /// The sweep of a unit whose breath with this number is the first of the measurement.
    pub fn sweep_from(&self, breath: u32) -> SineSweep {
        SineSweep { first_breath: breath.saturating_add(WARM_UP), ..self.sweep }
    }

    /// Number of breaths so far.
    pub fn breaths(&self) -> u32 {
        self.number
    }

    /// Whether every breath is there.
    pub fn is_complete(&self) -> bool {
        self.number >= self.plan.breaths()
    }

    /// Whether a frequency is complete, so that there is something to show.
    pub fn has_result(&self) -> bool {
        !self.estimates.is_empty()
    }

    /// Takes the samples of the next breath. [`Ended::Alarm`], if its sine has ended early.
    ///
    /// # Errors
    /// [`PlanError::NoRoom`], a breath before the first sine, which must then be called off.
    pub fn take(&mut self, samples: Vec<Sample>) -> Result<Option<Ended>, PlanError> {
        if self.number + 2 == WARM_UP {
            self.plan.check_room(&samples, self.period_us)?;
        }
        let number = self.number;
        self.number += 1;
        let ticks = self.plan.window(self.period_us);
        let window: Vec<&Sample> = within(&samples, &ticks).collect();
        let (Some(place), Some(sine)) = (self.sweep.place(number), self.sweep.sine(number, self.period_us))
        else {
            self.last = samples;
            return Ok(None);
        };
        let moment = |sample: &&Sample| {
            // One without the sine ends the measurement, unless the sine is zero there.
            let wanted = sine.at(sample.tick);
            (wanted.to_bits() == sample.explore.to_bits()).then(|| Moment {
                turns: sine.angle(sample.tick).unwrap_or_default().into(),
                sine: sample.explore.into(),
                command: sample.u_in.into(),
                pressure: sample.pressure.into(),
            })
        };
        let moments: Option<Vec<Moment>> = window.iter().map(moment).collect();
        let Some(moments) = moments.filter(|moments| moments.len() == ticks.len()) else {
            let why = format!("in breath {number} the ventilator ended the sine or the inspiration");
            return Ok(Some(Ended::Alarm(why)));
        };
        let mean = |of: fn(&Moment) -> f64| moments.iter().map(of).sum::<f64>() / moments.len() as f64;
        self.point.pressure += mean(|moment| moment.pressure);
        self.point.command += mean(|moment| moment.command);
        self.windows += 1;
        if place.0 == self.sweep.frequencies / 4 {
            let signal = |of: fn(&Moment) -> f64| moments.iter().map(of).collect();
            self.excited.push(Inspiration {
                command: signal(|moment| moment.command),
                pressure: signal(|moment| moment.pressure),
            });
        }
        self.breaths.push(Correlated::of(f64::from(place.1) / f64::from(self.sweep.phases), &moments));
        if self.breaths.len() == usize::from(self.sweep.phases) {
            let hz = self.sweep.hz(place.0).into();
            self.estimates.extend(Estimate::of(hz, &self.breaths));
            self.breaths.clear();
        }
        Ok(None)
    }

    /// The result; `ended` says why there are not more breaths.
    pub fn finished(self, ended: Option<Ended>) -> Measured {
        let period_s = f64::from(shared::breath::period_s(self.period_us));
        let windows = f64::from(self.windows.max(1));
        let commands: Vec<f64> =
            within(&self.last, &self.plan.window(self.period_us)).map(|sample| sample.u_in.into()).collect();
        let moved: f64 = commands.windows(2).map(|pair| (pair[1] - pair[0]).abs()).sum();
        let point = WorkingPoint {
            pressure: self.point.pressure / windows,
            command: self.point.command / windows,
            effort: moved / (commands.len().max(2) as f64 * period_s),
        };
        let breath = self.last.iter().map(|sample| Moments {
            time_s: sample.tick as f32 * shared::breath::period_s(self.period_us),
            target: sample.target,
            pressure: sample.pressure,
            command: sample.u_in,
        });
        let margins = SureMargins::of(&self.estimates, self.plan.seed);
        let gas_ml = gas_ml(&self.last, period_s);
        let evidence = Evidence { excited: self.excited, period_s, gas_ml };
        Measured {
            plan: self.plan,
            period_us: self.period_us,
            advice: advice(&margins, &self.estimates, &evidence),
            margins,
            estimates: self.estimates,
            point,
            breath: breath.collect(),
            ended,
        }
    }
}

/// Gas that flows in during a breath, and that does not come back, mL; none if a flow is missing.
fn gas_ml(breath: &[Sample], period_s: f64) -> Option<(f64, f64)> {
    let flows: Option<Vec<f64>> = breath.iter().map(|sample| sample.flow.map(f64::from)).collect();
    let flows = flows.filter(|flows| !flows.is_empty())?;
    let ml = |flow: f64| 1e3 * period_s * flow;
    Some((ml(flows.iter().map(|flow| flow.max(0.0)).sum()), ml(flows.iter().sum())))
}
