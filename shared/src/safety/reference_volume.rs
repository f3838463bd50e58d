//! Checks the volume of a breath against those that the patient had before: it needs no alarm limit.
//!
//! A tube that narrows, a bronchospasm, a pneumothorax or a tube in one main stem takes volume at the same pressure. Breaths
//! that lose a third within a minute are an alarm; it is of high priority if they lose half, or if that lasts.
//!
//! What a patient's efforts add to his breaths comes and goes. So not single breaths are compared but groups, each by the breath
//! that is largest for its settings, and the reference is the smallest group of some minutes: only a group much smaller than all
//! of these counts. The reference leaves out the last minute, in which the breaths may have become smaller step by step. Other
//! settings let expect what the lung takes at least: in proportion to a lower driving pressure and to a shorter time, but no more
//! at higher ones. So the reference outlasts settings that change in every breath.
//!
//! The check needs a flow sensor that measures about what the valve's model delivers.

use super::alarms::Fault;
use super::settling::{exchange_time, filling_time};
use super::volume_monitor::{DOUBT, judged};
use super::volumes::{BreathVolumes, Volumes};
use crate::settings::Settings;

/// Share of the reference below which breaths have become much smaller. Fulfils: ventilation-falls.
pub const FALLS: f32 = 0.67;
/// Share below which a fraction of them is left. Fulfils: ventilation-lost.
pub const LOST: f32 = 0.5;
/// Least breaths of a group, and the least time that it covers, s.
pub const GROUP: (u8, f32) = (3, 8.5);
/// Time below [`FALLS`] that is an alarm, s; a group below [`LOST`] is one at once.
pub const LASTS: f32 = 20.0;
/// Groups in a row below [`LOST`] that are an alarm of high priority.
pub const LOST_GROUPS: u8 = 2;
/// Time below [`FALLS`] after which the alarm has high priority, s.
pub const PERSISTS: f32 = 60.0;
/// Time below [`FALLS`] after which the smaller breaths become the reference, s: the alarm has long been raised.
pub const ADOPTED: f32 = 300.0;
/// Time of which the smallest group is kept, s. The reference is that of the `OLDER` such times before the last two.
pub const SPAN: f32 = 60.0;
const OLDER: usize = 3;
/// Least groups of such a time, after which the first one ends.
const FIRST_GROUPS: u8 = 2;
/// Share of the volume up to which the gas of a leak may pass beside it in a breath that becomes part of the reference.
const LEAKY: f32 = 0.5;
/// Multiple of the inspired gas of which more comes out only if a patient presses: no breath, and nothing to compare.
const PRESSED: f32 = 2.0;
/// Share of the volume that a lung loses per cmH2O of a higher PEEP: near its full size it is stiffer.
const STIFFENS: f32 = 0.02;

/// What a breath is driven by. Fulfils: settled-volumes.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Drive {
    /// Rise from PEEP to PIP, and PEEP, cmH2O.
    rise: f32,
    peep: f32,
    /// Of an inspiration, its [`filling_time`]; of a whole breath its [`exchange_time`], s.
    time: f32,
}

impl Drive {
    fn of(settings: &Settings) -> Self {
        let Settings { pip, peep, inspiratory_time, rise_time, .. } = *settings;
        Self { rise: pip - peep, peep, time: filling_time(inspiratory_time, rise_time) }
    }
}

/// A breath: its volume, mL, and what has driven it. Without a volume it is none.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Driven {
    volume: f32,
    drive: Drive,
}

impl Driven {
    /// The least volume that the same lung takes when it is driven otherwise, mL.
    fn least_at(&self, drive: &Drive) -> f32 {
        let (before, higher) = (&self.drive, (drive.peep - self.drive.peep).max(0.0));
        let pressure = (drive.rise / before.rise).min(1.0);
        let time = (drive.time / before.time).min(1.0);
        self.volume * pressure * time * (1.0 - STIFFENS * higher).max(0.0)
    }
}

