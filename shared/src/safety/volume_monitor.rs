//! Checks what the patient gets: tidal volume, minute volume, and that breaths get through at all. ISO 80601-2-12 demands such
//! monitors.
//!
//! Once per breath, from the volumes that the flow sensor has measured. The expired volume counts: what leaves through a leak
//! ventilates nobody. The limits are settings, and each breath is judged by those that were in force with it, so that no change of the
//! settings needs a wait: a mean volume is compared with the mean of the limits. Without a flow sensor these monitors cannot
//! work, and an alarm says so.

use super::alarms::Fault;
use super::monitors::in_a_row;
use super::volumes::{BreathVolumes, Volumes};
use crate::breath::period_s;
use crate::settings::Settings;

/// Breaths in a row with a tidal or minute volume outside its limits that raise the alarm: so many show that the leak has changed.
pub const BREATHS: u32 = 3;
/// Share of the leak's gas by which the volumes are in doubt: a leak is known to about so much of its size.
pub const DOUBT: f32 = 0.03;
/// Time over which the minute volume is averaged, s. Fulfils: minute-volume-low, minute-volume-high.
pub const AVERAGED: f32 = 30.0;
/// Shorter time that a mean must cover after a change of the leak, if breaths have been measured for [`AVERAGED`], s.
pub const RESTARTED: f32 = 10.0;
/// Smallest volume, in and out, of a breath that gets through, mL: less than a newborn's, and more than the noise of the flow sensor.
pub const DELIVERED: f32 = 3.0;
/// Time without such a breath that is apnoea, s, and the breaths as set that it takes at least. Fulfils: apnoea.
pub const APNOEA: (f32, f32) = (20.0, 2.0);
/// Weight of the time in which gas goes one way only: the leak monitor needs some breaths to learn of a leak that has just opened.
pub const ONE_WAY: f32 = 0.5;
/// From mL/s to L/min.
const LITRES_PER_MINUTE: f32 = 0.06;

/// Findings of a breath: about the tidal volume, the minute volume, apnoea and the flow sensor.
pub type VolumeFindings = [Option<Fault>; 4];

/// Checks the volumes of each breath.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct VolumeMonitor {
    /// Control period, s.
    period: f32,
}

/// State of the volume monitor; all zero before the first breath.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct VolumeState {
    /// Whether the flow of a breath was ever measured.
    exists: bool,
    /// Breaths in a row with a tidal volume below and above its limits.
    low: u32,
    high: u32,
    /// Means over the last breaths, and the breaths in a row in which they are outside their limits.
    mean: MinuteVolumes,
    outside: u32,
    /// The time that they cover, and the time since breaths have been measured, s, up to [`AVERAGED`].
    covers: f32,
    measured: f32,
    /// Time since the last breath that got through, s.
    without: f32,
    /// Whether the last breath was measured with a wrong leak.
    doubtful: bool,
    /// Alarm limits in force with the running breath.
    limits: Limits,
}

/// Alarm limits of the volumes, mL and L/min; 0 for none.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Limits {
    tidal: (f32, f32),
    minute: (f32, f32),
}

impl Limits {
    fn of(settings: &Settings) -> Self {
        Self {
            tidal: (settings.tidal_volume_low, settings.tidal_volume_high),
            minute: (settings.minute_volume_low, settings.minute_volume_high),
        }
    }

    fn any(&self) -> bool {
        [self.tidal.0, self.tidal.1, self.minute.0, self.minute.1].iter().any(|limit| *limit > 0.0)
    }
}

/// Minute volumes with their doubt, and their limits, L/min.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct MinuteVolumes {
    expired: f32,
    inspired: f32,
    doubt: f32,
    low: f32,
    high: f32,
}

impl MinuteVolumes {
    /// Those of a single breath. Without an upper limit it has one that it does not reach.
    fn of(breath: BreathVolumes, seconds: f32, (low, high): (f32, f32)) -> Self {
        let per_minute = LITRES_PER_MINUTE / seconds;
        let [expired, inspired, leaked] =
            [breath.expired, breath.inspired, breath.leaked].map(|volume| per_minute * volume);
        let high = if high > 0.0 { high } else { 2.0 * expired };
        Self { expired, inspired, doubt: DOUBT * leaked, low, high }
    }

