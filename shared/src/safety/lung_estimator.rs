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
/// Estimates that are kept, and the newest of them that tell how far the gas may have raised the pressure.
const ESTIMATES: usize = 4;
const HIGHEST_OF: usize = 2;
/// Ticks over which the change is predicted, to detect a reading that freezes in the middle of an inspiration.
pub const WINDOW: usize = 64;
/// Smallest delivered volume from which the lung is estimated, mL.
const TELLING_VOLUME: f32 = 20.0;
/// Shortest inspiration from which the lung is estimated, s: a shorter one has filled little but the tube.
const TELLING_TIME: f32 = 0.15;
/// Least share of the model's flow that counts, whatever the flow sensor shows.
const LEAST_MEASURED: f32 = 0.6;
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
    /// [`TELLING_TIME`] in ticks.
    telling: usize,
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
    /// Estimates from the last inspirations that allowed one, the newest first.
    lungs: [Option<LungEstimate>; ESTIMATES],
    unanswered: u32,
    standing: u32,
    /// The last ticks, and the number of ticks in this inspiration.
    past: [PastTick; WINDOW],
    ticks: usize,
    /// Predicted change in the last [`WINDOW`] ticks, cmH2O.
    growth: f32,
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
            telling: ticks(TELLING_TIME, period_us) as usize,
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

    /// Ends the inspiration: estimates the lung from it, if it was long enough and the fit is good enough.
    pub fn end_inspiration(&self, state: &mut LungState) {
        if state.volume < TELLING_VOLUME || state.ticks < self.telling {
            return;
        }
        if let Some(lung) = state.sums.solve() {
            state.lungs.rotate_right(1);
            state.lungs[0] = Some(lung);
        }
    }

    /// Counts the gas of a tick without a pressure reading, against the predicted pressure; by a sound flow sensor, L/s, if there is
    /// one. It may show less than the valve's model, since the supply can fall, but not so little that the pressure is lost sight of.
    pub fn deliver(&self, state: &mut LungState, measured: Option<f32>) {
        let before = state.volume;
        self.count(state, state.start + state.predicted_rise());
        if let Some(measured) = measured {
            state.flow = measured.max(LEAST_MEASURED * state.flow);
            state.volume = before + 1000.0 * state.flow * self.period;
        }
    }

    /// Adds the gas of a tick at this pressure, cmH2O, to the volume.
    fn count(&self, state: &mut LungState, pressure: f32) {
        state.flow = flow(state.opening) * math::limit(1.0 - BACK_PRESSURE * pressure, 0.0, 1.0);
        state.volume += 1000.0 * state.flow * self.period;
    }

    /// Checks a tick of the inspiration; true if the pressure, cmH2O, does not respond to the delivered gas.
    #[inline]
    pub fn check(&self, state: &mut LungState, pressure: f32) -> bool {
        self.count(state, pressure);
        let rise = pressure - state.start;
        state.sums.add(state.volume, state.flow, rise);
        let (before, between) = (state.before(WINDOW), state.before(WINDOW / 2));
        let predicted = state.predicted_rise();
        state.growth = predicted - before.predicted;
        state.past[state.ticks % WINDOW] = PastTick { pressure, predicted };
        state.ticks += 1;
        // A pressure that has fallen below its start means an open tube, which another monitor detects.
        let silent = predicted > TELLING_RISE && rise < ANSWER * predicted && rise > -FALL;
        state.unanswered = in_a_row(state.unanswered, silent);
        let still = |past: PastTick| (pressure - past.pressure).abs() < STANDS;
        // After a cough the pressure can be back at an earlier value without having been constant in between.
        let stands = still(before) && still(between) && rise > -FALL;
        state.standing = in_a_row(state.standing, stands && state.growth > TELLING_RISE);
        state.unanswered >= self.unanswered || state.standing >= self.standing
    }
}

impl LungState {
    /// Flow of the valve into ambient pressure, L/s.
    pub fn valve_flow(&self) -> f32 {
        flow(self.opening)
    }

    /// Change that the delivered gas must have brought in the last [`WINDOW`] ticks of the inspiration, cmH2O.
    pub fn growth(&self) -> f32 {
        self.growth
    }

