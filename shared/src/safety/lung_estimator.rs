//! Estimates the lung, and compares the pressure with the response that this lung must show to the delivered gas.
//!
//! A model of the valve (dead time, lag, flow curve with dead zone, back-pressure) converts commands to flow and volume. At
//! the end of each inspiration a least-squares fit of `p - p0 = E V + R q` gives elastance E and resistance R, which predict
//! the pressure of the next inspiration. A far lower reading is frozen, or the gas does not reach the lung.

use super::monitors::{in_a_row, ticks};
use crate::breath::period_s;
use crate::math;

/// Dead time of the valve, s.
const DEAD_TIME: f32 = 0.012;
/// First-order lag of the valve, s.
const LAG: f32 = 0.025;
/// Flow of the valve into ambient pressure at 0, 10, .. 100 percent, L/s.
const FLOW: [f32; 11] = [0.0, 0.046, 0.161, 0.303, 0.463, 0.639, 0.827, 1.026, 1.233, 1.449, 1.67];
/// Fraction by which 1 cmH2O of back-pressure reduces the flow: `0.5 / 150`, for a supply pressure of 150 cmH2O.
const BACK_PRESSURE: f32 = 0.0033;
/// Longest dead time, ticks.
const DELAY_MAX: usize = 48;
/// Elastance of the softest lung, cmH2O/mL; assumed until there is an estimate.
const SOFTEST: f32 = 1.0 / 120.0;
/// Lowest and highest elastance that an estimate may have, cmH2O/mL.
const ELASTANCES: (f32, f32) = (SOFTEST, 1.0);
/// Highest resistance that an estimate may have, cmH2O/(L/s).
const RESISTANCE_MAX: f32 = 100.0;
/// Largest fraction of the rise's sum of squares that the fit may leave unexplained.
const UNEXPLAINED: f32 = 0.1;
/// Smallest predicted rise at which the pressure is checked, cmH2O.
const TELLING_RISE: f32 = 10.0;
/// Largest change that is attributed to noise, cmH2O.
const STANDS: f32 = 0.6;
/// Fraction of the predicted rise that must be measured.
const ANSWER: f32 = 0.12;
/// Largest fall below the starting pressure; a larger one means that gas is lost, cmH2O.
const FALL: f32 = 1.5;
/// Ticks over which the change is predicted, to detect a reading that freezes in the middle of an inspiration.
const WINDOW: usize = 64;
/// Smallest delivered volume from which the lung is estimated, mL.
const TELLING_VOLUME: f32 = 20.0;
/// Time for which the pressure may be far lower than predicted, s.
const UNANSWERED: f32 = 0.04;
/// Time for which the pressure may stand still against a predicted change, s.
const STANDING: f32 = 0.02;

/// Sums of the least-squares fit over the ticks of an inspiration: volume `v`, flow `q` and pressure rise `y`.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Sums {
    vv: f32,
    vq: f32,
    qq: f32,
    vy: f32,
    qy: f32,
    yy: f32,
}

impl Sums {
    fn add(&mut self, v: f32, q: f32, y: f32) {
        self.vv += v * v;
        self.vq += v * q;
        self.qq += q * q;
        self.vy += v * y;
        self.qy += q * y;
        self.yy += y * y;
    }

    /// The estimate, limited to its bounds, if it explains the rise.
    fn solve(&self) -> Option<LungEstimate> {
        let Self { vv, vq, qq, vy, qy, yy } = *self;
        let determinant = vv * qq - vq * vq;
        if determinant <= 1e-3 * vv * qq {
            return None;
        }
        let elastance = (vy * qq - qy * vq) / determinant;
        let resistance = (qy * vv - vy * vq) / determinant;
        if yy - elastance * vy - resistance * qy > UNEXPLAINED * yy {
            return None;
        }
        Some(LungEstimate {
            elastance: math::limit(elastance, ELASTANCES.0, ELASTANCES.1),
            resistance: math::limit(resistance, 0.0, RESISTANCE_MAX),
        })
    }
}

/// Estimated elastance and resistance of the lung.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LungEstimate {
    /// Elastance, cmH2O/mL.
    pub elastance: f32,
    /// Resistance, cmH2O/(L/s).
    pub resistance: f32,
}

impl LungEstimate {
    /// The softest lung, without resistance.
    const SOFTEST: Self = Self { elastance: SOFTEST, resistance: 0.0 };

    /// Pressure rise for a volume in mL and a flow in L/s, cmH2O.
    fn rise(self, volume: f32, flow: f32) -> f32 {
        self.elastance * volume + self.resistance * flow
    }
}

