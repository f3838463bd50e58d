//! Gains to search: the grid, and the kinds of controllers that each point belongs to.

use learn::pipeline::AUTHORS_INTEGRAL_S;
use serde::{Deserialize, Serialize};
use shared::control::pid::{GAINS_MAX, PidGains};

/// The parts of a PID that a kind of controller uses.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum PidKind {
    /// Proportional part only.
    POnly,
    /// Integral part only.
    IOnly,
    /// Proportional and integral part.
    Pi,
    /// All three.
    Pid,
}

impl PidKind {
    /// All kinds; each comes after those that it includes.
    pub const ALL: [Self; 4] = [Self::POnly, Self::IOnly, Self::Pi, Self::Pid];

    /// Whether this kind includes a PID with these gains. A part with a gain of zero is unused.
    pub fn includes(self, gains: &PidGains) -> bool {
        let [p, i, d] = self.parts();
        (p || gains.p == 0.0) && (i || gains.i == 0.0) && (d || gains.d == 0.0)
    }

    /// Name for output.
    pub fn name(self) -> &'static str {
        match self {
            Self::POnly => "P",
            Self::IOnly => "I",
            Self::Pi => "PI",
            Self::Pid => "PID",
        }
    }

    /// Which of P, I and D may be non-zero.
    pub(super) fn parts(self) -> [bool; 3] {
        match self {
            Self::POnly => [true, false, false],
            Self::IOnly => [false, true, false],
            Self::Pi => [true, true, false],
            Self::Pid => [true; 3],
        }
    }
}

/// Values of each gain; every combination is searched. Zero is always included.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Grid {
    /// Proportional gains, percent per cmH2O.
    pub p: Vec<f32>,
    /// Integral gains, percent per cmH2O and second.
    pub i: Vec<f32>,
    /// Derivative gains, percent per cmH2O/s.
    pub d: Vec<f32>,
}

impl Default for Grid {
    /// Wider than the optimum of any of the paper's lungs at 1 kHz, and denser at small gains. With R 20 and C 20 the
    /// best PID is near P 7, I 250, D 0.13; with a low resistance the best P-only gain is above 50.
    fn default() -> Self {
        Self::of(20, 24, 8)
    }
}

impl Grid {
    /// The default's range with an eighth of its points.
    pub fn coarse() -> Self {
        Self::of(10, 12, 4)
    }

    /// The default's range with this number of values for each gain.
    fn of(p: usize, i: usize, d: usize) -> Self {
        Self { p: geometric(0.1, 80.0, p), i: geometric(0.5, 5000.0, i), d: geometric(0.01, 0.5, d) }
    }

    /// The authors' grid: P and I on 0, 0.1 .. 0.9, 1 .. 10, no D. Their integral leaks; these gains give a plain
    /// integral the same initial slope.
    pub fn authors() -> Self {
        let fine = (0..10).map(|tenths| tenths as f32 / 10.0);
        let values: Vec<f32> = fine.chain((1..=10).map(|n| n as f32)).collect();
        Self { i: values.iter().map(|gain| gain / AUTHORS_INTEGRAL_S).collect(), p: values, d: vec![0.0] }
    }

    /// A copy with zeros added, in ascending order and without duplicates.
    pub(super) fn completed(&self) -> Self {
        let complete = |values: &[f32]| {
            let mut all: Vec<f32> = values.iter().copied().chain([0.0]).collect();
            all.sort_by(f32::total_cmp);
            all.dedup();
            all
        };
        Self { p: complete(&self.p), i: complete(&self.i), d: complete(&self.d) }
    }

    /// Every combination; D varies fastest.
    pub(super) fn points(&self) -> Vec<PidGains> {
        let mut points = Vec::with_capacity(self.p.len() * self.i.len() * self.d.len());
        for p in &self.p {
            for i in &self.i {
                points.extend(self.d.iter().map(|d| PidGains { p: *p, i: *i, d: *d }));
            }
        }
        points
    }

    /// Distance from the gains to their neighbours in the grid; on each axis, the wider one.
    pub(super) fn spacing(&self, gains: &PidGains) -> [f32; 3] {
        [spacing(&self.p, gains.p), spacing(&self.i, gains.i), spacing(&self.d, gains.d)]
    }
}