    /// Volume delivered so far in this inspiration, mL.
    pub fn volume(&self) -> f32 {
        self.volume
    }

    /// Starts an inspiration at a pressure, cmH2O, limited to PEEP: if a cough raises it, the pressure falls when the cough
    /// ends, which must not count as a missing rise.
    pub fn start_inspiration(&mut self, pressure: f32, peep: f32) {
        let pressure = pressure.min(peep);
        (self.start, self.volume, self.sums) = (pressure, 0.0, Sums::default());
        (self.unanswered, self.standing, self.ticks, self.growth) = (0, 0, 0, 0.0);
    }

    /// The tick `ticks` ago, at most [`WINDOW`]; the start of a shorter inspiration.
    fn before(&self, ticks: usize) -> PastTick {
        if self.ticks < ticks {
            PastTick { pressure: self.start, predicted: 0.0 }
        } else {
            self.past[(self.ticks - ticks) % WINDOW]
        }
    }

    /// Flow of the last tick, L/s.
    pub fn flow(&self) -> f32 {
        self.flow
    }

    /// The lowest rise that the estimates predict, cmH2O: a patient's efforts may have falsified all but one of them.
    pub fn predicted_rise(&self) -> f32 {
        self.rises(ESTIMATES).reduce(f32::min).unwrap_or_else(|| self.rise(LungEstimate::SOFTEST))
    }

    /// Rises that the newest estimates predict, cmH2O.
    fn rises(&self, newest: usize) -> impl Iterator<Item = f32> {
        self.lungs.iter().take(newest).flatten().map(|lung| self.rise(*lung))
    }

    /// Rise of the running inspiration in a lung, cmH2O.
    fn rise(&self, lung: LungEstimate) -> f32 {
        lung.rise(self.volume, self.flow)
    }

    /// Whether the delivered gas explains a pressure, cmH2O; assumed without an estimate. A cough or an occluded tube raises
    /// the pressure further than the gas does.
    pub fn explains(&self, pressure: f32) -> bool {
        self.predicted_pressure().is_none_or(|predicted| predicted >= pressure)
    }

    /// The highest pressure that the last two estimates predict, cmH2O; none without an estimate.
    pub fn predicted_pressure(&self) -> Option<f32> {
        self.rises(HIGHEST_OF).reduce(f32::max).map(|rise| self.start + rise)
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
            lungs: [None; ESTIMATES],
            unanswered: 0,
            standing: 0,
            past: [PastTick { pressure: 0.0, predicted: 0.0 }; WINDOW],
            ticks: 0,
            growth: 0.0,
        }
    }
}

/// Flow of the valve at an opening in percent, L/s.
fn flow(opening: f32) -> f32 {
    let place = math::limit(opening, 0.0, 100.0) * 0.1;
    let left = (place as usize).min(FLOW.len() - 2);
    FLOW[left] + (FLOW[left + 1] - FLOW[left]) * (place - left as f32)
}