/// A past tick of the inspiration.
#[derive(Clone, Copy, Debug, PartialEq)]
struct PastTick {
    /// Pressure, cmH2O.
    pressure: f32,
    /// Predicted rise since the start of the inspiration, cmH2O.
    predicted: f32,
}

/// Configuration: the valve's model and the monitor's times, in ticks.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LungEstimator {
    period: f32,
    lag_factor: f32,
    /// [`DEAD_TIME`], [`UNANSWERED`] and [`STANDING`] in ticks.
    delay: usize,
    unanswered: u32,
    standing: u32,
}

/// State of the valve's model and of the estimate.
#[derive(Clone, Debug, PartialEq)]
pub struct LungState {
    pipe: [f32; DELAY_MAX],
    at: usize,
    opening: f32,
    /// Flow of the last tick, L/s, and volume of the inspiration so far, mL.
    flow: f32,
    volume: f32,
    /// Pressure at the start of the inspiration, cmH2O.
    start: f32,
    sums: Sums,
    /// Estimates from the last two inspirations that allowed one, the newer first.
    lungs: [Option<LungEstimate>; 2],
    unanswered: u32,
    standing: u32,
    /// The last ticks, and the number of ticks in this inspiration.
    past: [PastTick; WINDOW],
    ticks: usize,
}

impl LungEstimator {
    /// An estimator for a control period in microseconds.
    pub fn new(period_us: u32) -> Self {
        let period = period_s(period_us);
        Self {
            period,
            lag_factor: math::lag_factor(LAG, period),
            delay: (math::ticks(DEAD_TIME, period_us) as usize).min(DELAY_MAX - 1),
            unanswered: ticks(UNANSWERED, period_us),
            standing: ticks(STANDING, period_us),
        }
    }

    /// Records the applied command, percent.
    #[inline]
    pub fn applied(&self, state: &mut LungState, command: f32) {
        state.pipe[state.at] = command;
        state.at = (state.at + 1) % DELAY_MAX;
        let due = state.pipe[(state.at + DELAY_MAX - 1 - self.delay) % DELAY_MAX];
        state.opening += self.lag_factor * (due - state.opening);
    }

    /// Checks a tick of the inspiration; true if the pressure, cmH2O, does not respond to the delivered gas.
    #[inline]
    pub fn check(&self, state: &mut LungState, pressure: f32) -> bool {
        state.flow = flow(state.opening) * math::limit(1.0 - BACK_PRESSURE * pressure, 0.0, 1.0);
        state.volume += 1000.0 * state.flow * self.period;
        let rise = pressure - state.start;
        state.sums.add(state.volume, state.flow, rise);
        let predicted = state.predicted_rise();
        let (before, between) = (state.before(WINDOW), state.before(WINDOW / 2));
        state.past[state.ticks % WINDOW] = PastTick { pressure, predicted };
        state.ticks += 1;
        // A pressure that has fallen below its start means an open tube, which another monitor detects.
        let silent = predicted > TELLING_RISE && rise < ANSWER * predicted && rise > -FALL;
        state.unanswered = in_a_row(state.unanswered, silent);
        let still = |past: PastTick| (pressure - past.pressure).abs() < STANDS;
        // After a cough the pressure can be back at an earlier value without having been constant in between.
        let stands = still(before) && still(between) && rise > -FALL;
        state.standing = in_a_row(state.standing, stands && predicted - before.predicted > TELLING_RISE);
        state.unanswered >= self.unanswered || state.standing >= self.standing
    }
}

impl LungState {
    /// Volume delivered so far in this inspiration, mL.
    pub fn volume(&self) -> f32 {
        self.volume
    }

    /// Starts an inspiration at a pressure, cmH2O, limited to PEEP: if a cough raises it, the pressure falls when the cough
    /// ends, which must not count as a missing rise.
    pub fn start_inspiration(&mut self, pressure: f32, peep: f32) {
        let pressure = pressure.min(peep);
        (self.start, self.volume, self.sums) = (pressure, 0.0, Sums::default());
        (self.unanswered, self.standing, self.ticks) = (0, 0, 0);
    }

    /// The tick `ticks` ago, at most [`WINDOW`]; the start of a shorter inspiration.
    fn before(&self, ticks: usize) -> PastTick {
        if self.ticks < ticks {
            PastTick { pressure: self.start, predicted: 0.0 }
        } else {
            self.past[(self.ticks - ticks) % WINDOW]
        }
    }

