//! Stability margins from a measured loop gain.
//!
//! The loop gain is interpolated between the measured frequencies: the logarithm of its magnitude and its unwrapped angle are taken
//! as straight over the logarithm of the frequency.

use std::f64::consts::{PI, TAU};

use num_complex::Complex64;
use serde::{Deserialize, Serialize};

use super::response::ResponsePoint;

/// Margins of a stable closed loop. A margin that has no crossing within the measured frequencies is absent.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Margins {
    /// Largest sensitivity abs(1 / (1 + L)), Ms.
    pub ms: f64,
    /// Its frequency, Hz.
    pub ms_hz: f64,
    /// Least factor above one on the loop gain that makes the loop unstable.
    pub gain_margin: Option<f64>,
    /// Least angle between L and -1 where abs(L) is one, degrees.
    pub phase_margin_deg: Option<f64>,
    /// Least additional dead time that makes the loop unstable, ms.
    pub delay_margin_ms: Option<f64>,
    /// Disk margin, without skew: any factor on the loop gain within the disk from `(2 - a) / (2 + a)` to `(2 + a) / (2 - a)`, also a
    /// complex one, leaves the loop stable.
    pub disk_margin: f64,
    /// Highest frequency at which abs(L) is one, Hz.
    pub crossover_hz: Option<f64>,
    /// Frequency of the gain margin, where L is real and negative, Hz.
    pub opposite_hz: Option<f64>,
}

impl Margins {
    /// The margins of a loop; none without a response of at least two frequencies.
    pub fn of(response: &[ResponsePoint]) -> Option<Self> {
        let (ms, ms_hz) = peak(response, Complex64::norm)?;
        // Of S - T = 2 S - 1.
        let (balance, _) = peak(response, |s| (s * 2.0 - Complex64::ONE).norm())?;
        let curve = Curve::new(response);
        let unity: Vec<Crossing> = curve.crossings(|point| point.log_size, 0.0);
        let angles: Vec<f64> = unity.iter().map(|at| at.angle + PI).collect();
        let opposite = curve.opposite().into_iter().map(|at| ((-at.log_size).exp(), at.hz));
        let opposite =
            opposite.filter(|(factor, _)| *factor > 1.0).min_by(|one, other| one.0.total_cmp(&other.0));
        let delays = unity.iter().zip(&angles).map(|(at, angle)| angle.rem_euclid(TAU) / (TAU * at.hz));
        Some(Self {
            ms,
            ms_hz,
            gain_margin: opposite.map(|(factor, _)| factor),
            phase_margin_deg: least(angles.iter().map(|angle| unwrapped(*angle, 0.0).abs().to_degrees())),
            delay_margin_ms: least(delays.map(|delay| 1e3 * delay)),
            disk_margin: 2.0 / balance,
            crossover_hz: unity.last().map(|at| at.hz),
            opposite_hz: opposite.map(|(_, hz)| hz),
        })
    }

    /// The worst of several loops, margin by margin; the crossover is the highest.
    #[must_use]
    pub fn worst(self, other: &Self) -> Self {
        let lower = |one: Option<f64>, other: Option<f64>| least(one.into_iter().chain(other));
        let higher = if other.ms > self.ms { other } else { &self };
        let factor = |margins: &Self| margins.gain_margin.unwrap_or(f64::INFINITY);
        let lowest = if factor(other) < factor(&self) { other } else { &self };
        Self {
            ms: higher.ms,
            ms_hz: higher.ms_hz,
            gain_margin: lower(self.gain_margin, other.gain_margin),
            phase_margin_deg: lower(self.phase_margin_deg, other.phase_margin_deg),
            delay_margin_ms: lower(self.delay_margin_ms, other.delay_margin_ms),
            disk_margin: self.disk_margin.min(other.disk_margin),
            crossover_hz: self.crossover_hz.into_iter().chain(other.crossover_hz).reduce(f64::max),
            opposite_hz: lowest.opposite_hz,
        }
    }

    /// Whether the margins keep a requirement; an absent margin is beyond the measured frequencies and keeps it.
    pub fn keeps(&self, required: &RequiredMargins) -> bool {
        let at_least = |margin: Option<f64>, bound| margin.is_none_or(|margin| margin >= bound);
        self.ms <= required.ms
            && at_least(self.gain_margin, required.gain_margin)
            && at_least(self.delay_margin_ms, required.delay_margin_ms)
    }
}

/// Margins that a robust loop keeps.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct RequiredMargins {
    /// Highest Ms.
    pub ms: f64,
    /// Lowest gain margin.
    pub gain_margin: f64,
    /// Lowest delay margin, ms.
    pub delay_margin_ms: f64,
}

impl Default for RequiredMargins {
    fn default() -> Self {
        Self { ms: 2.0, gain_margin: 2.0, delay_margin_ms: 10.0 }
    }
}

