//! Means over the end of an expiration, also of one that an effort ends early.
//!
//! The expiration, with the fall, is divided into windows of equal length, the last of which ends when the next breath is due. An expiration
//! that ends in time is judged by its last window. One that an effort ends is judged by the last window but one, which lies
//! before the effort.

use crate::breath::Moment;

/// Means of `N` signals over the windows of the running expiration.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Windows<const N: usize> {
    sums: [f32; N],
    count: u32,
    /// Last tick that was added, of its breath.
    tick: u32,
    last: Option<[f32; N]>,
    before: Option<[f32; N]>,
}

impl<const N: usize> Default for Windows<N> {
    fn default() -> Self {
        Self { sums: [0.0; N], count: 0, tick: 0, last: None, before: None }
    }
}

impl<const N: usize> Windows<N> {
    /// Adds the values of a tick of a breath, if there are any and the tick belongs to a window of `length` ticks. The windows begin
    /// with the fall from PIP: an effort may end the expiration there.
    #[inline]
    pub fn add(&mut self, moment: &Moment, length: u32, values: Option<[f32; N]>) {
        if moment.tick == 0 {
            *self = Self::default();
        }
        let left = moment.left();
        let belongs = left > 0 && (left <= length || !moment.inspires());
        if !belongs {
            return;
        }
        let place = (left - 1) % length;
        if moment.tick.wrapping_sub(self.tick) >= length - place {
            // A window starts. The end of the one before may not have been added: there was no reading.
            (self.sums, self.count) = ([0.0; N], 0);
        }
        self.tick = moment.tick;
        if let Some(values) = values {
            self.sums.iter_mut().zip(values).for_each(|(sum, value)| *sum += value);
            self.count += 1;
        }
        debug_assert!(self.count <= length, "a window ends after its length");
        if place == 0 {
            let Self { sums, count, last, .. } = core::mem::take(self);
            let mean = (count > 0).then(|| sums.map(|sum| sum / count as f32));
            (self.before, self.last) = (last, mean);
        }
    }

    /// Means over the last whole window; none before its end or without values.
    pub fn last(&self) -> Option<[f32; N]> {
        self.last
    }

    /// Falls from the last whole window but one to the last; none without both.
    pub fn fall(&self) -> Option<[f32; N]> {
        let (before, last) = (self.before?, self.last?);
        Some(core::array::from_fn(|n| before[n] - last[n]))
    }

    /// Means over the last whole window but one.
    pub fn before(&self) -> Option<[f32; N]> {
        self.before
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::breath::{Breath, DEFAULT_PERIOD_US, paper_settings};
    use crate::settings::Settings;

    const LENGTH: u32 = 50;

    /// The windows after a breath up to a tick, of a signal that is its tick.
    fn until(breath: &Breath, end: u32, value: impl Fn(u32) -> Option<f32>) -> Windows<1> {
        let mut windows = Windows::default();
        (0..end).for_each(|tick| windows.add(&breath.at(tick), LENGTH, value(tick).map(|value| [value])));
        windows
    }

    fn paper() -> Breath {
        Breath::new(&paper_settings(25.0), DEFAULT_PERIOD_US).unwrap()
    }

    #[test]
    fn the_last_window_ends_when_the_next_breath_is_due() {
        let windows = until(&paper(), 3000, |tick| Some(tick as f32));
        assert_eq!((windows.last(), windows.before()), (Some([2974.5]), Some([2924.5])));
        assert_eq!((windows.fall(), until(&paper(), 1099, |_| Some(1.0)).fall()), (Some([-50.0]), None));
    }

    #[test]
    fn a_window_whose_end_is_not_added_is_left_out() {
        let (breath, mut windows) = (paper(), Windows::<1>::default());
        for tick in (0..3000).filter(|tick| !(2940..2970).contains(tick)) {
            windows.add(&breath.at(tick), LENGTH, Some([tick as f32]));
        }
        assert_eq!((windows.last(), windows.before()), (Some([2984.5]), Some([2874.5])));
    }

    #[test]
    fn the_window_before_the_last_is_older_than_a_window_at_any_tick() {
        for end in 1100..3000 {
            let [before] = until(&paper(), end, |tick| Some(tick as f32)).before().unwrap();
            let age = end as f32 - 0.5 - before;
            assert!((74.0..=125.0).contains(&age), "{age} ticks from its middle at {end}");
        }
    }

    #[test]
    fn windows_begin_with_the_fall_and_each_breath_has_its_own() {
        let breath = paper();
        assert_eq!(until(&breath, 1049, |_| Some(1.0)).last(), None, "not the inspiration");
        assert_eq!(until(&breath, 1050, |_| Some(1.0)).last(), Some([1.0]));
        assert_eq!(until(&breath, 1099, |_| Some(1.0)).before(), None);
        let mut windows = until(&breath, 3000, |_| Some(1.0));
        windows.add(&breath.at(0), LENGTH, Some([1.0]));
        assert_eq!(windows, Windows::default());
    }

    #[test]
    fn a_breath_without_an_expiration_has_the_end_of_its_fall() {
        let settings = Settings { rate: 40.0, ..paper_settings(25.0) };
        let breath = Breath::new(&settings, DEFAULT_PERIOD_US).unwrap();
        assert_eq!(until(&breath, 1500, |tick| Some(tick as f32)).last(), Some([1474.5]));
    }

    #[test]
    fn ticks_without_a_value_do_not_count() {
        let odd = until(&paper(), 3000, |tick| (tick % 2 == 1).then_some(tick as f32));
        assert_eq!(odd.last(), Some([2975.0]));
        assert_eq!(until(&paper(), 3000, |_| None).last(), None);
    }

    #[test]
    fn a_window_without_its_end_counts_for_no_later_one() {
        // The readings are lost in the middle of a window, and are back in the next breath's expiration.
        let (breath, mut windows) = (paper(), Windows::default());
        (0..1030).for_each(|tick| windows.add(&breath.at(tick), LENGTH, Some([100.0])));
        (1000..1100).for_each(|tick| windows.add(&breath.at(tick), LENGTH, Some([1.0])));
        assert_eq!((windows.last(), windows.before()), (Some([1.0]), Some([1.0])));
    }

    #[test]
    fn nothing_is_added_after_the_due_end() {
        let windows = until(&paper(), 3200, |tick| Some(tick as f32));
        assert_eq!(windows.last(), Some([2974.5]));
    }
}
