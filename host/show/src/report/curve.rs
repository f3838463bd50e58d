//! Prepares the points of a curve for drawing: fewer points, steps, and clipping at the frame.

/// A point in data units.
pub(super) type Point = (f64, f64);

/// Lower and upper end of an axis.
pub(super) type Limits = (f64, f64);

/// At most `limit` points with the same appearance: first, lowest, highest and last of each of `limit / 4` equal parts.
pub(super) fn decimate(points: &[Point], limit: usize) -> Vec<Point> {
    if points.len() <= limit {
        return points.to_vec();
    }
    let part = points.len().div_ceil((limit / 4).max(1));
    points.chunks(part).flat_map(extremes).collect()
}

fn extremes(part: &[Point]) -> Vec<Point> {
    let by_y = |a: &usize, b: &usize| part[*a].1.total_cmp(&part[*b].1);
    let lowest = (0..part.len()).min_by(by_y);
    let highest = (0..part.len()).max_by(by_y);
    let mut kept: Vec<usize> =
        [Some(0), lowest, highest, part.len().checked_sub(1)].into_iter().flatten().collect();
    kept.sort_unstable();
    kept.dedup();
    kept.into_iter().map(|index| part[index]).collect()
}

/// Holds each value until the next point.
pub(super) fn steps(points: &[Point]) -> Vec<Point> {
    let mut stairs = Vec::with_capacity(2 * points.len());
    for pair in points.windows(2) {
        stairs.extend([pair[0], (pair[1].0, pair[0].1)]);
    }
    stairs.extend(points.last());
    stairs
}

/// Whether a point is inside the frame or on it.
pub(super) fn inside(point: Point, x: Limits, y: Limits) -> bool {
    (x.0..=x.1).contains(&point.0) && (y.0..=y.1).contains(&point.1)
}

/// The parts of a curve within the frame, clipped where it crosses the frame.
pub(super) fn clip(points: &[Point], x: Limits, y: Limits) -> Vec<Vec<Point>> {
    let mut parts: Vec<Vec<Point>> = Vec::new();
    for pair in points.windows(2) {
        let Some((from, to)) = clip_segment(pair[0], pair[1], x, y) else {
            continue;
        };
        match parts.last_mut() {
            // A curve that touches the frame and returns has not left it.
            Some(part) if part.last() == Some(&from) => part.push(to),
            _ => parts.push(vec![from, to]),
        }
    }
    parts
}

/// Liang-Barsky clipping: the share of a segment between each pair of parallel edges.
fn clip_segment(from: Point, to: Point, x: Limits, y: Limits) -> Option<(Point, Point)> {
    let (mut enter, mut leave) = (0.0_f64, 1.0_f64);
    for (start, step, (low, high)) in [(from.0, to.0 - from.0, x), (from.1, to.1 - from.1, y)] {
        if step == 0.0 {
            if !(low..=high).contains(&start) {
                return None;
            }
            continue;
        }
        let (a, b) = ((low - start) / step, (high - start) / step);
        enter = enter.max(a.min(b));
        leave = leave.min(a.max(b));
    }
    let at = |share: f64| match share {
        0.0 => from,
        1.0 => to,
        _ => (
            (from.0 + share * (to.0 - from.0)).clamp(x.0, x.1),
            (from.1 + share * (to.1 - from.1)).clamp(y.0, y.1),
        ),
    };
    (enter <= leave).then(|| (at(enter), at(leave)))
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    #[test]
    fn short_curves_stay_as_they_are() {
        let points = [(0.0, 1.0), (1.0, 2.0)];
        assert_eq!(decimate(&points, 1_500), points);
    }

    #[test]
    fn a_single_spike_survives_decimation() {
        let mut points: Vec<_> = (0..100_000).map(|i| (f64::from(i), 0.0)).collect();
        points[54_321].1 = 9.0;
        let few = decimate(&points, 1_500);
        assert!(few.len() <= 1_500 && few.contains(&(54_321.0, 9.0)));
    }

    #[test]
    fn steps_hold_the_value() {
        assert_eq!(steps(&[(0.0, 1.0), (1.0, 5.0)]), [(0.0, 1.0), (1.0, 1.0), (1.0, 5.0)]);
        assert!(steps(&[]).is_empty());
    }

    #[test]
    fn a_curve_is_cut_where_it_leaves_the_frame() {
        let zigzag = [(0.0, 0.0), (2.0, 2.0), (4.0, 0.0)];
        let parts = clip(&zigzag, (0.0, 4.0), (0.0, 1.0));
        assert_eq!(parts, [vec![(0.0, 0.0), (1.0, 1.0)], vec![(3.0, 1.0), (4.0, 0.0)]]);
        assert!(clip(&[(0.0, 5.0), (4.0, 5.0)], (0.0, 4.0), (0.0, 1.0)).is_empty());
    }

    proptest! {
        #[test]
        fn decimation_keeps_extremes_order_and_ends(
            ys in prop::collection::vec(-1e3..1e3_f64, 1..3_000),
            limit in 8..200_usize,
        ) {
            let points: Vec<_> = ys.iter().enumerate().map(|(i, &y)| (i as f64, y)).collect();
            let few = decimate(&points, limit);
            prop_assert!(few.len() <= limit);
            prop_assert!(few.windows(2).all(|pair| pair[0].0 < pair[1].0));
            prop_assert_eq!((few.first(), few.last()), (points.first(), points.last()));
            let top = |list: &[Point]| list.iter().map(|p| p.1).fold(f64::MIN, f64::max);
            let bottom = |list: &[Point]| list.iter().map(|p| p.1).fold(f64::MAX, f64::min);
            prop_assert_eq!((top(&few), bottom(&few)), (top(&points), bottom(&points)));
        }

        #[test]
        fn clipped_curves_lie_within_the_frame_and_keep_what_was_inside(
            points in prop::collection::vec((-3.0..3.0_f64, -3.0..3.0_f64), 2..50),
        ) {
            let frame = (-1.0, 1.0);
            let parts = clip(&points, frame, frame);
            prop_assert!(parts.iter().flatten().all(|&point| inside(point, frame, frame)));
            for point in points.iter().filter(|&&point| inside(point, frame, frame)) {
                prop_assert!(parts.iter().flatten().any(|kept| kept == point));
            }
        }
    }
}