fn least(values: impl Iterator<Item = f64>) -> Option<f64> {
    values.reduce(f64::min)
}

/// The highest value of a function of the sensitivity, and its frequency in Hz, from a parabola through the highest measured value
/// and its neighbours.
fn peak(response: &[ResponsePoint], value: impl Fn(Complex64) -> f64) -> Option<(f64, f64)> {
    let values: Vec<(f64, f64)> =
        response.iter().map(|point| (point.hz.ln(), value(point.sensitivity()).ln())).collect();
    let highest = (0..values.len()).max_by(|one, other| values[*one].1.total_cmp(&values[*other].1))?;
    let (x, y) = values[highest];
    let neighbours = highest.checked_sub(1).and_then(|left| Some((values[left], *values.get(highest + 1)?)));
    let Some(((left, low), (right, high))) = neighbours else { return Some((y.exp(), x.exp())) };
    let (before, after) = ((y - low) / (x - left), (high - y) / (right - x));
    let bend = (after - before) / (right - left);
    if bend >= 0.0 {
        return Some((y.exp(), x.exp()));
    }
    let slope = before + bend * (x - left);
    let top = x - slope / (2.0 * bend);
    Some(((y - slope * slope / (4.0 * bend)).exp(), top.exp()))
}

/// The angle in radians that differs from this one by whole turns and lies within half a turn of `near`.
fn unwrapped(angle: f64, near: f64) -> f64 {
    angle + TAU * ((near - angle) / TAU).round()
}

/// A measured loop gain, with unwrapped angles.
struct Curve(Vec<CurvePoint>);

#[derive(Clone, Copy)]
struct CurvePoint {
    log_hz: f64,
    log_size: f64,
    angle: f64,
}

/// Where the curve crosses a level.
struct Crossing {
    hz: f64,
    log_size: f64,
    angle: f64,
}

impl Curve {
    fn new(response: &[ResponsePoint]) -> Self {
        // The first angle lies between 0 and -360 degrees: a loop gain with an integral starts near -90.
        let mut near = -PI;
        let point = |point: &ResponsePoint| {
            near = unwrapped(point.loop_gain.arg(), near);
            CurvePoint { log_hz: point.hz.ln(), log_size: point.loop_gain.norm().ln(), angle: near }
        };
        Self(response.iter().map(point).collect())
    }

    /// Where a value crosses a level, from the lowest frequency on.
    fn crossings(&self, value: impl Fn(&CurvePoint) -> f64, level: f64) -> Vec<Crossing> {
        let crossing = |pair: &[CurvePoint]| {
            let (from, to) = (value(&pair[0]) - level, value(&pair[1]) - level);
            if (from >= 0.0) == (to >= 0.0) {
                return None;
            }
            let share = from / (from - to);
            let at =
                |value: fn(&CurvePoint) -> f64| value(&pair[0]) + share * (value(&pair[1]) - value(&pair[0]));
            Some(Crossing {
                hz: at(|point| point.log_hz).exp(),
                log_size: at(|point| point.log_size),
                angle: at(|point| point.angle),
            })
        };
        self.0.windows(2).filter_map(crossing).collect()
    }

