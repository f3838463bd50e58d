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

/// The mean commands and volumes of the last good breaths, and those of the running one.
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
        let course = self.course.as_ref().filter(|course| course.whole > 0.0)?;
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
mod tests {
    use super::*;
    use crate::breath::{DEFAULT_PERIOD_US, paper_settings};
    use crate::settings::Settings;

    fn breath(pip: f32) -> Breath {
        Breath::new(&paper_settings(pip), DEFAULT_PERIOD_US).unwrap()
    }

    /// A good breath with a command per tick and a valve that gives 0.4 L/s, without a flow sensor; then the next inspiration begins.
    fn good(backup: &mut Backup, breath: &Breath, command: impl Fn(u32) -> f32) {
        backup.start_breath();
        for tick in 0..breath.inspiration_ticks() {
            backup.count(f32::NAN, 0.4, breath.period_s());
            backup.record(&breath.at(tick), command(tick));
        }
        backup.accept(breath);
        backup.start_breath();
    }

    #[test]
    fn the_commands_of_good_breaths_return() {
        let (breath, mut backup) = (breath(25.0), Backup::new());
        let command = |tick: u32| if tick < 300 { 80.0 } else { 20.0 };
        for _ in 0..5 {
            good(&mut backup, &breath, command);
        }
        for tick in [0, 150, 290, 320, 600, 999] {
            assert!((backup.command(&breath.at(tick), true) - command(tick)).abs() < 1e-3, "tick {tick}");
        }
    }

    #[test]
    fn a_bin_has_the_mean_of_its_commands() {
        let (breath, mut backup) = (breath(25.0), Backup::new());
        good(&mut backup, &breath, |tick| tick as f32);
        // The bin of the 500th millisecond has the ticks 500 to 515.
        assert!((backup.command(&breath.at(510), true) - 507.5).abs() < 1e-3);
    }

    #[test]
    fn a_new_breath_has_three_tenths_of_the_mean() {
        let (breath, mut backup) = (breath(25.0), Backup::new());
        good(&mut backup, &breath, |_| 30.0);
        good(&mut backup, &breath, |_| 40.0);
        assert!((backup.command(&breath.at(500), true) - 33.0).abs() < 1e-3);
    }

    #[test]
    fn a_breath_that_was_not_good_is_forgotten() {
        let (breath, mut backup) = (breath(25.0), Backup::new());
        good(&mut backup, &breath, |_| 30.0);
        backup.start_breath();
        for tick in 0..1000 {
            backup.record(&breath.at(tick), 100.0);
        }
        backup.start_breath();
        assert!((backup.command(&breath.at(500), true) - 30.0).abs() < 1e-4);
    }

    #[test]
    fn before_the_first_good_breath_a_stiff_lung_is_filled_to_pip() {
        // 200 mL within a second: 20 cmH2O in a lung of 10 mL/cmH2O.
        let command = Backup::new().command(&breath(25.0).at(0), true);
        assert!((command * FLOW_PER_COMMAND - 0.2).abs() < 1e-4, "{command} %");
        let short = Settings { inspiratory_time: 0.5, ..paper_settings(25.0) };
        let short = Breath::new(&short, DEFAULT_PERIOD_US).unwrap();
        let command = Backup::new().command(&short.at(0), true);
        assert!((command * FLOW_PER_COMMAND - 0.4).abs() < 1e-4, "{command} % in half a second");
    }

    #[test]
    fn other_settings_never_deliver_more_than_the_profile() {
        let mut backup = Backup::new();
        good(&mut backup, &breath(25.0), |_| 40.0);
        assert!((backup.command(&breath(15.0).at(10), true) - 20.0).abs() < 1e-3);
        assert!((backup.command(&breath(35.0).at(10), true) - 40.0).abs() < 1e-3);
        good(&mut backup, &breath(15.0), |_| 10.0);
        assert!(
            (backup.command(&breath(15.0).at(10), true) - 10.0).abs() < 1e-3,
            "a mean of one kind of breath"
        );
    }

    /// A breath with a control period of 20 ms.
    fn slow_breath(inspiratory_time: f32) -> Breath {
        Breath::new(&Settings { inspiratory_time, ..paper_settings(25.0) }, 20_000).unwrap()
    }

    #[test]
    fn an_inspiration_of_few_ticks_fills_every_bin() {
        let (breath, mut backup) = (slow_breath(0.4), Backup::new());
        good(&mut backup, &breath, |tick| tick as f32);
        for tick in 0..breath.inspiration_ticks() {
            assert!((backup.command(&breath.at(tick), true) - tick as f32).abs() < 1e-4);
        }
        good(&mut backup, &breath, |_| 10.0);
        let means = [0, 1, 2, 19].map(|tick| backup.command(&breath.at(tick), true));
        let expected = [3.0, 3.7, 4.4, 16.3];
        assert!(means.iter().zip(expected).all(|(mean, e)| (mean - e).abs() < 1e-4), "{means:?}");
    }