    /// Moves the means towards those of a breath of this weight.
    fn add(&mut self, breath: Self, weight: f32) {
        let mix = |mean: &mut f32, value: f32| *mean += weight * (value - *mean);
        mix(&mut self.expired, breath.expired);
        mix(&mut self.inspired, breath.inspired);
        mix(&mut self.doubt, breath.doubt);
        mix(&mut self.low, breath.low);
        mix(&mut self.high, breath.high);
    }

    /// The finding that these minute volumes are.
    fn finding(&self, has_high: bool) -> Option<Fault> {
        let (most, least) = judged(self.inspired, self.expired);
        if most + self.doubt < self.low {
            return Some(Fault::MinuteVolumeLow);
        }
        (has_high && least - self.doubt > self.high).then_some(Fault::MinuteVolumeHigh)
    }
}

impl VolumeState {
    /// The leak has changed: the volumes of the last breath, and of those before, were measured with a wrong one.
    pub fn leak_changed(&mut self) {
        (self.low, self.high, self.outside, self.covers, self.doubtful) = (0, 0, 0, 0.0, true);
    }
}

impl VolumeMonitor {
    /// A monitor for a control period in microseconds.
    pub fn new(period_us: u32) -> Self {
        Self { period: period_s(period_us) }
    }

    /// Judges the volumes of the last breath by its own limits, once, at the beginning of one with these settings.
    pub fn check(&self, state: &mut VolumeState, volumes: &Volumes, settings: &Settings) -> VolumeFindings {
        let limits = core::mem::replace(&mut state.limits, Limits::of(settings));
        if volumes.last_ticks() == 0 {
            return [None; 4];
        }
        let seconds = volumes.last_ticks() as f32 * self.period;
        debug_assert!(seconds > 0.0);
        let Some(breath) = volumes.breath() else {
            let VolumeState { exists, limits, .. } = *state;
            let lost = exists || limits.any();
            *state = VolumeState { exists, limits, ..VolumeState::default() };
            return [None, None, None, lost.then_some(Fault::FlowSensorLost)];
        };
        state.exists = true;
        let apnoea = apnoea(state, volumes.exchange().unwrap_or(breath), seconds, settings);
        if core::mem::take(&mut state.doubtful) {
            return [None, None, apnoea, None];
        }
        let minute = minute_volume(state, breath, seconds, limits.minute);
        [tidal_volume(state, breath, limits.tidal), minute, apnoea, None]
    }
}

/// Counts the time without a breath that gets through, after one of these volumes and this length, s. Gas must go both in and out:
/// an offset of the sensor, an open end, or a leak that is gone, goes only one way. So does a leak that has just opened.
fn apnoea(
    state: &mut VolumeState,
    breath: BreathVolumes,
    seconds: f32,
    settings: &Settings,
) -> Option<Fault> {
    let [goes_in, comes_out] = [breath.inspired, breath.expired].map(|volume| volume >= DELIVERED);
    let weight = if goes_in == comes_out { 1.0 } else { ONE_WAY };
    state.without = if goes_in && comes_out { 0.0 } else { state.without + weight * seconds };
    let longest = APNOEA.0.max(APNOEA.1 * 60.0 / settings.rate);
    (state.without >= longest).then_some(Fault::Apnoea)
}

/// The volumes that are compared with a lower and an upper limit: the expired one, unless its mean with the inspired one is within
/// the limit. While a leak is believed to be larger or smaller than it is, half of the difference is missing in one of them, and the
/// other half is too much in the other.
pub(super) fn judged(inspired: f32, expired: f32) -> (f32, f32) {
    let mean = 0.5 * (inspired + expired);
    (expired.max(mean), expired.min(mean))
}

/// Compares a tidal volume with its limits. Fulfils: tidal-volume-low, tidal-volume-high.
fn tidal_volume(state: &mut VolumeState, breath: BreathVolumes, (low, high): (f32, f32)) -> Option<Fault> {
    let (most, least) = judged(breath.inspired, breath.expired);
    let doubt = DOUBT * breath.leaked;
    state.low = in_a_row(state.low, most + doubt < low);
    state.high = in_a_row(state.high, high > 0.0 && least - doubt > high);
    if state.low >= BREATHS {
        return Some(Fault::TidalVolumeLow);
    }
    (state.high >= BREATHS).then_some(Fault::TidalVolumeHigh)
}