    /// Where the loop gain is real and negative.
    fn opposite(&self) -> Vec<Crossing> {
        let turns = |angle: f64| ((angle + PI) / TAU).floor() as i32;
        let ends = self.0.iter().map(|point| turns(point.angle));
        let (low, high) =
            ends.fold((i32::MAX, i32::MIN), |(low, high), turn| (low.min(turn), high.max(turn)));
        (low..=high)
            .flat_map(|turn| self.crossings(|point| point.angle, TAU * f64::from(turn) - PI))
            .collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The response of a loop gain given as a function of the frequency in Hz.
    fn response(loop_gain: impl Fn(f64) -> Complex64) -> Vec<ResponsePoint> {
        (0..32)
            .map(|place| 0.5 * 80.0_f64.powf(f64::from(place) / 31.0))
            .map(|hz| ResponsePoint { hz, loop_gain: loop_gain(hz), path: Complex64::ONE })
            .collect()
    }

    /// An integrator with this gain in 1/s behind a dead time in s.
    fn integrator(gain: f64, dead_time: f64) -> Vec<ResponsePoint> {
        response(|hz| {
            let omega = TAU * hz;
            Complex64::cis(-omega * dead_time - PI / 2.0) * (gain / omega)
        })
    }

    fn near(value: f64, wanted: f64) {
        assert!((value / wanted - 1.0).abs() < 0.01, "{value}, not {wanted}");
    }

    #[test]
    fn an_integrator_behind_a_dead_time_has_the_margins_of_the_textbook() {
        let (gain, dead_time) = (20.0, 0.03);
        let margins = Margins::of(&integrator(gain, dead_time)).unwrap();
        near(margins.gain_margin.unwrap(), PI / (2.0 * gain * dead_time));
        near(margins.phase_margin_deg.unwrap(), (PI / 2.0 - gain * dead_time).to_degrees());
        near(margins.delay_margin_ms.unwrap(), 1e3 * (PI / 2.0 - gain * dead_time) / gain);
        near(margins.crossover_hz.unwrap(), gain / TAU);
        let fine = (1..400_000).map(|n| f64::from(n) * 1e-4).map(|hz| {
            let omega = TAU * hz;
            let l = Complex64::cis(-omega * dead_time - PI / 2.0) * (gain / omega);
            let s = Complex64::ONE / (Complex64::ONE + l);
            (s.norm(), (s - Complex64::from(0.5)).norm())
        });
        let (ms, disk) = fine.fold((0.0_f64, 0.0_f64), |(ms, disk), (s, d)| (ms.max(s), disk.max(d)));
        near(margins.ms, ms);
        near(margins.disk_margin, 1.0 / disk);
    }

    #[test]
    fn of_several_crossovers_the_least_margin_counts() {
        // A resonance lifts the loop gain above one again, at a higher frequency and a later phase.
        let margins = Margins::of(&response(|hz| {
            let size = if hz < 3.0 { 1.5 / hz } else { 2.0 * (-(hz / 10.0).ln().powi(2) * 4.0).exp() };
            Complex64::cis(-0.3 * PI - 0.07 * hz) * size
        }))
        .unwrap();
        let high = margins.crossover_hz.unwrap();
        assert!(high > 12.0 && high < 18.0, "{high}");
        let late = (PI - 0.3 * PI - 0.07 * high) / (TAU * high) * 1e3;
        near(margins.delay_margin_ms.unwrap(), late);
        near(margins.phase_margin_deg.unwrap(), (0.7 * PI - 0.07 * high).to_degrees());
    }

    #[test]
    fn a_loop_gain_that_stays_small_has_no_crossings() {
        let margins = Margins::of(&response(|_| Complex64::from(0.1))).unwrap();
        assert_eq!(
            (margins.gain_margin, margins.phase_margin_deg, margins.delay_margin_ms),
            (None, None, None)
        );
        assert!((margins.ms - 1.0 / 1.1).abs() < 1e-9 && margins.keeps(&RequiredMargins::default()));
        assert_eq!(Margins::of(&[]), None);
    }

    #[test]
    fn only_a_rise_of_the_gain_counts_as_gain_margin() {
        // Conditionally stable: real and negative first at 4, then at 0.25.
        let margins = Margins::of(&response(|hz| {
            let angle = if hz < 1.0 {
                -0.9
            } else if hz < 5.0 {
                -1.2
            } else {
                -0.9 - 0.04 * (hz - 5.0)
            };
            let size = if hz < 1.0 {
                8.0
            } else if hz < 5.0 {
                4.0 / hz
            } else {
                2.0 / hz
            };
            Complex64::cis(PI * angle) * size
        }));
        assert!(margins.unwrap().gain_margin.unwrap() > 2.0);
    }

    #[test]
    fn the_worst_of_loops_is_taken_margin_by_margin() {
        let slow = Margins::of(&integrator(10.0, 0.03)).unwrap();
        let fast = Margins::of(&integrator(30.0, 0.03)).unwrap();
        let worst = slow.worst(&fast);
        assert_eq!((worst, fast.worst(&slow)), (fast, fast));
        let absent = Margins { gain_margin: None, ms: 9.0, ..slow };
        assert_eq!(absent.worst(&fast), Margins { ms: 9.0, ms_hz: slow.ms_hz, ..fast });
    }

    #[test]
    fn a_requirement_is_kept_at_its_bounds() {
        let required = RequiredMargins::default();
        let kept =
            Margins { ms: 2.0, gain_margin: Some(2.0), delay_margin_ms: Some(10.0), ..Margins::default() };
        assert!(kept.keeps(&required));
        assert!(!Margins { ms: 2.01, ..kept }.keeps(&required));
        assert!(!Margins { ms: f64::NAN, ..kept }.keeps(&required));
        assert!(!Margins { gain_margin: Some(1.99), ..kept }.keeps(&required));
        assert!(!Margins { delay_margin_ms: Some(9.99), ..kept }.keeps(&required));
        assert!(Margins { gain_margin: None, delay_margin_ms: None, ..kept }.keeps(&required));
    }

    #[test]
    fn an_angle_is_unwrapped_to_its_neighbour() {
        for (angle, near, expected) in [(3.0, -3.0, 3.0 - TAU), (0.5, 0.4, 0.5), (-3.0, 9.0, 2.0 * TAU - 3.0)]
        {
            assert!((unwrapped(angle, near) - expected).abs() < 1e-12, "{angle} {near}");
        }
    }
}
