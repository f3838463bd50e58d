//! Estimates the lung, and compares the pressure with the response that this lung must show to the delivered gas.
//!
//! A model of the valve (dead time, lag, flow curve with dead zone, back-pressure) converts commands to flow and volume. At
//! the end of each inspiration a least-squares fit of `p - p0 = E V + R q` gives elastance E and resistance R, which predict
//! the pressure of the next inspiration. A far lower reading is frozen, or the gas does not reach the lung.

use super::monitors::{in_a_row, ticks};
use crate::breath::period_s;
use crate::math;

/// Dead time of the valve, s.
pub const DEAD_TIME: f32 = 0.012;
/// First-order lag of the valve, s.
pub const LAG: f32 = 0.025;
/// Flow of the valve into ambient pressure at 0, 10, .. 100 percent, L/s.
pub const FLOW: [f32; 11] = [0.0, 0.046, 0.161, 0.303, 0.463, 0.639, 0.827, 1.026, 1.233, 1.449, 1.67];
/// Fraction by which 1 cmH2O of back-pressure reduces the flow: `0.5 / 150`, for a supply pressure of 150 cmH2O.
const BACK_PRESSURE: f32 = 0.0033;
/// Longest dead time, ticks.
const DELAY_MAX: usize = 48;
/// Elastance of the softest lung, cmH2O/mL; assumed until there is an estimate.
pub const SOFTEST: f32 = 1.0 / 120.0;
/// Lowest and highest elastance that an estimate may have, cmH2O/mL.
const ELASTANCES: (f32, f32) = (SOFTEST, 1.0);
/// Highest resistance that an estimate may have, cmH2O/(L/s).
const RESISTANCE_MAX: f32 = 100.0;
/// Resistance of the expiratory path, through which the lung empties, cmH2O/(L/s): that of its orifice at a high flow.
const EXPIRATORY: f32 = 15.0;
/// Largest share of its gas that an expiration leaves in the lung.
const MOST_LEFT: f32 = 0.95;
/// Largest fraction of the rise's sum of squares that the fit may leave unexplained.
const UNEXPLAINED: f32 = 0.1;
/// Smallest predicted rise at which the pressure is checked, cmH2O.
pub const TELLING_RISE: f32 = 10.0;
/// Largest change that is attributed to noise, cmH2O.
const STANDS: f32 = 0.6;
/// Fraction of the predicted rise that must be measured.
pub const ANSWER: f32 = 0.12;
/// Largest fall below the starting pressure; a larger one means that gas is lost, cmH2O.
const FALL: f32 = 1.5;
/// Multiple of a good inspiration's rise that no lung's estimate predicts.
const FALSE: f32 = 2.0;
/// Estimates that are kept, and the newest of them that tell how far the gas may have raised the pressure.
const ESTIMATES: usize = 4;
const HIGHEST_OF: usize = 2;
/// Estimates from which the lung is known, if one of them is from a breath that the clock has started.
pub const KNOWN: usize = 2;
/// Ticks over which the change is predicted, to detect a reading that freezes in the middle of an inspiration.
pub const WINDOW: usize = 64;
/// Smallest delivered volume from which the lung is estimated, mL.
pub const TELLING_VOLUME: f32 = 20.0;
/// Pressure above PEEP at the start of an inspiration from which it tells nothing of the lung, cmH2O: gas of the breath before is
/// still in it.
const TRAPPED: f32 = 3.0;
/// Shortest inspiration from which the lung is estimated, s: a shorter one has filled little but the tube.
const TELLING_TIME: f32 = 0.15;
/// Least share of the model's flow that counts, whatever the flow sensor shows.
pub const LEAST_MEASURED: f32 = 0.6;
/// Time for which the pressure may be far lower than predicted, s. Fulfils: no-response.
pub const UNANSWERED: f32 = 0.04;
/// Time for which the pressure may stand still against a predicted change, s.
pub const STANDING: f32 = 0.02;