    #[test]
    fn the_commands_keep_their_time_whatever_the_inspiratory_time_and_the_last_one_lasts() {
        let mut backup = Backup::new();
        good(&mut backup, &slow_breath(0.4), |tick| tick as f32);
        for inspiratory_time in [0.2, 0.6] {
            let breath = slow_breath(inspiratory_time);
            let expected = |tick: u32| tick.min(19) as f32;
            let as_expected =
                |tick: u32| (backup.command(&breath.at(tick), true) - expected(tick)).abs() < 1e-4;
            assert!((0..breath.inspiration_ticks()).all(as_expected), "{inspiratory_time} s");
        }
        good(&mut backup, &slow_breath(0.6), |_| 10.0);
        let command = backup.command(&slow_breath(0.4).at(5), true);
        assert!((command - 10.0).abs() < 1e-4, "a mean of breaths of one length: {command}");
    }

    #[test]
    fn without_a_flow_sensor_the_valve_closes_when_its_model_has_given_the_volume_of_the_good_breaths() {
        for inspiratory_time in [0.2, 1.0, 2.4, 5.0] {
            for (pip, share) in [(25.0, 1.0), (35.0, 1.0), (15.0, 0.5)] {
                let mut backup = Backup::new();
                good(&mut backup, &breath(25.0), |_| 30.0);
                let settings = Settings { inspiratory_time, rate: 10.0, ..paper_settings(pip) };
                let later = Breath::new(&settings, DEFAULT_PERIOD_US).unwrap();
                for tick in 0..later.inspiration_ticks() {
                    let opens = backup.command(&later.at(tick), true) > 0.0;
                    backup.count(f32::NAN, if opens { 0.4 } else { 0.0 }, 0.001);
                }
                let most = share * 400.0_f32.min(400.0 * inspiratory_time / share);
                assert!((backup.modelled - most).abs() < 0.5, "{inspiratory_time} s: {} mL", backup.modelled);
            }
        }
    }

    #[test]
    fn a_flow_sensor_that_shows_little_gets_no_more_than_a_low_supply_takes_away() {
        let (breath, mut backup) = (breath(25.0), Backup::new());
        delivered(&mut backup, &breath, 0.4, 0.4);
        backup.start_breath();
        let mut command = |modelled: f32| {
            (backup.measured, backup.modelled) = (0.55 * modelled, modelled);
            backup.command(&breath.at(999), true)
        };
        assert!(command(660.0) > 29.0 && command(667.0).abs() < 1e-6);
    }

    #[test]
    fn at_its_end_the_last_command_is_not_known_and_the_one_before_lasts() {
        let (breath, mut backup) = (slow_breath(0.4), Backup::new());
        backup.start_breath();
        let last = breath.inspiration_ticks() - 1;
        (0..last).for_each(|tick| backup.record(&breath.at(tick), 10.0 + tick as f32));
        backup.count(0.4, 0.4, 0.02);
        backup.accept(&breath);
        let mut next = backup.clone();
        next.start_breath();
        assert!((next.command(&breath.at(last), false) - 9.0 - last as f32).abs() < 1e-4);
        assert_eq!(backup.volumes.good()[BINS - 1].to_bits(), backup.volumes.good()[BINS - 4].to_bits());
        // The command of the last tick comes after this and belongs to no mean.
        backup.record(&breath.at(last), 90.0);
        good(&mut backup, &breath, |_| 10.0);
        assert!((backup.command(&breath.at(0), false) - 10.0).abs() < 1e-4);
    }

    #[test]
    fn an_inspiration_without_all_of_its_commands_is_no_part_of_the_mean() {
        let (breath, mut backup) = (breath(25.0), Backup::new());
        delivered(&mut backup, &breath, 0.4, 0.4);
        let known = |backup: &Backup| (*backup.commands.good(), *backup.volumes.good(), backup.course);
        let before = known(&backup);
        // The last bins begin at 969 and 985 ms.
        for recorded in [0..0, 1..1000, 16..1000, 0..969] {
            backup.start_breath();
            let all = recorded.start == 1;
            recorded.for_each(|tick| backup.record(&breath.at(tick), 90.0));
            backup.accept(&breath);
            assert_eq!(known(&backup) != before, all, "a tick that is missing in a bin does no harm");
            (backup.commands, backup.volumes, backup.course) = {
                let mut again = Backup::new();
                delivered(&mut again, &breath, 0.4, 0.4);
                (again.commands, again.volumes, again.course)
            };
        }
    }

