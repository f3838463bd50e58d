//! Figures of the breaths over 72 hours, minute by minute, for the trends of a page that opens later. Memory is bounded.

use std::array;
use std::collections::VecDeque;

use crate::stream::{BreathFigures, Course, History};

/// Length of a minute, ms.
const MINUTE_MS: u64 = 60_000;
/// Minutes that are kept: 72 hours.
pub const MINUTES: u64 = 72 * 60;
/// Number of figures with a trend.
const COUNT: usize = 10;
/// Takes one figure.
type Figure = fn(&BreathFigures) -> Option<f32>;
/// Figures with a trend: their names in the stream, and where they are.
const TRENDED: [(&str, Figure); COUNT] = [
    ("pip", |figures| figures.pip),
    ("plateau", |figures| figures.plateau),
    ("peep", |figures| figures.peep),
    ("tidal_volume", |figures| figures.tidal_volume),
    ("minute_volume", |figures| figures.minute_volume),
    ("rate", |figures| figures.rate),
    ("resistance", |figures| figures.resistance),
    ("compliance", |figures| figures.compliance),
    ("error", |figures| figures.error),
    ("overshoot", |figures| figures.overshoot),
];
/// Significant digits of a value in the message, less one.
const DIGITS: i32 = 3;

/// Values of one figure in one minute.
#[derive(Clone, Copy, Debug, Default)]
struct Values {
    low: f32,
    high: f32,
    sum: f32,
    count: u16,
}

impl Values {
    fn add(&mut self, value: f32) {
        let Self { low, high, sum, count } = self;
        if *count == u16::MAX {
            return;
        }
        (*low, *high) = if *count == 0 { (value, value) } else { (low.min(value), high.max(value)) };
        *sum += value;
        *count += 1;
    }

    /// Lowest, mean and highest value; NaN without any.
    fn ends(&self) -> [f32; 3] {
        if self.count == 0 {
            return [f32::NAN; 3];
        }
        [self.low, self.sum / f32::from(self.count), self.high]
    }
}

/// A minute with breaths.
#[derive(Clone, Debug)]
struct Minute {
    /// Number since 1970.
    number: u64,
    breaths: u16,
    values: [Values; COUNT],
}

/// The trends of one device; empty before its first breath.
#[derive(Clone, Debug, Default)]
pub struct Trends {
    minutes: VecDeque<Minute>,
}

impl Trends {
    /// Adds the figures of a breath that has ended at a time in ms since 1970. If the clock was set back, it counts to the newest
    /// minute.
    pub fn add(&mut self, now_ms: u64, figures: &BreathFigures) {
        let newest = self.minutes.back().map(|minute| minute.number);
        let number = (now_ms / MINUTE_MS).max(newest.unwrap_or_default());
        if newest != Some(number) {
            self.minutes.push_back(Minute { number, breaths: 0, values: [Values::default(); COUNT] });
            while self.minutes.front().is_some_and(|oldest| oldest.number + MINUTES <= number) {
                self.minutes.pop_front();
            }
        }
        let Some(minute) = self.minutes.back_mut() else { return };
        minute.breaths = minute.breaths.saturating_add(1);
        for (values, (_, figure)) in minute.values.iter_mut().zip(TRENDED) {
            if let Some(value) = figure(figures).filter(|value| value.is_finite()) {
                values.add(value);
            }
        }
    }

    /// What a page gets; none before the first breath.
    pub fn history(&self) -> Option<History> {
        if self.minutes.is_empty() {
            return None;
        }
        let course = |figure: usize| {
            let ends = self.minutes.iter().map(|minute| minute.values[figure].ends().map(short));
            let mut columns: [Vec<f32>; 3] = array::from_fn(|_| Vec::with_capacity(self.minutes.len()));
            for values in ends {
                columns.iter_mut().zip(values).for_each(|(column, value)| column.push(value));
            }
            let [low, mean, high] = columns;
            Course { low, mean, high }
        };
        Some(History {
            minutes: self.minutes.iter().map(|minute| minute.number).collect(),
            breaths: self.minutes.iter().map(|minute| minute.breaths).collect(),
            figures: (0..COUNT).map(|figure| (TRENDED[figure].0, course(figure))).collect(),
        })
    }
}

