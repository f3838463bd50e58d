//! Marks of an axis.

use super::curve::Limits;

/// About `count` round values within a positive range: decades, or 1, 2, 5 of each, or even steps in a narrow range.
pub(super) fn logarithmic((low, high): Limits, count: usize) -> Vec<f64> {
    let decades = (high / low).log10();
    if decades < 0.9 {
        return linear((low, high), count);
    }
    let count = count.max(2) as f64;
    let (first, last) = (low.log10().floor() as i32, high.log10().ceil() as i32);
    let within = |value: &f64| (low..=high).contains(value);
    if decades < 0.5 * count {
        let digits = |power: i32| [1.0, 2.0, 5.0].map(|digit| digit * 10_f64.powi(power));
        return (first..=last).flat_map(digits).filter(within).collect();
    }
    let every = (decades / count).ceil().max(1.0) as usize;
    let start = first - first.rem_euclid(every as i32);
    (start..=last).step_by(every).map(|power| 10_f64.powi(power)).filter(within).collect()
}

/// About `count` even steps of 1, 2 or 5 within a range, at most half the range wide, so that at least two marks are inside.
pub(super) fn linear((low, high): Limits, count: usize) -> Vec<f64> {
    let widest = 2.0 * (high - low) / count.max(4) as f64;
    let power = 10_f64.powf(widest.log10().floor());
    let step =
        [5.0, 2.0].map(|digit| digit * power).into_iter().find(|&step| step <= widest).unwrap_or(power);
    ((low / step).ceil() as i64..=(high / step).floor() as i64).map(|count| count as f64 * step).collect()
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    #[test]
    fn marks_suit_the_width_of_the_range() {
        assert_eq!(
            logarithmic((0.9, 1.65), 6),
            [1.0, 1.2, 1.4, 1.6].map(|mark: f64| (mark / 0.2).round() * 0.2)
        );
        assert_eq!(logarithmic((6.1e-5, 1.44e-4), 4).len(), 4);
        assert_eq!(logarithmic((0.8, 60.0), 6), [1.0, 2.0, 5.0, 10.0, 20.0, 50.0]);
        assert_eq!(logarithmic((1e-3, 1e2), 6).len(), 6);
        assert_eq!(logarithmic((1e-9, 1e9), 6), [1e-9, 1e-6, 1e-3, 1.0, 1e3, 1e6, 1e9]);
    }

    proptest! {
        #[test]
        fn every_range_has_some_marks_all_within(low_power in -9.0..9.0_f64, decades in 0.05..12.0_f64, count in 4..10_usize) {
            let low = 10_f64.powf(low_power);
            let high = low * 10_f64.powf(decades);
            let marks = logarithmic((low, high), count);
            prop_assert!((2..=2 * count).contains(&marks.len()), "{:?}", marks);
            let slack = 1e-9 * high;
            prop_assert!(marks.iter().all(|&mark| (low - slack..=high + slack).contains(&mark)));
            prop_assert!(marks.is_sorted());
        }
    }
}