/// State of the check; all zero before the first breath.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ReferenceVolume {
    /// What drives the running inspiration, and its length, s.
    running: Drive,
    inspiration: f32,
    /// The smallest groups: of the running [`SPAN`], and of those before, the newest first.
    smallest: [Driven; OLDER + 2],
    /// Time of the running [`SPAN`], s, and its groups.
    covers: f32,
    groups: u8,
    group: Group,
    /// Groups in a row below [`LOST`], and the time for which groups have been below [`FALLS`], s.
    lost: u8,
    small: f32,
    /// Whether that is an alarm.
    falls: bool,
    /// Whether the last breath was measured with a wrong leak.
    doubtful: bool,
    /// Whether the last breath took in less gas than [`FALLS`].
    takes_little: bool,
}

/// The running group.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Group {
    /// The largest breath: it tells the most of other settings, which may only take from it.
    best: Driven,
    breaths: u8,
    seconds: f32,
    /// Whether a breath has reached [`FALLS`] and [`LOST`].
    reaches: (bool, bool),
    /// Whether a leak makes a volume too uncertain to become part of the reference.
    leaks: bool,
}

impl ReferenceVolume {
    /// The leak has changed: the volume of the last breath was measured with a wrong one.
    pub fn leak_changed(&mut self) {
        self.doubtful = true;
    }

    /// Whether the last breath took in much less gas than those before. A leak takes more.
    pub fn takes_little(&self) -> bool {
        self.takes_little
    }

    /// Judges the volume of the last breath, once, at the beginning of one with these settings. `sound`: the flow sensor has
    /// measured about what the valve has delivered, to a connected patient.
    pub fn check(
        &mut self,
        volumes: &Volumes,
        sound: bool,
        period: f32,
        settings: &Settings,
    ) -> Option<Fault> {
        let seconds = volumes.last_ticks() as f32 * period;
        let emptying = (seconds - self.inspiration).max(0.0);
        let drive = Drive { time: exchange_time(self.running.time, emptying), ..self.running };
        (self.running, self.inspiration) = (Drive::of(settings), settings.inspiratory_time);
        let doubtful = core::mem::take(&mut self.doubtful);
        match volumes.breath().filter(|_| sound && volumes.last_ticks() > 0) {
            Some(_) if doubtful => self.group = Group::default(),
            Some(breath) if breath.expired > PRESSED * breath.inspired => {}
            Some(breath) => self.add(breath, drive, seconds),
            // What was found before is not known any more.
            None => {
                (self.group, self.takes_little) = (Group::default(), false);
                self.recover();
            }
        }
        let lost = self.lost >= LOST_GROUPS || self.small >= PERSISTS;
        self.falls.then_some(if lost { Fault::VentilationLost } else { Fault::VentilationFalls })
    }

    /// No breath is known to be small any more.
    fn recover(&mut self) {
        (self.small, self.lost, self.falls) = (0.0, 0, false);
    }

    /// The least volume that the reference lets expect of a breath, mL; 0 before there is one.
    fn expected(&self, drive: &Drive) -> f32 {
        let least = |groups: &[Driven]| {
            let known = groups.iter().filter(|group| group.volume > 0.0);
            known.map(|group| group.least_at(drive)).reduce(f32::min)
        };
        let (newer, older) = self.smallest.split_at(2);
        least(older).or_else(|| least(&newer[1..])).unwrap_or(0.0)
    }