/// A value with few digits, so that 72 hours are a short message.
fn short(value: f32) -> f32 {
    if value == 0.0 || !value.is_finite() {
        return value;
    }
    let scale = 10_f64.powi(DIGITS - f64::from(value.abs()).log10().floor() as i32);
    ((f64::from(value) * scale).round() / scale) as f32
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::stream::ToPage;
    use proptest::prelude::*;

    const START_MS: u64 = 1_700_000_040_000;

    fn breath(pip: f32) -> BreathFigures {
        BreathFigures { pip: Some(pip), ..BreathFigures::default() }
    }

    fn history(trends: &Trends) -> History {
        trends.history().expect("there was a breath")
    }

    #[test]
    fn a_minute_keeps_the_lowest_the_mean_and_the_highest_value() {
        let mut trends = Trends::default();
        assert!(trends.history().is_none());
        for (second, pip) in [20.0, 30.0, 10.0].into_iter().enumerate() {
            trends.add(START_MS + 1000 * second as u64, &breath(pip));
        }
        trends.add(START_MS + 5000, &BreathFigures { rate: Some(f32::INFINITY), ..BreathFigures::default() });
        trends.add(START_MS + MINUTE_MS, &breath(12.345_678));
        let found = history(&trends);
        assert_eq!(found.minutes, [START_MS / MINUTE_MS, START_MS / MINUTE_MS + 1]);
        assert_eq!(found.breaths, [4, 1]);
        let pip = &found.figures["pip"];
        assert_eq!(
            (&pip.low[..], &pip.mean[..], &pip.high[..]),
            (&[10.0, 12.35][..], &[20.0, 12.35][..], &[30.0, 12.35][..])
        );
        assert!(found.figures["rate"].mean[0].is_nan(), "a rate that is not finite is not known");
    }

    #[test]
    fn a_hundred_hours_leave_the_last_72_in_a_message_of_less_than_a_megabyte() {
        let mut trends = Trends::default();
        for minute in 0..6000_u32 {
            let value = Some(20.0 + (minute % 777) as f32 * 0.0123);
            let figures = BreathFigures {
                pip: value,
                plateau: value,
                peep: value,
                tidal_volume: value,
                minute_volume: value,
                rate: value,
                resistance: value,
                compliance: value,
                error: value,
                overshoot: value,
                ..BreathFigures::default()
            };
            for breath in 0..3 {
                trends.add(START_MS + u64::from(minute) * MINUTE_MS + breath, &figures);
            }
        }
        let found = history(&trends);
        assert_eq!(found.minutes.len() as u64, MINUTES);
        assert_eq!(found.minutes.last(), Some(&(START_MS / MINUTE_MS + 5999)));
        let message = ToPage::History { device: 0, history: found }.to_json();
        assert!(message.len() < 1_000_000, "{} bytes", message.len());
    }

    #[test]
    fn a_clock_that_is_set_back_or_far_ahead_does_no_harm() {
        let mut trends = Trends::default();
        trends.add(START_MS, &breath(20.0));
        trends.add(START_MS - 10 * MINUTE_MS, &breath(30.0));
        assert_eq!(history(&trends).breaths, [2]);
        trends.add(START_MS + 500 * 60 * MINUTE_MS, &breath(10.0));
        assert_eq!(history(&trends).figures["pip"].mean, [10.0]);
    }

    proptest! {
        #[test]
        fn a_short_value_differs_by_less_than_a_thousandth(bits in any::<u32>()) {
            let value = f32::from_bits(bits);
            let found = short(value);
            prop_assert!(
                !value.is_normal() || (found - value).abs() <= 1e-3 * value.abs(),
                "{value} became {found}"
            );
        }
    }
}
