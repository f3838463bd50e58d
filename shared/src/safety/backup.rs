//! Backup ventilation for a machine without a sound pressure sensor: the volume of the last good breaths, or their commands.
//!
//! While pressure control works, the commands of each good inspiration are averaged in time bins, and so is its whole volume by the
//! flow sensor and by the valve's model; the course of that volume is the last good inspiration's. With a sound flow sensor the
//! commands are then corrected by what the volume lacks of its course, and the valve closes when the whole volume has been delivered.
//! Without one they are repeated: a lung that has not changed answers with nearly the same pressure. Before the first good breath a
//! constant flow delivers what fills the stiffest adult lung to PIP. The supervisor closes the valve when the lung estimate predicts
//! the pressure limit.
//!
//! Whatever the inspiratory time is now, the commands keep their own time, and the valve closes when it has given the volume of the
//! good breaths: by the sensor, or by the model without one. A lower PIP takes its share of commands and volume away.
//!
//! The flow sensor is sound as long as its volume is near that of the valve's model: within a supply pressure that falls, not if
//! the reading stands still.

use crate::breath::{Breath, Moment};
use crate::control::COMMAND_MAX;
use crate::math;
use crate::safety::lung_estimator::LEAST_MEASURED;
use core::cmp::Ordering;

/// Time bins of an inspiration.
const BINS: usize = 64;
/// Weight of a new breath in the mean profile.
const NEW_BREATH: f32 = 0.3;
/// Compliance that is assumed before the first good breath, L/cmH2O: that of a stiff adult lung.
pub const STIFFEST: f32 = 0.01;
/// Flow of the valve per command that is assumed before the first good breath, (L/s)/%: its mean slope at small commands.
const FLOW_PER_COMMAND: f32 = 0.009;

/// Rise of the command per missing volume, %/mL: the flow makes up for it with a time constant of about 0.15 s.
const CORRECTION: f32 = 0.4;
/// Lowest and highest share of the model's volume that a sound flow sensor measures.
pub const PLAUSIBLE: (f32, f32) = (0.5, 1.5);
/// Highest multiple of the good breaths' volume that the valve gives by its model while the sensor shows less: the supply may fall to
/// [`LEAST_MEASURED`].
const MOST_OF_MODEL: f32 = 1.0 / LEAST_MEASURED;
/// Share of the good breaths' gas of which less is little.
pub const LITTLE: f32 = 0.5;
/// Gas that stays in the circuit, mL.
pub const IN_CIRCUIT: f32 = 50.0;

/// Values over the bins of the last good inspiration and of the running one, which becomes the good one in a single step.
#[derive(Clone, Debug, PartialEq)]
struct Bins {
    bins: [[f32; BINS]; 2],
    second_is_good: bool,
}

impl Bins {
    const EMPTY: Self = Self { bins: [[0.0; BINS]; 2], second_is_good: false };

    fn good(&self) -> &[f32; BINS] {
        &self.bins[usize::from(self.second_is_good)]
    }

    fn running(&mut self) -> &mut [f32; BINS] {
        &mut self.bins[usize::from(!self.second_is_good)]
    }

    fn accept(&mut self) {
        self.second_is_good = !self.second_is_good;
    }
}

/// The mean commands and volumes of the last good breaths, and those of the running one. Fulfils: backup-ventilation.
#[derive(Clone, Debug, PartialEq)]
pub struct Backup {
    /// Mean commands, without the running inspiration and with it, percent.
    commands: Bins,
    /// Volume at the end of each bin, mL.
    volumes: Bins,
    /// The good breaths; none before the first.
    good: Option<Good>,
    /// Volumes of those breaths; none if they were not measured.
    course: Option<Course>,
    /// First bin that the running inspiration has not filled, and the commands in the bin before that: sum and number.
    next: usize,
    sum: f32,
    count: f32,
    /// Volume since its start by the flow sensor, mL, not a number once a reading was missing; and by the valve's model.
    measured: f32,
    modelled: f32,
}

/// What the good breaths have in common.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Good {
    /// Rise from PEEP to PIP, cmH2O.
    rise: f32,
    /// Length of the inspiration, ticks.
    length: u32,
    /// Mean of the whole volumes by the valve's model, mL.
    modelled: f32,
}