    /// The lower rise that the last two estimates predict: a patient's effort may have falsified one of them.
    fn predicted_rise(&self) -> f32 {
        let rise = |lung: LungEstimate| lung.rise(self.volume, self.flow);
        match self.lungs {
            [Some(last), Some(before)] => rise(last).min(rise(before)),
            [Some(lung), None] | [None, Some(lung)] => rise(lung),
            [None, None] => rise(LungEstimate::SOFTEST),
        }
    }

    /// Ends the inspiration: estimates the lung from it, if the fit is good enough.
    pub fn end_inspiration(&mut self) {
        if self.volume < TELLING_VOLUME {
            return;
        }
        if let Some(lung) = self.sums.solve() {
            self.lungs = [Some(lung), self.lungs[0]];
        }
    }
}

impl Default for LungState {
    /// No estimate yet; the valve is closed.
    fn default() -> Self {
        Self {
            pipe: [0.0; DELAY_MAX],
            at: 0,
            opening: 0.0,
            flow: 0.0,
            volume: 0.0,
            start: 0.0,
            sums: Sums::default(),
            lungs: [None; 2],
            unanswered: 0,
            standing: 0,
            past: [PastTick { pressure: 0.0, predicted: 0.0 }; WINDOW],
            ticks: 0,
        }
    }
}

/// Flow of the valve at an opening in percent, L/s.
fn flow(opening: f32) -> f32 {
    let place = math::limit(opening, 0.0, 100.0) * 0.1;
    let left = (place as usize).min(FLOW.len() - 2);
    FLOW[left] + (FLOW[left + 1] - FLOW[left]) * (place - left as f32)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::vec::Vec;

    const PERIOD_US: u32 = 1000;

    fn estimator() -> (LungEstimator, LungState) {
        (LungEstimator::new(PERIOD_US), LungState::default())
    }

    /// An inspiration with a constant command into a lung; returns the ticks at which no response was reported.
    fn inspire(state: &mut LungState, command: f32, pressure: impl Fn(&LungState) -> f32) -> Vec<usize> {
        let (estimator, _) = estimator();
        state.start_inspiration(5.0, 5.0);
        let silent = (0..1000).filter(|_| {
            let silent = estimator.check(state, pressure(state));
            estimator.applied(state, command);
            silent
        });
        let silent = silent.collect();
        state.end_inspiration();
        silent
    }

    fn lung(elastance: f32, resistance: f32) -> impl Fn(&LungState) -> f32 {
        move |state| 5.0 + elastance * state.volume + resistance * state.flow
    }

    #[test]
    fn the_lung_is_found_from_one_inspiration() {
        for (compliance, resistance) in [(10.0, 5.0), (50.0, 50.0), (20.0, 20.0)] {
            let mut state = LungState::default();
            inspire(&mut state, 30.0, lung(1.0 / compliance, resistance));
            let found = state.lungs[0].unwrap();
            let e = found.elastance;
            assert!((e * compliance - 1.0).abs() < 0.05, "C {compliance}: {}", 1.0 / e);
            assert!((found.resistance - resistance).abs() < 2.0, "R {resistance}: {}", found.resistance);
        }
    }

    #[test]
    fn a_sound_lung_answers_and_a_silent_one_is_found_long_before_it_bursts() {
        let mut state = LungState::default();
        let stiff = || lung(0.1, 5.0);
        assert!(inspire(&mut state, 40.0, stiff()).is_empty());
        assert!(inspire(&mut state, 40.0, stiff()).is_empty());
        let silent = inspire(&mut state, 100.0, |_| 5.3);
        assert!(silent[0] < 150, "found at {} ms", silent[0]);
    }

    #[test]
    fn before_the_lung_is_known_the_softest_one_is_assumed() {
        let silent = inspire(&mut LungState::default(), 100.0, |_| 5.0);
        assert!((700..950).contains(&silent[0]), "found at {} ms", silent[0]);
    }

    #[test]
    fn a_lung_that_becomes_twice_as_soft_still_answers() {
        let mut state = LungState::default();
        inspire(&mut state, 40.0, lung(0.05, 20.0));
        assert!(inspire(&mut state, 40.0, lung(0.025, 20.0)).is_empty());
        assert!(inspire(&mut state, 40.0, lung(0.025, 5.0)).is_empty());
    }

    #[test]
    fn commands_take_effect_after_the_dead_time() {
        let (estimator, mut state) = estimator();
        let opened = (0..40).position(|_| {
            estimator.applied(&mut state, 80.0);
            estimator.check(&mut state, 5.0);
            state.flow > 0.0
        });
        assert_eq!(opened, Some(12));
    }
}