/// Sums of the least-squares fit over the ticks of an inspiration: volume `v`, flow `q` and pressure rise `y`.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct LungFit {
    vv: f32,
    vq: f32,
    qq: f32,
    vy: f32,
    qy: f32,
    yy: f32,
}

impl LungFit {
    /// Adds a tick: volume since the start of the inspiration, mL, flow, L/s, and rise of the pressure since then, cmH2O.
    pub fn add(&mut self, v: f32, q: f32, y: f32) {
        self.vv += v * v;
        self.vq += v * q;
        self.qq += q * q;
        self.vy += v * y;
        self.qy += q * y;
        self.yy += y * y;
    }

    /// The estimate, limited to its bounds, if it explains the rise.
    pub fn solve(&self) -> Option<LungEstimate> {
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

    /// Share of the gas that is still in the lung after an expiration of this length, s; at most [`MOST_LEFT`].
    fn left_after(self, expiration: f32) -> f32 {
        // In time constants. The series is below the exponential, so that no gas is forgotten.
        let x = math::limit(1000.0 * expiration * self.elastance / (self.resistance + EXPIRATORY), 0.0, 1e3);
        (1.0 / (1.0 + x * (1.0 + x * (0.5 + x / 6.0)))).min(MOST_LEFT)
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
    /// Flow of the valve into ambient pressure, L/s.
    valve_flow: f32,
    /// Flow of the last tick, L/s, and volume of the inspiration so far, mL.
    flow: f32,
    volume: f32,
    /// Pressure at the start of the inspiration, cmH2O, and whether trapped gas had raised it.
    start: f32,
    trapped: bool,
    sums: LungFit,
    /// Estimates from the last inspirations that allowed one, the newest first, and then the last one from a breath that the clock
    /// has started: efforts falsify all others in the same way.
    lungs: [Option<LungEstimate>; ESTIMATES + 1],
    unanswered: u32,
    standing: u32,
    /// The last ticks, and the number of ticks in this inspiration.
    past: [PastTick; WINDOW],
    ticks: usize,
    /// Predicted change in the last [`WINDOW`] ticks, cmH2O.
    growth: f32,
    /// Without a pressure: gas of earlier breaths in the lung.
    trapped_gas: Option<TrappedGas>,
}

/// Gas that the lung keeps from breath to breath because its expirations are too short, mL.
#[derive(Clone, Copy, Debug, PartialEq)]
struct TrappedGas {
    /// At the start of the running breath.
    now: f32,
    /// While pressure control still worked: the estimates contain that.
    usual: f32,
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
        state.valve_flow = flow(state.opening);
        debug_assert!(state.at < DELAY_MAX && !state.opening.is_nan());
    }

    /// Ends the inspiration: estimates the lung from it, if it was long enough and the fit is good enough. `triggered`: an effort
    /// has started it.
    pub fn end_inspiration(&self, state: &mut LungState, triggered: bool) {
        if state.volume < TELLING_VOLUME || state.ticks < self.telling || state.trapped {
            return;
        }
        if let Some(lung) = state.sums.solve() {
            state.lungs[..ESTIMATES].rotate_right(1);
            state.lungs[0] = Some(lung);
            if !triggered {
                state.lungs[ESTIMATES] = Some(lung);
            }
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
        state.flow = state.valve_flow * math::limit(1.0 - BACK_PRESSURE * pressure, 0.0, 1.0);
        state.volume += 1000.0 * state.flow * self.period;
        debug_assert!(state.flow >= 0.0 && state.volume >= 0.0, "the valve lets no gas out");
    }

    /// Checks a tick of the inspiration; true if the pressure, cmH2O, does not respond to the delivered gas. `still`: it has stood still
    /// since the start of the inspiration, wherever that was, although gas was delivered.
    #[inline]
    pub fn check(&self, state: &mut LungState, pressure: f32, still: bool) -> bool {
        self.count(state, pressure);
        let rise = pressure - state.start;
        state.sums.add(state.volume, state.flow, rise);
        let (before, between) = (state.before(WINDOW), state.before(WINDOW / 2));
        let predicted = state.predicted_rise();
        state.growth = predicted - before.predicted;
        state.past[state.ticks % WINDOW] = PastTick { pressure, predicted };
        state.ticks += 1;
        // A pressure that has fallen below its start means an open tube, which another monitor detects.
        let silent = (still || predicted > TELLING_RISE && rise < ANSWER * predicted) && rise > -FALL;
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
        self.valve_flow
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
        self.trapped = pressure > peep + TRAPPED;
        let pressure = pressure.min(peep);
        (self.start, self.volume, self.sums) = (pressure, 0.0, LungFit::default());
        (self.unanswered, self.standing, self.ticks, self.growth) = (0, 0, 0, 0.0);
    }

    /// Ends a breath without a pressure reading, before the next inspiration starts: what the lung keeps after an expiration of this
    /// length, s.
    pub fn keep_gas(&mut self, expiration: f32) {
        let left = self.lungs.iter().take(HIGHEST_OF).flatten().map(|lung| lung.left_after(expiration));
        let left = left.fold(0.0, f32::max);
        let usual = left * self.volume / (1.0 - left);
        let before = self.trapped_gas.unwrap_or(TrappedGas { now: usual, usual });
        self.trapped_gas = Some(TrappedGas { now: left * (before.now + self.volume), ..before });
    }

    /// Ends a breath with a pressure reading, which shows what the lung keeps.
    pub fn forget_gas(&mut self) {
        self.trapped_gas = None;
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

    /// Forgets the estimates that predict far more than the pressure at the end of a good inspiration, cmH2O: efforts have falsified
    /// them, and may keep better ones from being made.
    pub fn forget_false(&mut self, pressure: f32) {
        let (volume, flow, rise) = (self.volume, self.flow, pressure - self.start);
        for lung in &mut self.lungs {
            *lung = lung.filter(|lung| lung.rise(volume, flow) <= FALSE * rise);
        }
    }

    /// The estimate from the newest inspiration that allowed one.
    pub fn last_estimate(&self) -> Option<LungEstimate> {
        self.lungs[0]
    }

    /// Whether there are at least [`KNOWN`] estimates, and one of a timed breath, which is kept twice.
    pub fn is_known(&self) -> bool {
        self.lungs.iter().flatten().count() > KNOWN && self.lungs[ESTIMATES].is_some()
    }

    /// The lowest rise that the estimates predict, cmH2O: a patient's efforts may have falsified all but one of them.
    pub fn predicted_rise(&self) -> f32 {
        let rises = self.lungs.iter().flatten().map(|lung| self.rise(*lung));
        rises.reduce(f32::min).unwrap_or_else(|| self.rise(LungEstimate::SOFTEST))
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
        let kept = self.trapped_gas.map_or(0.0, |gas| (gas.now - gas.usual).max(0.0));
        let rise = |lung: &LungEstimate| lung.rise(self.volume + kept, self.flow);
        self.lungs.iter().take(HIGHEST_OF).flatten().map(rise).reduce(f32::max).map(|rise| self.start + rise)
    }
}

impl Default for LungState {
    /// No estimate yet; the valve is closed.
    fn default() -> Self {
        Self {
            pipe: [0.0; DELAY_MAX],
            at: 0,
            opening: 0.0,
            valve_flow: 0.0,
            flow: 0.0,
            volume: 0.0,
            start: 0.0,
            trapped: false,
            sums: LungFit::default(),
            lungs: [None; ESTIMATES + 1],
            unanswered: 0,
            standing: 0,
            past: [PastTick { pressure: 0.0, predicted: 0.0 }; WINDOW],
            ticks: 0,
            growth: 0.0,
            trapped_gas: None,
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
mod tests;