impl Good {
    /// Whether a breath is of the same kind, so that its commands belong into the same mean.
    fn is_like(&self, breath: &Breath) -> bool {
        self.rise.to_bits() == rise_of(breath).to_bits() && self.length == breath.inspiration_ticks()
    }
}

/// Volumes of good inspirations, mL.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Course {
    /// The whole volume of the last one.
    last: f32,
    /// Mean of the whole volumes.
    whole: f32,
}

impl Backup {
    /// Before the first breath.
    pub const fn new() -> Self {
        Self {
            commands: Bins::EMPTY,
            volumes: Bins::EMPTY,
            good: None,
            course: None,
            next: 0,
            sum: 0.0,
            count: 0.0,
            measured: 0.0,
            modelled: 0.0,
        }
    }

    /// Starts an inspiration.
    pub fn start_breath(&mut self) {
        (self.next, self.sum, self.count) = (0, 0.0, 0.0);
        (self.measured, self.modelled) = (0.0, 0.0);
    }

    /// Adds the gas of a tick of an inspiration, of `period` seconds: flows by the sensor, NaN without a reading, and by the valve's
    /// model, L/s.
    #[inline]
    pub fn count(&mut self, sensor: f32, model: f32, period: f32) {
        self.measured += 1000.0 * sensor * period;
        self.modelled += 1000.0 * model * period;
    }

    /// Whether the flow sensor is sound in the running inspiration; not so without a reading.
    pub fn is_flow_sound(&self) -> bool {
        self.measured >= PLAUSIBLE.0 * self.modelled - IN_CIRCUIT
            && self.measured <= PLAUSIBLE.1 * self.modelled + IN_CIRCUIT
    }

    /// Whether the valve has given but little of the good breaths' gas in the running inspiration.
    pub fn has_given_little(&self) -> bool {
        self.good.is_some_and(|good| self.modelled < LITTLE * good.modelled)
    }

    /// Whether the flow sensor has shown but little of the good breaths' gas in the running inspiration.
    pub fn has_let_in_little(&self) -> bool {
        self.course.as_ref().is_some_and(|course| self.measured < LITTLE * course.whole)
    }

    /// Whether the flow sensor has shown far less gas in the running inspiration than the valve's model.
    pub fn lacks_gas(&self) -> bool {
        self.measured < PLAUSIBLE.0 * self.modelled - IN_CIRCUIT
    }

    /// At the end of an inspiration: whether the flow sensor has shown its gas, or far less or more than the valve's model; none if
    /// that is too little to tell, or a reading was missing.
    pub fn gas_shown(&self) -> Option<Ordering> {
        let compare = || match (self.is_near_model(), self.is_flow_sound()) {
            (false, _) => Ordering::Less,
            (true, true) => Ordering::Equal,
            (true, false) => Ordering::Greater,
        };
        (self.modelled >= IN_CIRCUIT && !self.measured.is_nan()).then(compare)
    }

    /// Whether not far less than the model's volume was measured: at the end of an inspiration the circuit has had its share.
    fn is_near_model(&self) -> bool {
        self.measured > 0.0 && self.measured >= PLAUSIBLE.0 * self.modelled
    }

    /// Rise of the pressure per volume of the last good breaths, cmH2O/mL; none before the first with a sound flow sensor.
    pub fn elastance(&self) -> Option<f32> {
        let course = self.course.as_ref()?;
        debug_assert!(course.whole > 0.0, "only measured gas becomes part of it");
        self.good.map(|good| good.rise / course.whole)
    }