/// Zero, then `count` values from `first` to `last` in geometric progression.
fn geometric(first: f32, last: f32, count: usize) -> Vec<f32> {
    let factor = (f64::from(last) / f64::from(first)).powf(1.0 / (count - 1) as f64);
    let values = (0..count).map(|n| (f64::from(first) * factor.powi(n as i32)) as f32);
    [0.0].into_iter().chain(values).collect()
}

/// Gap around a value on an ascending axis: the wider of both sides.
fn spacing(axis: &[f32], value: f32) -> f32 {
    let gaps = axis.windows(2).filter(|pair| pair[0] <= value && value <= pair[1]);
    gaps.map(|pair| pair[1] - pair[0]).fold(0.0, f32::max)
}

/// The neighbours of `gains` at a distance of `step` in the parts of a kind, within the range that a PID accepts.
pub(super) fn around(gains: &PidGains, step: [f32; 3], kind: PidKind) -> Vec<PidGains> {
    let values = |value: f32, step: f32, max: f32, may_move: bool| -> Vec<f32> {
        if !may_move || step == 0.0 {
            return vec![value];
        }
        let lower = (value - step).max(0.0);
        let upper = (value + step).min(max);
        vec![lower, value, upper]
    };
    let [p, i, d] = kind.parts();
    Grid {
        p: values(gains.p, step[0], GAINS_MAX.p, p),
        i: values(gains.i, step[1], GAINS_MAX.i, i),
        d: values(gains.d, step[2], GAINS_MAX.d, d),
    }
    .points()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_default_grid_spans_what_was_asked_of_it() {
        let grid = Grid::default().completed();
        assert_eq!((grid.p.len(), grid.i.len(), grid.d.len()), (21, 25, 9));
        assert_eq!((grid.p[0], grid.i[0], grid.d[0]), (0.0, 0.0, 0.0));
        assert!((grid.p[20] - 80.0).abs() < 1e-3 && (grid.i[24] - 5000.0).abs() < 1e-1);
        assert!((grid.d[8] - 0.5).abs() < 1e-6);
        assert_eq!(grid.points().len(), 21 * 25 * 9);
    }

    #[test]
    fn the_authors_grid_is_twenty_by_twenty_without_a_derivative() {
        let grid = Grid::authors();
        assert_eq!((grid.p.len(), grid.i.len(), grid.d.as_slice()), (20, 20, &[0.0][..]));
        assert!((grid.p[19] - 10.0).abs() < 1e-6 && (grid.i[19] - 18.87).abs() < 0.01);
    }

    #[test]
    fn kinds_are_nested() {
        let gains = |p, i, d| PidGains { p, i, d };
        let kinds = |gains| PidKind::ALL.map(|kind| kind.includes(&gains));
        assert_eq!(kinds(gains(0.0, 0.0, 0.0)), [true; 4]);
        assert_eq!(kinds(gains(1.0, 0.0, 0.0)), [true, false, true, true]);
        assert_eq!(kinds(gains(0.0, 1.0, 0.0)), [false, true, true, true]);
        assert_eq!(kinds(gains(1.0, 1.0, 0.0)), [false, false, true, true]);
        assert_eq!(kinds(gains(0.0, 1.0, 0.1)), [false, false, false, true]);
    }

    #[test]
    fn neighbours_stay_acceptable_and_of_their_kind() {
        let near_zero = PidGains { p: 0.1, i: 1.0, d: 0.0 };
        let neighbours = around(&near_zero, [0.5, 0.5, 0.5], PidKind::Pi);
        assert_eq!(neighbours.len(), 9);
        assert!(neighbours.iter().all(|gains| gains.p >= 0.0 && PidKind::Pi.includes(gains)));
        let highest = around(&GAINS_MAX, [1.0; 3], PidKind::Pid);
        assert!(highest.iter().all(|gains| gains.p <= GAINS_MAX.p && gains.i <= GAINS_MAX.i));
    }

    #[test]
    fn spacing_is_the_wider_gap_beside_a_value() {
        let axis = [0.0, 1.0, 3.0, 10.0];
        for (value, gap) in axis.into_iter().zip([1.0, 2.0, 7.0, 7.0]) {
            assert!((spacing(&axis, value) - gap).abs() < 1e-6);
        }
    }
}