    /// Adds a breath to the running group. While a leak is believed to be larger or smaller than it is, half of the error is
    /// missing in what goes in or comes out, and the other half is too much in the other: the larger value is judged,
    /// and the smaller one becomes part of the reference.
    fn add(&mut self, breath: BreathVolumes, drive: Drive, seconds: f32) {
        let (most, least) = judged(breath.inspired, breath.expired);
        let most = most + DOUBT * breath.leaked;
        let expected = self.expected(&drive);
        self.takes_little = breath.inspired + breath.leaked < FALLS * expected;
        let group = &mut self.group;
        group.reaches.0 |= most >= FALLS * expected;
        group.reaches.1 |= most >= LOST * expected;
        group.leaks |= breath.leaked > LEAKY * breath.inspired;
        if group.breaths == 0 || least > group.best.volume {
            group.best = Driven { volume: least, drive };
        }
        (group.breaths, group.seconds) = (group.breaths.saturating_add(1), group.seconds + seconds);
        if group.breaths >= GROUP.0 && group.seconds >= GROUP.1 {
            self.end_group();
        }
    }

    /// Judges a whole group, or makes it part of the reference.
    fn end_group(&mut self) {
        let group = core::mem::take(&mut self.group);
        if group.reaches.0 {
            self.recover();
            self.learn(&group);
            return;
        }
        self.small += group.seconds;
        self.lost = if group.reaches.1 { 0 } else { self.lost.saturating_add(1) };
        self.falls |= self.lost > 0 || self.small >= LASTS;
        if self.small >= ADOPTED {
            (self.smallest, self.covers, self.groups) = Default::default();
            self.recover();
        }
    }