/// Command at which the valve delivers a flow into a low pressure, percent.
pub(super) fn command_for(flow: f32) -> f32 {
    let right = FLOW.iter().position(|full| *full >= flow).unwrap_or(FLOW.len() - 1).max(1);
    let (low, high) = (FLOW[right - 1], FLOW[right]);
    10.0 * (right as f32 - 1.0 + math::limit((flow - low) / (high - low), 0.0, 1.0))
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::vec::Vec;

    const PERIOD_US: u32 = 1000;

    fn estimator() -> (LungEstimator, LungState) {
        (LungEstimator::new(PERIOD_US), LungState::default())
    }

    #[test]
    fn a_sound_flow_sensor_counts_the_gas_without_a_pressure_but_never_too_little() {
        let delivered = |measured: Option<f32>| {
            let (estimator, mut state) = estimator();
            for _ in 0..500 {
                estimator.applied(&mut state, 50.0);
            }
            estimator.deliver(&mut state, None);
            state.volume = 100.0;
            estimator.deliver(&mut state, measured);
            (state.volume - 100.0, state.flow)
        };
        let (model, flow) = delivered(None);
        assert!((0.6..0.64).contains(&flow) && (model - flow).abs() < 1e-4, "{model} mL in 1 ms");
        for (measured, counts) in [(0.9, 0.9), (0.5, 0.5), (0.1, 0.6 * flow)] {
            let (volume, counted) = delivered(Some(measured));
            assert!(
                (volume - counts).abs() < 1e-3 && (counted - counts).abs() < 1e-3,
                "{measured} L/s: {volume} mL"
            );
        }
    }

    #[test]
    fn the_command_for_a_flow_delivers_it() {
        for percent in 0..=1000 {
            let command = percent as f32 * 0.1;
            assert!((command_for(flow(command)) - command).abs() < 1e-2, "{command} %");
        }
        assert!(command_for(-1.0).abs() < 1e-6 && (command_for(9.0) - 100.0).abs() < 1e-6);
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
        estimator.end_inspiration(state);
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
    fn commands_take_effect_after_the_dead_time_and_then_with_the_lag() {
        let (estimator, mut state) = estimator();
        let opened = (0..100).position(|_| {
            estimator.applied(&mut state, 80.0);
            estimator.check(&mut state, 5.0);
            state.flow > 0.0
        });
        assert_eq!(opened, Some(12));
        for _ in 0..24 {
            estimator.applied(&mut state, 80.0);
        }
        let left = (25.0_f32 / 26.0).powi(25);
        assert!(
            (state.opening - 80.0 * (1.0 - left)).abs() < 0.01,
            "{} % after a lag of 25 ms",
            state.opening
        );
        // The ring of commands comes round several times.
        for n in 0..200 {
            estimator.applied(&mut state, if n < 180 { 0.0 } else { 100.0 });
        }
        assert!((15.0..40.0).contains(&state.opening), "{} % after 8 ms", state.opening);
    }

    #[test]
    fn the_valves_flow_is_its_curve_and_never_beyond_it() {
        let curve = [
            (-5.0, 0.0),
            (0.0, 0.0),
            (5.0, 0.023),
            (10.0, 0.046),
            (75.0, 1.1295),
            (95.0, 1.5595),
            (100.0, 1.67),
        ];
        for (opening, expected) in curve.into_iter().chain([(130.0, 1.67), (f32::NAN, 0.0)]) {
            let open = LungState { opening, ..LungState::default() };
            assert!((open.valve_flow() - expected).abs() < 1e-5, "{opening} %: {}", open.valve_flow());
        }
    }

    #[test]
    fn a_pressure_behind_the_valve_takes_flow_away_and_flow_sums_to_volume() {
        let open = |pressure: f32| {
            let (estimator, _) = estimator();
            let mut state = LungState { opening: 100.0, ..LungState::default() };
            estimator.check(&mut state, pressure);
            estimator.check(&mut state, pressure);
            (state.flow, state.volume())
        };
        for (pressure, flow) in [(0.0, 1.67), (100.0, 0.67 * 1.67), (400.0, 0.0)] {
            let (found, volume) = open(pressure);
            assert!((found - flow).abs() < 1e-5 && (volume - 2.0 * flow).abs() < 1e-5, "{pressure} cmH2O");
        }
    }

    #[test]
    fn without_a_reading_the_predicted_pressure_takes_flow_away() {
        let (estimator, _) = estimator();
        let mut state = LungState { opening: 100.0, start: 40.0, ..predicting(60.0) };
        estimator.deliver(&mut state, None);
        assert!((state.flow - 0.67 * 1.67).abs() < 1e-5, "{} L/s against 100 cmH2O", state.flow);
    }

    /// Ticks of an inspiration: volume, flow, and the rise that these make of it.
    fn sums(ticks: &[(f32, f32)], rise: impl Fn(f32, f32) -> [f32; 2]) -> Sums {
        let mut sums = Sums::default();
        for (volume, flow) in ticks {
            // Each twice, so that what is added once and taken away once is in no way explained.
            for y in rise(*volume, *flow) {
                sums.add(*volume, *flow, y);
            }
        }
        sums
    }

    const TICKS: [(f32, f32); 3] = [(100.0, 0.5), (200.0, 0.3), (350.0, 0.1)];

    #[test]
    fn elastance_and_resistance_are_those_of_the_least_squares_within_their_bounds() {
        for (elastance, resistance, bounded) in [
            (0.05, 20.0, (0.05, 20.0)),
            (0.3, 5.0, (0.3, 5.0)),
            (2.0, 10.0, (1.0, 10.0)),
            (0.002, 30.0, (SOFTEST, 30.0)),
            (0.1, 300.0, (0.1, 100.0)),
            (0.1, -20.0, (0.1, 0.0)),
        ] {
            let lung = sums(&TICKS, |v, q| [elastance * v + resistance * q; 2]).solve().unwrap();
            assert!((lung.elastance - bounded.0).abs() < 1e-4, "E {elastance}: {}", lung.elastance);
            assert!((lung.resistance - bounded.1).abs() < 0.05, "R {resistance}: {}", lung.resistance);
        }
        assert_eq!(sums(&TICKS, |_, _| [0.0; 2]).solve(), Some(LungEstimate::SOFTEST), "no rise at all");
    }

    #[test]
    fn what_does_not_behave_like_a_lung_tells_nothing() {
        let with_unexplained = |part: f32| {
            let rise = |v: f32, q: f32| 0.05 * v + 20.0 * q;
            sums(&TICKS, |v, q| [rise(v, q) * (1.0 + part), rise(v, q) * (1.0 - part)]).solve()
        };
        // part^2 / (1 + part^2) of the square.
        assert!(with_unexplained(0.3).is_some() && with_unexplained(0.37).is_none());
        let in_step = |last_flow| {
            sums(&[(100.0, 0.5), (200.0, 1.0), (300.0, last_flow)], |v, q| [0.05 * v + 20.0 * q; 2]).solve()
        };
        assert!(in_step(1.57).is_none() && in_step(1.62).is_some(), "volume and flow cannot be told apart");
    }

    /// A closed valve that has delivered what makes this rise, cmH2O.
    fn predicting(rise: f32) -> LungState {
        let lung = LungEstimate { elastance: 1.0, resistance: 0.0 };
        LungState { volume: rise, lungs: [Some(lung), None, None, None], ..LungState::default() }
    }

    /// At which of 200 ticks a rise was first called silent, while the predicted one grows by so much in a tick.
    fn silent(state: LungState, growth: f32, rise: impl Fn(usize) -> f32) -> Option<usize> {
        let ((estimator, _), mut state) = (estimator(), state);
        (0..200).position(|tick| {
            let silent = estimator.check(&mut state, rise(tick));
            state.volume += growth;
            silent
        })
    }

    #[test]
    fn an_eighth_of_a_telling_rise_must_be_seen_within_forty_milliseconds() {
        let constant = |predicted, rise| silent(predicting(predicted), 0.0, |_| rise);
        assert_eq!(constant(20.0, 0.119 * 20.0), Some(39));
        assert_eq!((constant(20.0, ANSWER * 20.0), constant(20.0, 3.0)), (None, None), "it answers");
        assert_eq!((constant(10.0, 1.0), constant(10.1, 1.0)), (None, Some(39)), "a rise that tells");
        assert_eq!((constant(20.0, -1.5), constant(20.0, -1.4)), (None, Some(39)), "an open tube");
        let interrupted = silent(predicting(20.0), 0.0, |tick| if tick % 39 == 38 { 3.0 } else { 1.0 });
        assert_eq!(interrupted, None);
    }

    #[test]
    fn a_pressure_may_stand_still_for_twenty_milliseconds_against_a_telling_rise() {
        let constant = |predicted, rise| silent(predicting(predicted), 0.0, |_| rise);
        assert_eq!((constant(20.0, 0.59), constant(20.0, -0.59)), (Some(19), Some(19)));
        assert_eq!(constant(20.0, STANDS), Some(39), "a change, if too small an answer");
        assert_eq!((constant(10.0, 0.5), constant(10.1, 0.5)), (None, Some(19)));
        // Far above the start, and growing by 32 cmH2O in a window of 64 ms.
        assert_eq!(silent(predicting(100.0), 0.5, |_| 30.0), Some(64 + 19));
        assert_eq!(silent(predicting(100.0), 10.0 / 64.0, |_| 30.0), None, "by 10 cmH2O");
        let between = |tick: usize| if tick % 64 < 32 { 30.0 } else { 35.0 };
        assert_eq!(silent(predicting(100.0), 0.5, between), None, "where it was, but not all the time");
        // Below the start and still: an open tube, which the breath monitor finds.
        let gone = LungState { start: 40.0, ..predicting(100.0) };
        assert_eq!(silent(gone.clone(), 0.5, |_| 38.5), None);
        assert_eq!(silent(LungState { start: 39.9, ..gone }, 0.5, |_| 38.5), Some(39), "hardly below");
    }

    /// The state after 100 mL, at 0.5 L/s, with the estimates of these elastances and resistances.
    fn estimated(lungs: [Option<(f32, f32)>; ESTIMATES]) -> LungState {
        let lungs =
            lungs.map(|lung| lung.map(|(elastance, resistance)| LungEstimate { elastance, resistance }));
        LungState { volume: 100.0, flow: 0.5, lungs, ..LungState::default() }
    }

    const SOFT: Option<(f32, f32)> = Some((0.05, 10.0));
    const STIFF: Option<(f32, f32)> = Some((0.2, 4.0));

    #[test]
    fn of_four_lungs_the_one_that_rises_least_is_believed() {
        let rise = |lungs| estimated(lungs).predicted_rise();
        for place in 0..ESTIMATES {
            let mut lungs = [STIFF; ESTIMATES];
            lungs[place] = SOFT;
            assert!((rise(lungs) - 10.0).abs() < 1e-4);
            let mut only = [None; ESTIMATES];
            only[place] = STIFF;
            assert!((rise(only) - 22.0).abs() < 1e-4);
        }
        assert!((rise([None; ESTIMATES]) - 100.0 / 120.0).abs() < 1e-4);
    }

    #[test]
    fn the_highest_pressure_is_that_of_the_newest_two_lungs() {
        let highest = |lungs| estimated(lungs).predicted_pressure();
        for lungs in [[SOFT, STIFF, None, None], [STIFF, SOFT, SOFT, SOFT]] {
            assert!((highest(lungs).unwrap() - 22.0).abs() < 1e-4);
        }
        assert!((highest([SOFT, SOFT, STIFF, STIFF]).unwrap() - 10.0).abs() < 1e-4);
        assert_eq!(highest([None; ESTIMATES]), None);
    }

    #[test]
    fn an_inspiration_starts_from_peep_at_most_and_knows_nothing_of_the_last() {
        let (estimator, mut state) = estimator();
        inspire(&mut state, 40.0, lung(0.1, 5.0));
        let lungs = state.lungs;
        state.start_inspiration(20.0, 5.0);
        assert_eq!(
            (state.start as i32, state.volume() as i32, state.sums, state.lungs),
            (5, 0, Sums::default(), lungs)
        );
        state.start_inspiration(3.0, 5.0);
        assert_eq!(state.start as i32, 3);
        let mut late = LungState { unanswered: 39, standing: 19, ..predicting(20.0) };
        late.start_inspiration(5.0, 5.0);
        late.volume = 20.0;
        assert!(!estimator.check(&mut late, 5.0));
    }

    #[test]
    fn an_inspiration_of_a_few_ticks_has_filled_the_tube_alone_and_tells_nothing() {
        let told = sums(&TICKS, |v, q| [0.05 * v + 20.0 * q; 2]);
        let mut state = LungState { volume: 100.0, sums: told, ticks: 149, ..predicting(0.0) };
        let before = state.lungs;
        estimator().0.end_inspiration(&mut state);
        assert_eq!(state.lungs, before);
    }

    #[test]
    fn an_inspiration_of_twenty_millilitres_tells_of_the_lung_and_a_smaller_one_does_not() {
        let after = |volume| {
            let told = sums(&TICKS, |v, q| [0.05 * v + 20.0 * q; 2]);
            let mut state = LungState { volume, sums: told, ticks: 150, ..predicting(0.0) };
            estimator().0.end_inspiration(&mut state);
            state.lungs.map(|lung| lung.map(|lung| (100.0 * lung.elastance + 0.5) as i32))
        };
        assert_eq!(after(TELLING_VOLUME), [Some(5), Some(100), None, None], "the newest first");
        assert_eq!(after(TELLING_VOLUME - 0.1), [Some(100), None, None, None]);
    }
}
