//! The sensors at rest: valves safe, no patient, and after a while no flow.

use super::{Finding, Outcome, StepResult};
use crate::calibration::Quantity;
use crate::math;
use crate::safety::reading_monitor::{NOISE_MAX, SECOND_DIFFERENCE};
use crate::sensor::Readings;

/// Length of an observation, s.
const TIME: f32 = 0.5;
/// Smallest share of readings that must be numbers.
const SHARE: f32 = 0.9;
/// Lowest pressure at rest, cmH2O; the zeros of sensors differ.
const LOWEST: f32 = -2.0;
/// Highest pressure at rest above the PEEP that the settings name, cmH2O. Between that of the air and PEEP every pressure is
/// plausible: a leak lets it fall below that of the mechanical PEEP valve.
const ABOVE_PEEP: f32 = 3.0;
/// Largest difference between the pressure sensors without a flow, cmH2O.
const DIFFERENCE: f32 = 2.0;
/// Largest mean flow, L/s. A flow meter with an orifice shows this at an error of 0.2 cmH2O across it.
const FLOW: f32 = 0.3;
/// Largest zero of a pressure sensor, cmH2O.
const ZERO: f32 = Quantity::SensorZero.bounds().1;

/// Mean of the readings of a sensor that are numbers.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct NumberMean {
    sum: f32,
    numbers: u32,
}

impl NumberMean {
    fn add(&mut self, reading: f32) {
        if reading.is_finite() {
            self.sum += reading;
            self.numbers += 1;
        }
    }

    /// The mean; none if too few readings were numbers.
    fn of(self, ticks: u32) -> Option<f32> {
        (self.numbers as f32 >= SHARE * ticks as f32).then(|| self.sum / self.numbers as f32)
    }
}

/// Readings of a pressure sensor.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Pressure {
    mean: NumberMean,
    /// The last two readings.
    last: [f32; 2],
    /// Second differences: they show noise, and neither a drift nor a patient.
    noise: NumberMean,
}

impl Pressure {
    fn add(&mut self, reading: f32, tick: u32) {
        self.mean.add(reading);
        let [before, last] = self.last;
        if tick >= 2 {
            self.noise.add((reading - 2.0 * last + before).abs());
        }
        self.last = [last, reading];
    }

    /// Whether too few differences are numbers, or their mean is too large.
    fn is_noisy(&self, ticks: u32) -> bool {
        // The first two readings end no second difference.
        !self.noise.of(ticks.saturating_sub(2)).is_some_and(|noise| noise <= NOISE_MAX * SECOND_DIFFERENCE)
    }
}

/// An observation of the sensors.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Rest {
    ticks: u32,
    length: u32,
    airway: Pressure,
    outlet: Pressure,
    flow: NumberMean,
}

impl Rest {
    /// A new observation; for a control period in microseconds.
    pub(super) fn new(period_us: u32) -> Self {
        let length = math::ticks(TIME, period_us).max(8);
        let (airway, outlet) = (Pressure::default(), Pressure::default());
        Self { ticks: 0, length, airway, outlet, flow: NumberMean::default() }
    }

    /// Adds a tick; returns the observation at its end.
    pub(super) fn add(&mut self, readings: &Readings) -> Option<Seen> {
        debug_assert!(self.ticks < self.length, "it ends once");
        self.airway.add(readings.airway, self.ticks);
        self.outlet.add(readings.outlet, self.ticks);
        self.flow.add(readings.flow);
        self.ticks += 1;
        debug_assert!(self.airway.mean.numbers <= self.ticks);
        (self.ticks >= self.length).then_some(Seen(*self))
    }
}

/// An observation that has ended.
pub(super) struct Seen(Rest);

impl Seen {
    /// Mean pressures, airway and outlet. A machine may be without the outlet sensor, but not have half of one.
    fn pressures(&self) -> Result<(f32, Option<f32>), Finding> {
        let Rest { ticks, airway, outlet, .. } = &self.0;
        let pressure = airway.mean.of(*ticks).ok_or(Finding::NoReading)?;
        let exists = outlet.mean.numbers > 0;
        let other = outlet.mean.of(*ticks);
        if exists && other.is_none() {
            return Err(Finding::NoReading);
        }
        if airway.is_noisy(*ticks) || (exists && outlet.is_noisy(*ticks)) {
            return Err(Finding::Noisy);
        }
        Ok((pressure, other))
    }

    /// The result of the step `sensors`, with the PEEP of the settings, cmH2O.
    pub(super) fn judge(&self, peep: f32) -> StepResult {
        let (pressure, outlet) = match self.pressures() {
            Ok(pressures) => pressures,
            Err(finding) => return Outcome::Failed(finding).into(),
        };
        let plausible = |pressure: f32| pressure >= LOWEST && pressure <= peep + ABOVE_PEEP;
        let outcome = if !outlet.is_none_or(|outlet| (outlet - pressure).abs() <= DIFFERENCE) {
            Outcome::Failed(Finding::SensorsDiffer)
        } else if !plausible(pressure) {
            Outcome::Failed(Finding::NotAtRest)
        } else if self.0.flow.of(self.0.ticks).is_some_and(|flow| flow.abs() > FLOW) {
            Outcome::Failed(Finding::FlowAtRest)
        } else {
            Outcome::Passed
        };
        StepResult { outcome, value: pressure }
    }

    /// The result of the step `zero`, and the zeros from then on: `before` are those that the readings are already without.
    pub(super) fn zero(&self, before: [f32; 2]) -> (StepResult, [f32; 2]) {
        let (airway, outlet) = match self.pressures() {
            Ok(pressures) => pressures,
            Err(finding) => return (Outcome::Failed(finding).into(), before),
        };
        let found = [before[0] + airway, before[1] + outlet.unwrap_or(0.0)];
        let value = if found[0].abs() >= found[1].abs() { found[0] } else { found[1] };
        if value.abs() <= ZERO {
            (StepResult { outcome: Outcome::Passed, value }, found)
        } else {
            (StepResult { outcome: Outcome::Failed(Finding::ZeroTooFar), value }, before)
        }
    }
}