    /// Makes a group part of the reference, unless it leaks: then only its time passes, until nothing of the reference is left.
    fn learn(&mut self, group: &Group) {
        let smallest = &mut self.smallest[0];
        if !group.leaks {
            if self.groups == 0 || group.best.volume < smallest.least_at(&group.best.drive) {
                *smallest = group.best;
            }
            self.groups = self.groups.saturating_add(1);
        }
        self.covers += group.seconds;
        let enough = self.groups >= FIRST_GROUPS;
        let is_first = self.smallest[1].volume <= 0.0 && enough;
        if is_first || self.covers >= SPAN {
            // A single group between leaks may be that of a strain.
            if !enough {
                self.smallest[0] = Driven::default();
            }
            self.smallest.rotate_right(1);
            (self.smallest[0], self.covers, self.groups) = (Driven::default(), 0.0, 0);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::breath::paper_settings;
    use std::vec::Vec;

    /// Control period, s.
    const PERIOD: f32 = 0.01;

    /// A patient of the check.
    struct Run {
        reference: ReferenceVolume,
        volumes: Volumes,
        settings: Settings,
        sound: bool,
    }

    impl Run {
        /// A patient who has had 400 mL in each breath of two minutes.
        fn new() -> Self {
            Self::at(paper_settings(25.0))
        }

        fn at(settings: Settings) -> Self {
            let mut run = Self {
                reference: ReferenceVolume::default(),
                volumes: Volumes::default(),
                settings,
                sound: true,
            };
            run.check();
            assert_eq!(run.breaths(40, 400.0), []);
            run
        }

        fn check(&mut self) -> Option<Fault> {
            self.reference.check(&self.volumes, self.sound, PERIOD, &self.settings)
        }

        /// The finding after a breath that takes one volume in and gives another out, mL, and lasts as set.
        fn breath_of(&mut self, inspired: f32, expired: f32) -> Option<Fault> {
            self.breath_lasting(60.0 / self.settings.rate, inspired, expired)
        }

        fn breath_lasting(&mut self, seconds: f32, inspired: f32, expired: f32) -> Option<Fault> {
            let ticks = (100.0 * seconds + 0.5) as u32;
            for tick in 0..ticks {
                let flow = if tick < ticks / 2 { inspired } else { -expired };
                self.volumes.add(flow / 10.0 / (ticks / 2) as f32, 9.0, 0.0, 0.01);
            }
            self.volumes.start_breath();
            self.check()
        }

        fn breath(&mut self, volume: f32) -> Option<Fault> {
            self.breath_of(volume, volume)
        }

        /// All findings in this number of breaths.
        fn breaths(&mut self, count: usize, volume: f32) -> Vec<Fault> {
            let mut found: Vec<_> = (0..count).filter_map(|_| self.breath(volume)).collect();
            found.dedup();
            found
        }

        /// The breaths of this volume until an alarm, of at most 200.
        fn until(&mut self, volume: f32, fault: Fault) -> Option<usize> {
            (1..=200).find(|_| self.breath(volume) == Some(fault))
        }
    }

    /// Verifies: ventilation-falls, ventilation-lost.
    #[test]
    fn a_loss_of_a_third_is_an_alarm_and_urgent_after_a_minute() {
        assert_eq!(Run::new().breaths(60, 270.0), []);
        let mut run = Run::new();
        let falls = run.until(265.0, Fault::VentilationFalls).unwrap();
        assert!((9..=11).contains(&falls), "three whole groups of 9 s: {falls}");
        // And four more.
        assert_eq!(run.until(265.0, Fault::VentilationLost), Some(12));
        // At 60 breaths a minute a group has nine of them.
        let mut run =
            Run::at(Settings { rate: 60.0, inspiratory_time: 0.3, fall_time: 0.3, ..paper_settings(25.0) });
        assert!(run.until(265.0, Fault::VentilationFalls).is_some_and(|falls| (27..=35).contains(&falls)));
    }

    /// Verifies: ventilation-lost.
    #[test]
    fn a_loss_of_half_is_urgent_in_the_second_group() {
        let mut run = Run::new();
        let falls = run.until(195.0, Fault::VentilationFalls).unwrap();
        assert!((3..=5).contains(&falls), "a whole group: {falls}");
        assert_eq!(run.until(195.0, Fault::VentilationLost), Some(3));
        assert!(Run::new().until(5.0, Fault::VentilationLost).is_some_and(|breaths| breaths <= 8));
    }

    #[test]
    fn gas_that_a_patient_presses_out_is_no_breath_that_reaches_the_volume() {
        let mut run = Run::new();
        run.until(195.0, Fault::VentilationFalls).unwrap();
        for _ in 0..20 {
            assert!(run.breath(195.0).is_some() && run.breath_of(100.0, 700.0).is_some());
        }
        run.breath(400.0);
        assert_eq!(run.breaths(2, 400.0).last(), None, "a whole breath is one");
    }

    #[test]
    fn a_loss_that_develops_within_a_minute_is_an_alarm_and_a_slower_one_is_none() {
        let fades = |breaths: usize| {
            let mut run = Run::new();
            let faded =
                (0..breaths).find_map(|number| run.breath(400.0 - 160.0 * number as f32 / breaths as f32));
            faded.or_else(|| run.breaths(12, 240.0).first().copied())
        };
        assert_eq!(fades(20), Some(Fault::VentilationFalls));
        assert_eq!(fades(200), None);
    }

    #[test]
    fn an_alarm_ends_with_a_group_that_has_a_whole_breath() {
        let mut run = Run::new();
        run.until(195.0, Fault::VentilationLost).unwrap();
        let found: Vec<_> = (0..6).map(|_| run.breath(300.0)).collect();
        assert_eq!(found.iter().flatten().count(), 2, "until the group has ended: {found:?}");
    }

    #[test]
    fn two_small_breaths_of_three_are_none_whatever_adds_to_the_third() {
        let mut run = Run::new();
        for _ in 0..100 {
            assert_eq!(run.breaths(2, 100.0), []);
            assert_eq!(run.breath(420.0), None);
        }
    }

    #[test]
    fn efforts_that_come_and_go_are_known_from_the_minutes_before() {
        let mut run = Run::at(paper_settings(25.0));
        // Half a minute with them, and half a minute without.
        let mut half = |volume: f32| run.breaths(10, volume);
        half(900.0);
        for _ in 0..20 {
            assert_eq!([half(400.0), half(900.0)], [[], []]);
        }
    }

    #[test]
    fn a_larger_volume_is_the_reference_after_some_minutes() {
        let mut run = Run::new();
        assert_eq!(run.breaths(120, 800.0), []);
        assert!(run.until(390.0, Fault::VentilationFalls).is_some_and(|breaths| breaths <= 5));
    }

    #[test]
    fn after_five_minutes_the_smaller_breaths_are_the_reference() {
        let mut run = Run::new();
        run.until(195.0, Fault::VentilationLost).unwrap();
        // 100 breaths of 3 s.
        assert_eq!(run.breaths(90, 195.0), [Fault::VentilationLost]);
        run.breaths(10, 195.0);
        assert_eq!(run.breaths(40, 195.0), []);
        assert!(run.until(90.0, Fault::VentilationFalls).is_some_and(|breaths| breaths <= 5));
    }

    /// Verifies: settled-volumes.
    #[test]
    fn what_the_operator_takes_away_is_no_loss() {
        let before = paper_settings(25.0);
        let takes = |now: Settings, volume: f32| {
            let mut run = Run::at(before);
            run.settings = now;
            // The breath that ends has the old ones.
            assert_eq!(run.breath(400.0), None);
            run.breaths(12, volume).first().copied()
        };
        let falls = Some(Fault::VentilationFalls);
        // Half of the driving pressure.
        let lower = Settings { pip: 15.0, ..before };
        assert_eq!((takes(lower, 200.0), takes(lower, 130.0)), (None, falls));
        // 0.25 s against 2.75 s instead of 1 s against 2 s, and a rise of 1 s: for the slowest lung 34 % and 60 %.
        let shorter = Settings { inspiratory_time: 0.25, ..before };
        assert_eq!((takes(shorter, 136.0), takes(shorter, 88.0)), (None, falls));
        let slower = Settings { rise_time: 1.0, ..before };
        assert_eq!((takes(slower, 240.0), takes(slower, 157.0)), (None, falls));
        // A PEEP of 15: the same driving pressure in a stiffer part of the lung.
        let higher = Settings { peep: 15.0, pip: 35.0, ..before };
        assert_eq!((takes(higher, 320.0), takes(higher, 210.0)), (None, falls));
        // More pressure or time takes nothing away.
        let more = Settings { pip: 40.0, inspiratory_time: 1.5, ..before };
        assert_eq!((takes(more, 280.0), takes(more, 260.0)), (None, falls));
    }

    /// Verifies: settled-volumes.
    #[test]
    fn settings_that_change_in_every_breath_hide_no_loss() {
        let mut run = Run::new();
        let mut breath = |number: usize, share: f32| {
            let full = run.settings.pip > 22.0;
            run.settings.pip = [25.0, 20.0][number % 2];
            run.breath(share * if full { 400.0 } else { 300.0 })
        };
        assert!((0..200).all(|number| breath(number, 1.0).is_none()));
        let found = (0..20).find(|number| breath(*number, 0.6) == Some(Fault::VentilationFalls));
        assert!(found.is_some_and(|breaths| breaths <= 12), "{found:?}");
    }

    #[test]
    fn a_breath_that_an_effort_ends_early_may_give_out_less() {
        let mut run = Run::new();
        // 1 s in and 0.5 s out: for the slowest lung half of what 2 s let out.
        assert!((0..40).all(|_| run.breath_lasting(1.5, 205.0, 205.0).is_none()));
        let mut run = Run::new();
        assert!((0..30).any(|_| run.breath_lasting(1.5, 120.0, 120.0) == Some(Fault::VentilationFalls)));
    }

    #[test]
    fn an_error_of_the_leak_moves_both_volumes_and_hides_in_neither() {
        // A leak that has just come adds to what goes in and takes from what comes out, and one that has gone does the opposite.
        for (inspired, expired) in [(700.0, 100.0), (100.0, 700.0)] {
            let mut run = Run::new();
            assert!((0..9).all(|_| run.breath_of(inspired, expired).is_none()));
        }
        let mut run = Run::new();
        assert!((0..12).any(|_| run.breath_of(500.0, 0.0) == Some(Fault::VentilationFalls)));
    }

    #[test]
    fn a_breath_measured_with_a_wrong_leak_does_not_count() {
        let mut run = Run::new();
        for _ in 0..20 {
            run.reference.leak_changed();
            assert_eq!(run.breath(5.0), None);
        }
        assert!(run.until(5.0, Fault::VentilationFalls).is_some());
        run.reference.leak_changed();
        assert_eq!(run.breath(400.0), Some(Fault::VentilationFalls), "and ends no alarm");
    }

    #[test]
    fn without_a_sound_flow_sensor_nothing_is_known() {
        let mut run = Run::new();
        run.sound = false;
        assert_eq!(run.breaths(50, 5.0), []);
        run.sound = true;
        run.until(195.0, Fault::VentilationFalls).unwrap();
        assert_eq!(run.breath(f32::NAN), None);
        assert_eq!(run.breaths(2, 195.0), [], "a new group");
        run.until(195.0, Fault::VentilationFalls).unwrap();
    }

    #[test]
    fn before_there_is_a_reference_nothing_has_fallen() {
        let mut run = Run::new();
        run.reference = ReferenceVolume::default();
        run.check();
        assert_eq!(run.breaths(2, 400.0), []);
        assert_eq!(run.breaths(30, 100.0), [], "the smaller one of the first two groups");
    }

    #[test]
    fn a_breath_with_little_gas_is_told() {
        let mut run = Run::new();
        let mut tells = |inspired: f32, expired: f32| {
            run.breath_of(inspired, expired);
            run.reference.takes_little()
        };
        assert!(!tells(280.0, 0.0) && tells(260.0, 0.0) && !tells(900.0, 0.0));
    }

    #[test]
    fn volumes_beside_a_large_leak_are_judged_and_no_reference() {
        let learns = |leaked: f32| {
            let mut reference =
                ReferenceVolume { running: Drive::of(&paper_settings(25.0)), ..Default::default() };
            let breath = BreathVolumes { inspired: 400.0, expired: 400.0, leaked };
            let drive = Drive { time: 1.0, ..reference.running };
            (0..10).for_each(|_| reference.add(breath, drive, 3.0));
            let known = reference.expected(&drive) > 0.0;
            let small = BreathVolumes { inspired: 100.0, expired: 100.0, leaked };
            (0..10).for_each(|_| reference.add(small, drive, 3.0));
            (known, reference.falls)
        };
        assert_eq!((learns(199.0), learns(201.0)), ((true, true), (false, false)));
        let mut run = Run::new();
        let leaky = BreathVolumes { inspired: 190.0, expired: 190.0, leaked: 200.0 };
        let drive = Drive { time: 1.0, ..run.reference.running };
        (0..6).for_each(|_| run.reference.add(leaky, drive, 3.0));
        assert!(run.reference.falls, "judged by what was learned before");
        // In seven minutes beside the leak nothing is left of that.
        let leaky = BreathVolumes { inspired: 300.0, expired: 300.0, leaked: 400.0 };
        (0..140).for_each(|_| run.reference.add(leaky, drive, 3.0));
        assert!(run.reference.expected(&drive).abs() < 1e-6);
    }

    #[test]
    fn a_single_group_in_a_minute_of_leaks_is_no_reference() {
        let drive = Drive::of(&paper_settings(25.0));
        let of = |volume, leaked| BreathVolumes { inspired: volume, expired: volume, leaked };
        let after = |groups: usize| {
            let mut reference = ReferenceVolume::default();
            (0..60).for_each(|_| reference.add(of(500.0, 400.0), drive, 3.0));
            // The leak ends while the patient strains.
            (0..3 * groups).for_each(|_| reference.add(of(1300.0, 0.0), drive, 3.0));
            reference.expected(&drive) > 0.0
        };
        assert_eq!([1, 3].map(after), [false, true]);
    }
}