    /// Records the command of a tick of an inspiration, percent. It fills all bins up to the next tick's, since a slow control
    /// period has fewer ticks than there are bins. After a gap nothing more of the inspiration is recorded.
    #[inline]
    pub fn record(&mut self, moment: &Moment, command: f32) {
        let breath = moment.breath;
        let length = breath.inspiration_ticks();
        let bin = bin(length, moment.tick);
        if bin > self.next {
            return;
        }
        if bin == self.next {
            (self.sum, self.count) = (0.0, 0.0);
        }
        (self.sum, self.count) = (self.sum + command, self.count + 1.0);
        let weight = if self.is_of_another_kind(breath) { 1.0 } else { NEW_BREATH };
        let mean = self.sum / self.count;
        self.next = bins_before(length, moment.tick + 1).clamp(bin + 1, BINS);
        debug_assert!(mean >= 0.0, "a valve has no negative command");
        for bin in bin..self.next {
            let before = self.commands.good()[bin];
            self.commands.running()[bin] = before + weight * (mean - before);
            self.volumes.running()[bin] = self.measured;
        }
    }

    /// Whether the good breaths had another rise or another length: then their commands are no part of the mean.
    fn is_of_another_kind(&self, breath: &Breath) -> bool {
        self.good.is_none_or(|good| !good.is_like(breath))
    }

    /// Makes the running inspiration, which was a good one, part of the mean, if its commands were recorded up to its last tick.
    /// The command of that tick is not known yet; the one before lasts.
    pub fn accept(&mut self, breath: &Breath) {
        let Some(last) = self.next.checked_sub(1) else { return };
        debug_assert!(last < BINS);
        let length = breath.inspiration_ticks();
        if self.next < bin(length, length.saturating_sub(1)) {
            return;
        }
        for bins in [&mut self.commands, &mut self.volumes] {
            let value = bins.running()[last];
            bins.running()[self.next..].fill(value);
        }
        let before = self.good.filter(|good| good.is_like(breath));
        self.commands.accept();
        let mean = before.map_or(self.modelled, |good| good.modelled);
        let modelled = mean + NEW_BREATH * (self.modelled - mean);
        self.good = Some(Good { rise: rise_of(breath), length: breath.inspiration_ticks(), modelled });
        self.accept_course(before.is_none());
    }

    /// Adds the course of the running inspiration's volume to the mean, if the flow sensor was sound.
    fn accept_course(&mut self, changed: bool) {
        if changed {
            self.course = None;
        }
        if !(self.is_near_model() && self.is_flow_sound()) {
            return;
        }
        let before = self.course.as_ref().map_or(self.measured, |course| course.whole);
        let whole = before + NEW_BREATH * (self.measured - before);
        self.course = Some(Course { last: self.measured, whole });
        self.volumes.accept();
    }

    /// The command of a tick of an inspiration, percent; `by_flow`: corrected by the flow sensor, if that is sound.
    #[inline]
    pub fn command(&self, moment: &Moment, by_flow: bool) -> f32 {
        let breath = moment.breath;
        let rise = rise_of(breath);
        let Some(good) = &self.good else {
            return rise * STIFFEST / breath.settings().inspiratory_time / FLOW_PER_COMMAND;
        };
        let scale = math::limit(rise / good.rise, 0.0, 1.0);
        // The last command lasts.
        let bin = bin(good.length, moment.tick);
        let command = scale * self.commands.good()[bin];
        let Some(course) = self.course.as_ref().filter(|_| by_flow && self.is_flow_sound()) else {
            return if self.modelled < scale * good.modelled { command } else { 0.0 };
        };
        let whole = scale * course.whole;
        if self.measured >= whole || self.modelled >= MOST_OF_MODEL * scale * good.modelled {
            return 0.0;
        }
        let wanted = whole * self.volumes.good()[bin] / course.last;
        math::limit(command + CORRECTION * (wanted - self.measured), 0.0, COMMAND_MAX)
    }
}

impl Default for Backup {
    fn default() -> Self {
        Self::new()
    }
}

/// Rise from PEEP to PIP, cmH2O.
fn rise_of(breath: &Breath) -> f32 {
    breath.settings().pip - breath.settings().peep
}

/// The bin of a tick in an inspiration of `length` ticks; a tick after it is in the last one.
fn bin(length: u32, tick: u32) -> usize {
    bins_before(length, tick).min(BINS - 1)
}

/// Number of bins that begin before the bin of a tick; ticks after the inspiration go on counting.
fn bins_before(length: u32, tick: u32) -> usize {
    tick as usize * BINS / length.max(1) as usize
}

#[cfg(test)]
mod tests;