    /// A good breath of 1 s with a constant flow by the sensor and by the model, L/s, and a command of 30 %.
    fn delivered(backup: &mut Backup, breath: &Breath, sensor: f32, model: f32) {
        backup.start_breath();
        for tick in 0..breath.inspiration_ticks() {
            backup.count(sensor, model, 0.001);
            backup.record(&breath.at(tick), 30.0);
        }
        backup.accept(breath);
    }

    /// The command in the middle of an inspiration that has had this volume by the sensor and by the model, L, after good breaths
    /// of 400 mL.
    fn command_after(sensor: f32, model: f32, by_flow: bool) -> f32 {
        let (breath, mut backup) = (breath(25.0), Backup::new());
        delivered(&mut backup, &breath, 0.4, 0.4);
        backup.start_breath();
        backup.count(sensor, model, 1.0);
        backup.command(&breath.at(500), by_flow)
    }

    #[test]
    fn a_volume_behind_its_course_opens_the_valve_further_and_one_ahead_of_it_closes_it() {
        // The bin of the middle ends after 507 or 515 ms.
        let behind = command_after(0.15, 0.2, true);
        assert!((behind - 52.0).abs() < 2.0, "50 mL are missing: {behind} %");
        let ahead = command_after(0.25, 0.2, true);
        assert!((ahead - 12.0).abs() < 2.0, "{ahead} %");
        assert!(command_after(0.38, 0.3, true).abs() < 1e-6, "far ahead");
        assert!((command_after(0.15, 0.2, false) - 30.0).abs() < 1e-3, "without this response");
    }

    #[test]
    fn the_valve_closes_when_the_whole_volume_has_been_delivered() {
        let (breath, mut backup) = (breath(25.0), Backup::new());
        delivered(&mut backup, &breath, 0.4, 0.4);
        backup.start_breath();
        let mut command = |volume: f32| {
            (backup.measured, backup.modelled) = (volume, volume);
            backup.command(&breath.at(999), true)
        };
        assert!(command(399.0) > 29.0 && command(400.1).abs() < 1e-6);
    }

    #[test]
    fn a_flow_sensor_far_from_the_valves_model_is_not_believed() {
        // Half of the model's volume or one and a half, and 50 mL of the circuit.
        for (sensor, sound) in
            [(0.049, false), (0.051, true), (0.349, true), (0.351, false), (f32::NAN, false)]
        {
            let by_flow = (command_after(sensor, 0.2, true) - 30.0).abs() > 1e-3;
            assert_eq!(by_flow, sound, "{sensor}");
        }
    }

    #[test]
    fn a_missing_flow_reading_is_remembered_until_the_next_inspiration() {
        let mut backup = Backup::new();
        backup.count(f32::NAN, 0.4, 0.001);
        backup.count(0.4, 0.4, 0.001);
        assert!(!backup.is_flow_sound());
        backup.start_breath();
        assert!(backup.is_flow_sound());
    }

    #[test]
    fn the_course_is_that_of_breaths_with_a_sound_flow_sensor() {
        let (breath, mut backup) = (breath(25.0), Backup::new());
        let whole = |backup: &Backup| backup.course.map(|course| course.whole as i32);
        let halfway = |backup: &Backup| backup.volumes.good()[31] as i32;
        delivered(&mut backup, &breath, f32::NAN, 0.4);
        delivered(&mut backup, &breath, 0.0, 0.0);
        delivered(&mut backup, &breath, 0.049, 0.1);
        assert_eq!(whole(&backup), None, "what was measured is far from the model");
        delivered(&mut backup, &breath, 0.4001, 0.4);
        delivered(&mut backup, &breath, f32::NAN, 0.4);
        assert_eq!(whole(&backup), Some(400));
        delivered(&mut backup, &breath, 0.5001, 0.4);
        assert_eq!(whole(&backup), Some(430), "a new breath has three tenths");
        assert_eq!(halfway(&backup), 250, "of the last breath");
        // Half of 430 mL.
        backup.start_breath();
        (backup.measured, backup.modelled) = (195.0, 195.0);
        let command = backup.command(&breath.at(499), true);
        assert!((command - 38.0).abs() < 0.5, "{command} %");
    }

    #[test]
    fn the_course_of_another_rise_is_forgotten_and_scaled_down_for_a_smaller_one() {
        let (high, low, mut backup) = (breath(25.0), breath(15.0), Backup::new());
        delivered(&mut backup, &high, 0.4, 0.4);
        backup.start_breath();
        (backup.measured, backup.modelled) = (201.0, 201.0);
        assert!(backup.command(&low.at(999), true).abs() < 1e-6, "half of the rise, half of the volume");
        delivered(&mut backup, &low, f32::NAN, 0.2);
        assert!(backup.course.is_none());
    }
}