/// Adds a breath of these volumes and this length, s, with its limits, L/min, to the means, and compares them.
fn minute_volume(
    state: &mut VolumeState,
    breath: BreathVolumes,
    seconds: f32,
    limits: (f32, f32),
) -> Option<Fault> {
    [state.covers, state.measured] =
        [state.covers, state.measured].map(|time| (time + seconds).min(AVERAGED));
    debug_assert!(state.covers <= state.measured, "what begins to be measured restarts both");
    // A plain mean at first, so that no breath counts more than another.
    state.mean.add(MinuteVolumes::of(breath, seconds, limits), seconds / state.covers);
    let finding = state.mean.finding(limits.1 > 0.0);
    state.outside = in_a_row(state.outside, finding.is_some());
    let lasts = state.outside >= BREATHS && state.measured >= AVERAGED && state.covers >= RESTARTED;
    finding.filter(|_| lasts)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::breath::paper_settings;
    use std::vec::Vec;

    /// 20 breaths a minute, in ticks of 10 ms.
    const PERIOD_US: u32 = 10_000;

    fn limits(tidal: (f32, f32), minute: (f32, f32)) -> Settings {
        Settings {
            tidal_volume_low: tidal.0,
            tidal_volume_high: tidal.1,
            minute_volume_low: minute.0,
            minute_volume_high: minute.1,
            ..paper_settings(20.0)
        }
    }

    /// A monitor with its state and settings.
    struct Run {
        state: VolumeState,
        volumes: Volumes,
        settings: Settings,
    }

    impl Run {
        fn new(settings: Settings) -> Self {
            let mut run = Self { state: VolumeState::default(), volumes: Volumes::default(), settings };
            assert_eq!(run.check(), [], "the first breath");
            run
        }

        /// The findings after a breath of a tidal volume, mL, of NaN for an unmeasured one, as long as the rate says.
        fn breath(&mut self, tidal: f32) -> Vec<Fault> {
            let ticks = (6000.0 / self.settings.rate + 0.5) as u32;
            for tick in 0..ticks {
                let flow = if tick < ticks / 2 { tidal } else { -tidal } / 10.0 / (ticks / 2) as f32;
                self.volumes.add(flow, 9.0, 0.0, 0.01);
            }
            self.volumes.start_breath();
            self.check()
        }

        fn check(&mut self) -> Vec<Fault> {
            let monitor = VolumeMonitor::new(PERIOD_US);
            let found = monitor.check(&mut self.state, &self.volumes, &self.settings);
            found.into_iter().flatten().collect()
        }

        /// The number of breaths of this volume until an alarm, of at most 100.
        fn until(&mut self, tidal: f32, fault: Fault) -> Option<usize> {
            (1..=100).find(|_| self.breath(tidal).contains(&fault))
        }

        /// All alarms in this number of breaths.
        fn breaths(&mut self, count: usize, tidal: f32) -> Vec<Fault> {
            let mut found: Vec<_> = (0..count).flat_map(|_| self.breath(tidal)).collect();
            found.dedup();
            found
        }
    }

    /// Verifies: tidal-volume-low.
    #[test]
    fn three_small_breaths_in_a_row_are_an_alarm_that_ends_with_a_normal_one() {
        let mut run = Run::new(limits((300.0, 0.0), (0.0, 0.0)));
        assert_eq!(run.breaths(50, 310.0), []);
        assert_eq!(run.breaths(2, 290.0), []);
        assert_eq!(run.breaths(1, 310.0), []);
        assert_eq!(run.until(290.0, Fault::TidalVolumeLow), Some(3));
        assert_eq!(run.breath(290.0), [Fault::TidalVolumeLow], "as long as it lasts");
        assert_eq!(run.breath(310.0), []);
    }

    /// Verifies: tidal-volume-high.
    #[test]
    fn three_large_breaths_in_a_row_are_an_alarm_that_ends_with_a_normal_one() {
        let mut run = Run::new(limits((0.0, 500.0), (0.0, 0.0)));
        assert_eq!(run.breaths(50, 490.0), []);
        assert_eq!(run.breaths(2, 510.0), []);
        assert_eq!(run.breaths(1, 490.0), []);
        assert_eq!(run.until(510.0, Fault::TidalVolumeHigh), Some(3));
        assert_eq!(run.breath(510.0), [Fault::TidalVolumeHigh]);
        assert_eq!(run.breath(490.0), []);
    }

    #[test]
    fn a_volume_at_its_limit_is_within_it() {
        let mut state = VolumeState::default();
        let settings = Limits::of(&limits((300.0, 500.0), (6.0, 10.0)));
        for _ in 0..9 {
            assert_eq!(tidal_volume(&mut state, tight(300.0), settings.tidal), None);
            assert_eq!(tidal_volume(&mut state, tight(500.0), settings.tidal), None);
        }
        let at = |minute: f32| {
            let [covers, measured] = [AVERAGED; 2];
            let volume = minute * 50.0;
            let mean = MinuteVolumes::of(tight(volume), 3.0, settings.minute);
            let mut state = VolumeState { mean, covers, measured, outside: 2, ..VolumeState::default() };
            minute_volume(&mut state, tight(volume), 3.0, settings.minute)
        };
        assert_eq!([at(6.0), at(10.0)], [None; 2]);
        assert_eq!([at(5.9), at(10.1)], [Some(Fault::MinuteVolumeLow), Some(Fault::MinuteVolumeHigh)]);
    }

    /// The volumes of a breath behind a tight circuit.
    fn tight(volume: f32) -> BreathVolumes {
        BreathVolumes { inspired: volume, expired: volume, leaked: 0.0 }
    }

    #[test]
    fn three_percent_of_the_leaks_gas_are_in_doubt() {
        let Limits { tidal: of_tidal, minute: of_minute } = Limits::of(&limits((300.0, 500.0), (6.0, 10.0)));
        let tidal = |expired| {
            let (mut state, breath) =
                (VolumeState::default(), BreathVolumes { leaked: 200.0, ..tight(expired) });
            (0..BREATHS).fold(None, |_, _| tidal_volume(&mut state, breath, of_tidal))
        };
        assert_eq!((tidal(294.0), tidal(506.0)), (None, None));
        assert_eq!((tidal(293.0), tidal(507.0)), (Some(Fault::TidalVolumeLow), Some(Fault::TidalVolumeHigh)));
        // 20 breaths a minute: 200 mL of the leak in each are 4 L/min.
        let minute = |expired| {
            let (mut state, breath) =
                (VolumeState::default(), BreathVolumes { leaked: 200.0, ..tight(expired) });
            (0..10).fold(None, |_, _| minute_volume(&mut state, breath, 3.0, of_minute))
        };
        assert_eq!((minute(295.0), minute(505.0)), (None, None));
        assert_eq!(
            (minute(293.0), minute(507.0)),
            (Some(Fault::MinuteVolumeLow), Some(Fault::MinuteVolumeHigh))
        );
    }

    #[test]
    fn a_tidal_volume_is_outside_its_limits_if_what_came_out_is_and_its_mean_with_what_went_in() {
        let found = |inspired, expired| {
            let (mut state, breath) =
                (VolumeState::default(), BreathVolumes { inspired, expired, leaked: 0.0 });
            (0..BREATHS).fold(None, |_, _| tidal_volume(&mut state, breath, (300.0, 500.0)))
        };
        // A leak that has just come adds to what goes in and takes from what comes out.
        assert_eq!((found(400.0, 200.0), found(399.0, 200.0)), (None, Some(Fault::TidalVolumeLow)));
        assert_eq!((found(200.0, 300.0), found(200.0, 299.0)), (None, Some(Fault::TidalVolumeLow)));
        // And one that has just gone does the opposite.
        assert_eq!((found(400.0, 600.0), found(401.0, 600.0)), (None, Some(Fault::TidalVolumeHigh)));
        assert_eq!((found(600.0, 500.0), found(600.0, 501.0)), (None, Some(Fault::TidalVolumeHigh)));
    }

    #[test]
    fn without_limits_no_volume_is_an_alarm() {
        for tidal in [5.0, 5000.0] {
            assert_eq!(Run::new(limits((0.0, 0.0), (0.0, 0.0))).breaths(100, tidal), []);
        }
    }

    /// Verifies: minute-volume-low, minute-volume-high.
    #[test]
    fn a_minute_volume_is_judged_after_half_a_minute_of_three_breaths_or_more() {
        // 20 breaths a minute: ten in 30 s, and 8 L/min at 400 mL.
        for (minute, fault) in [((8.2, 0.0), Fault::MinuteVolumeLow), ((0.0, 7.8), Fault::MinuteVolumeHigh)] {
            assert_eq!(Run::new(limits((0.0, 0.0), minute)).until(400.0, fault), Some(10));
        }
        assert_eq!(Run::new(limits((0.0, 0.0), (7.8, 8.2))).breaths(100, 400.0), []);
        // At 5 breaths a minute, a leak that has changed is known after the third.
        let mut slow = Run::new(Settings { rate: 5.0, ..limits((0.0, 0.0), (0.0, 3.0)) });
        assert_eq!(slow.breaths(20, 500.0), []);
        assert_eq!(slow.until(900.0, Fault::MinuteVolumeHigh), Some(3), "one breath is enough for the mean");
    }

    #[test]
    fn a_minute_volume_is_the_mean_of_the_first_half_minute_and_then_forgets_slowly() {
        let mut run = Run::new(limits((0.0, 0.0), (0.0, 0.0)));
        run.breaths(5, 200.0);
        run.breaths(5, 600.0);
        assert!((run.state.mean.expired - 8.0).abs() < 0.01, "{}", run.state.mean.expired);
        // Each further breath of 3 s has a tenth of the mean.
        run.breaths(1, 900.0);
        assert!((run.state.mean.expired - 9.0).abs() < 0.01, "{}", run.state.mean.expired);
    }

    #[test]
    fn a_minute_volume_is_outside_its_limits_if_what_came_out_is_and_its_mean_with_what_went_in() {
        for ((inspired, expired), wanted) in
            [((8.0, 8.0), (8.0, 8.0)), ((20.0, 0.0), (10.0, 0.0)), ((6.0, 10.0), (10.0, 8.0))]
        {
            assert_eq!(judged(inspired, expired), wanted);
            let breath = BreathVolumes { inspired: 50.0 * inspired, expired: 50.0 * expired, leaked: 0.0 };
            let found = |low: f32, high: f32| {
                let mut state = VolumeState { measured: AVERAGED, ..VolumeState::default() };
                (0..10).fold(None, |_, _| minute_volume(&mut state, breath, 3.0, (low, high)))
            };
            assert_eq!(found(wanted.0 + 0.01, 0.0), Some(Fault::MinuteVolumeLow));
            assert_eq!(found(wanted.0 - 0.01, wanted.1 + 0.01), None);
            assert!(wanted.1 <= 0.0 || found(0.0, wanted.1 - 0.01) == Some(Fault::MinuteVolumeHigh));
        }
        let mut state = VolumeState::default();
        let breath = BreathVolumes { inspired: 300.0, expired: 500.0, leaked: 0.0 };
        for _ in 0..3 {
            minute_volume(&mut state, breath, 3.0, (0.0, 0.0));
        }
        assert!((state.mean.inspired - 6.0).abs() < 1e-4 && (state.mean.expired - 10.0).abs() < 1e-4);
    }

    #[test]
    fn a_minute_volume_that_falls_to_nothing_is_an_alarm_within_half_a_minute() {
        let mut run = Run::new(limits((0.0, 0.0), (4.0, 0.0)));
        assert_eq!(run.breaths(20, 400.0), []);
        // 0.9 to the power of 7 is 0.48; and two more.
        assert_eq!(run.until(0.0, Fault::MinuteVolumeLow), Some(7 + 2));
        assert_eq!(run.breaths(1, 900.0), [], "and ends when enough gas comes");
    }

    #[test]
    fn each_breath_is_judged_by_the_limits_in_force_with_it() {
        let mut run = Run::new(limits((300.0, 0.0), (0.0, 0.0)));
        run.breaths(20, 310.0);
        // The breath that ends when the new limits begin has the old ones.
        run.settings = limits((400.0, 0.0), (0.0, 0.0));
        assert_eq!(run.until(310.0, Fault::TidalVolumeLow), Some(1 + 3));
        run.settings = limits((300.0, 0.0), (0.0, 0.0));
        assert_eq!(run.breaths(9, 310.0), [Fault::TidalVolumeLow], "that of the last breath");
        assert_eq!(run.breath(310.0), []);
    }

    #[test]
    fn settings_that_change_in_every_breath_hide_no_volume() {
        let changing = |tidal: (f32, f32), minute: (f32, f32), volume: f32, fault: Fault| {
            let mut run = Run::new(limits(tidal, minute));
            let mut breath = |number: usize, volume: f32| {
                run.settings.rate = [20.0, 20.1][number % 2];
                run.settings.pressure_limit = [60.0, 61.0][number % 2];
                run.breath(volume)
            };
            assert!((0..30).all(|number| breath(number, 400.0).is_empty()));
            (1..100).find(|number| breath(*number, volume).contains(&fault))
        };
        assert_eq!(changing((300.0, 0.0), (0.0, 0.0), 290.0, Fault::TidalVolumeLow), Some(3));
        assert_eq!(changing((0.0, 500.0), (0.0, 0.0), 510.0, Fault::TidalVolumeHigh), Some(3));
        // 0.9 to the power of 7 is 0.48; and two more.
        assert_eq!(changing((0.0, 0.0), (4.0, 0.0), 0.0, Fault::MinuteVolumeLow), Some(7 + 2));
        assert_eq!(changing((0.0, 0.0), (0.0, 12.0), 1000.0, Fault::MinuteVolumeHigh), Some(4 + 2));
    }

    #[test]
    fn a_mean_is_compared_with_the_mean_of_its_limits() {
        // 8 L/min with limits that suit it, and then 4 with half of them.
        let mut run = Run::new(limits((0.0, 0.0), (6.0, 10.0)));
        run.breaths(20, 400.0);
        run.settings = limits((0.0, 0.0), (3.0, 5.0));
        assert_eq!(run.breath(400.0), [], "the last breath with the old ones");
        assert_eq!(run.breaths(50, 200.0), []);
        // Nor is the last breath judged by a lower limit that no breath reaches.
        let mut run = Run::new(limits((0.0, 0.0), (6.0, 0.0)));
        run.breaths(20, 400.0);
        run.settings = limits((0.0, 0.0), (60.0, 0.0));
        assert_eq!(run.until(400.0, Fault::MinuteVolumeLow), Some(1 + 3));
        // A first upper limit, a little below what the patient gets, takes half a minute.
        let mut run = Run::new(limits((0.0, 0.0), (0.0, 0.0)));
        run.breaths(20, 400.0);
        run.settings = limits((0.0, 0.0), (0.0, 7.0));
        assert!(run.until(400.0, Fault::MinuteVolumeHigh).is_some_and(|breaths| (10..30).contains(&breaths)));
    }

    #[test]
    fn volumes_that_were_measured_with_a_wrong_leak_do_not_count() {
        let mut run = Run::new(limits((300.0, 0.0), (6.0, 0.0)));
        run.breaths(2, 200.0);
        run.state.leak_changed();
        // The last breath, then three in a row.
        assert_eq!(run.until(200.0, Fault::TidalVolumeLow), Some(1 + 3));
        run.breaths(20, 400.0);
        run.state.leak_changed();
        assert_eq!(run.until(290.0, Fault::MinuteVolumeLow), Some(1 + 4), "more than 10 s");
        // 12 s each: the breaths outside before do not count either.
        let mut slow = Run::new(Settings { rate: 5.0, ..limits((0.0, 0.0), (0.0, 3.0)) });
        assert_eq!((slow.breaths(20, 500.0), slow.breaths(2, 900.0)), (Vec::new(), Vec::new()));
        slow.state.leak_changed();
        assert_eq!(slow.until(900.0, Fault::MinuteVolumeHigh), Some(1 + 3));
    }

    #[test]
    fn a_mean_covers_10_s_of_30_s_of_measured_breaths_before_it_is_judged() {
        let is_judged = |covers, measured| {
            let limits = (6.0, 0.0);
            let mean = MinuteVolumes { low: 6.0, ..MinuteVolumes::default() };
            let mut state = VolumeState { mean, covers, measured, outside: 2, ..VolumeState::default() };
            minute_volume(&mut state, tight(50.0), 3.0, limits).is_some()
        };
        assert!(is_judged(7.0, 27.0) && !is_judged(6.9, 27.0) && !is_judged(7.0, 26.9));
    }

    /// Verifies: apnoea.
    #[test]
    fn twenty_seconds_without_a_breath_are_apnoea() {
        let mut run = Run::new(paper_settings(20.0));
        assert_eq!(run.breaths(20, 3.1), []);
        // 3 s each.
        assert_eq!(run.until(2.9, Fault::Apnoea), Some(7));
        assert_eq!(run.breath(2.9), [Fault::Apnoea]);
        assert_eq!(run.breath(3.1), []);
        assert_eq!(run.until(0.0, Fault::Apnoea), Some(7));
    }

    #[test]
    fn gas_that_only_goes_in_or_only_comes_out_is_no_breath() {
        let is_apnoea = |inspired, expired| {
            let mut state = VolumeState { without: 25.0, ..VolumeState::default() };
            apnoea(&mut state, BreathVolumes { inspired, expired, leaked: 0.0 }, 3.0, &paper_settings(20.0))
                .is_some()
        };
        assert!(is_apnoea(900.0, 2.9) && is_apnoea(2.9, 900.0));
        assert!(!is_apnoea(900.0, 3.0) && !is_apnoea(3.0, 900.0));
    }

    #[test]
    fn gas_that_goes_one_way_may_be_that_of_a_new_leak_and_counts_half() {
        let until = |inspired, expired| {
            let (mut state, breath) =
                (VolumeState::default(), BreathVolumes { inspired, expired, leaked: 0.0 });
            (1..99).find(|_| apnoea(&mut state, breath, 1.0, &paper_settings(20.0)).is_some())
        };
        assert_eq!([until(0.0, 0.0), until(2.9, 2.9)], [Some(20); 2]);
        assert_eq!([until(3.0, 2.9), until(2.9, 3.0)], [Some(40); 2]);
        assert_eq!(until(3.0, 3.0), None);
    }

    #[test]
    fn apnoea_takes_two_breaths_as_set() {
        let slow = Settings { rate: 5.0, ..paper_settings(20.0) };
        let mut run = Run::new(slow);
        assert_eq!(run.until(0.0, Fault::Apnoea), Some(2), "24 s");
        let mut run = Run::new(Settings { rate: 6.0, ..slow });
        assert_eq!(run.until(0.0, Fault::Apnoea), Some(2), "20 s");
        let after = |without: f32| {
            let mut state = VolumeState { without, ..VolumeState::default() };
            // Efforts can make a breath shorter.
            apnoea(&mut state, tight(0.0), 3.0, &slow)
        };
        assert_eq!((after(20.9), after(21.0)), (None, Some(Fault::Apnoea)));
    }

    /// Verifies: flow-sensor-lost.
    #[test]
    fn a_lost_flow_sensor_is_the_only_alarm_about_volumes() {
        let mut run = Run::new(limits((300.0, 0.0), (6.0, 0.0)));
        run.breaths(20, 400.0);
        assert_eq!(run.breaths(50, f32::NAN), [Fault::FlowSensorLost]);
        assert_eq!(run.breaths(2, 0.0), [], "nothing is left from before");
        assert_eq!(run.until(0.0, Fault::TidalVolumeLow), Some(1));
    }

    #[test]
    fn a_sensor_that_never_was_is_missing_only_if_a_limit_needs_it() {
        assert_eq!(Run::new(paper_settings(20.0)).breaths(20, f32::NAN), []);
        let off = (0.0, 0.0);
        for settings in [
            limits((300.0, 0.0), off),
            limits((0.0, 500.0), off),
            limits(off, (4.0, 0.0)),
            limits(off, (0.0, 9.0)),
        ] {
            assert_eq!(Run::new(settings).breath(f32::NAN), [Fault::FlowSensorLost]);
        }
        let mut run = Run::new(paper_settings(20.0));
        run.breath(400.0);
        for _ in 0..3 {
            assert_eq!(run.breath(f32::NAN), [Fault::FlowSensorLost]);
        }
    }

    #[test]
    fn before_the_first_breath_nothing_is_missing() {
        let settings = limits((300.0, 0.0), (0.0, 0.0));
        let (mut state, volumes) = (VolumeState::default(), Volumes::default());
        let found = VolumeMonitor::new(PERIOD_US).check(&mut state, &volumes, &settings);
        let begun = VolumeState { limits: Limits::of(&settings), ..VolumeState::default() };
        assert_eq!((found, state), ([None; 4], begun));
    }
}
