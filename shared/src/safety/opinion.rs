//! The second opinion on the pressure: what the valve must have delivered, and what that must have done to the pressure.
//!
//! Commands pass a model of the valve (dead time, lag, dead zone, curve) and give a flow, its sum a volume. At the end of
//! each inspiration least squares of `p - p0 = E V + R q` over its ticks gives elastance and resistance, with which the next
//! inspiration is foretold. A reading that stays behind by far is frozen, or the gas is not where it should be.

use super::monitors::Times;
use crate::breath::period_s;
use crate::math;

/// Dead time and lag of the valve, s.
const DEAD_TIME: f32 = 0.012;
/// See [`DEAD_TIME`].
const LAG: f32 = 0.025;
/// Flow of the valve at 0, 10, .. 100 percent against the pressure of the room, L/s.
const FLOW: [f32; 11] = [0.0, 0.046, 0.161, 0.303, 0.463, 0.639, 0.827, 1.026, 1.233, 1.449, 1.67];
/// Part of the flow that a pressure of 1 cmH2O behind the valve takes away: half of one over its supply of 150 cmH2O.
const BACK_PRESSURE: f32 = 0.0033;
/// Longest dead time, ticks.
const DELAY_MAX: usize = 48;
/// Elastance of the softest lung, cmH2O/mL, foretold while nothing is known.
const SOFTEST: f32 = 1.0 / 120.0;
/// Stiffest and softest elastance that is believed, cmH2O/mL.
const ELASTANCES: (f32, f32) = (SOFTEST, 1.0);
/// Highest resistance that is believed, cmH2O/(L/s).
const RESISTANCE_MAX: f32 = 100.0;
/// Part of the rise's square that elastance and resistance may leave unexplained.
const UNEXPLAINED: f32 = 0.1;
/// A rise below this tells nothing, cmH2O.
const TELLING_RISE: f32 = 10.0;
/// A change below this is no change but noise, cmH2O.
const STANDS: f32 = 0.6;
/// Part of the rise foretold that must be seen.
const ANSWER: f32 = 0.12;
/// A fall from the start beyond which gas is lost, cmH2O.
const FALL: f32 = 1.5;
/// Ticks over which a change is foretold, so that a reading that freezes in the middle of an inspiration is found as well.
const WINDOW: usize = 64;
/// Volume below which an inspiration tells nothing of the lung, mL.
const TELLING_VOLUME: f32 = 20.0;

/// Sums of the least squares.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Sums {
    vv: f32,
    vq: f32,
    qq: f32,
    vy: f32,
    qy: f32,
    yy: f32,
}

/// What the second opinion knows.
#[derive(Clone, Debug, PartialEq)]
pub struct Opinion {
    period: f32,
    lag_factor: f32,
    delay: usize,
    pipe: [f32; DELAY_MAX],
    at: usize,
    opening: f32,
    /// Flow of the last tick, L/s, and volume of the inspiration so far, mL.
    flow: f32,
    volume: f32,
    /// Pressure at the start of the inspiration, cmH2O.
    start: f32,
    sums: Sums,
    /// Elastance, cmH2O/mL, and resistance, cmH2O/(L/s), of the last two inspirations that told of them, the newer first.
    lungs: [Option<(f32, f32)>; 2],
    unanswered: u32,
    frozen: u32,
    /// Pressure and rise foretold of the last ticks, and how many of them belong to this inspiration.
    past: [(f32, f32); WINDOW],
    ticks: usize,
}

impl Opinion {
    /// Knows nothing of the lung yet; control period in microseconds.
    pub fn new(period_us: u32) -> Self {
        let period = period_s(period_us);
        Self {
            period,
            lag_factor: math::lag_factor(LAG, period),
            delay: (math::ticks(DEAD_TIME, period_us) as usize).min(DELAY_MAX - 1),
            pipe: [0.0; DELAY_MAX],
            at: 0,
            opening: 0.0,
            flow: 0.0,
            volume: 0.0,
            start: 0.0,
            sums: Sums::default(),
            lungs: [None; 2],
            unanswered: 0,
            frozen: 0,
            past: [(0.0, 0.0); WINDOW],
            ticks: 0,
        }
    }

    /// Elastance, cmH2O/mL, and resistance, cmH2O/(L/s), of the last inspiration that told of them.
    pub fn lung(&self) -> Option<(f32, f32)> {
        self.lungs[0]
    }

    /// Volume that the valve has delivered in this inspiration, mL.
    pub fn volume(&self) -> f32 {
        self.volume
    }

    /// An inspiration starts at a pressure, cmH2O. Of one that a cough holds up no more than PEEP is taken, so that the end
    /// of the cough is not a missing rise.
    pub fn start(&mut self, pressure: f32, peep: f32) {
        let pressure = pressure.min(peep);
        (self.start, self.volume, self.sums) = (pressure, 0.0, Sums::default());
        (self.unanswered, self.frozen, self.ticks) = (0, 0, 0);
    }

    /// Takes in the command that was applied, percent.
    #[inline]
    pub fn applied(&mut self, command: f32) {
        self.pipe[self.at] = command;
        self.at = (self.at + 1) % DELAY_MAX;
        let due = self.pipe[(self.at + DELAY_MAX - 1 - self.delay) % DELAY_MAX];
        self.opening += self.lag_factor * (due - self.opening);
    }

    /// Takes in a tick of the inspiration; whether the pressure leaves the valve's delivery unanswered.
    #[inline]
    pub fn check(&mut self, pressure: f32, times: &Times) -> bool {
        self.flow = flow(self.opening) * math::limit(1.0 - BACK_PRESSURE * pressure, 0.0, 1.0);
        self.volume += 1000.0 * self.flow * self.period;
        let rise = pressure - self.start;
        let (v, q) = (self.volume, self.flow);
        let sums = &mut self.sums;
        sums.vv += v * v;
        sums.vq += v * q;
        sums.qq += q * q;
        sums.vy += v * rise;
        sums.qy += q * rise;
        sums.yy += rise * rise;
        let foretold = self.foretold(v, q);
        let (pressure_before, foretold_before) = self.before(WINDOW);
        let (pressure_between, _) = self.before(WINDOW / 2);
        self.past[self.ticks % WINDOW] = (pressure, foretold);
        self.ticks += 1;
        let count = |counter: u32, yes: bool| if yes { counter.saturating_add(1) } else { 0 };
        // A pressure that has gone below its start is an open tube, which another monitor finds.
        let silent = foretold > TELLING_RISE && rise < ANSWER * foretold && rise > -FALL;
        self.unanswered = count(self.unanswered, silent);
        let still = |before: f32| (pressure - before).abs() < STANDS;
        // Between the end of a cough and the next rise the pressure is where it was, but was not there all the time.
        let stands = still(pressure_before) && still(pressure_between) && rise > -FALL;
        self.frozen = count(self.frozen, stands && foretold - foretold_before > TELLING_RISE);
        self.unanswered >= times.unanswered || self.frozen >= times.stands
    }

    /// Pressure and rise foretold of so many ticks ago, at most [`WINDOW`]; of the start, if the inspiration is younger.
    fn before(&self, ticks: usize) -> (f32, f32) {
        if self.ticks < ticks { (self.start, 0.0) } else { self.past[(self.ticks - ticks) % WINDOW] }
    }

    /// The rise that a volume and a flow must make at least: a patient's effort may have spoilt one of the two last
    /// inspirations.
    fn foretold(&self, volume: f32, flow: f32) -> f32 {
        let of = |(elastance, resistance): (f32, f32)| elastance * volume + resistance * flow;
        match self.lungs {
            [Some(last), Some(before)] => of(last).min(of(before)),
            [Some(lung), None] | [None, Some(lung)] => of(lung),
            [None, None] => of((SOFTEST, 0.0)),
        }
    }

    /// The inspiration has ended: learns what the lung is like, if it behaved like one.
    pub fn learn(&mut self) {
        let Sums { vv, vq, qq, vy, qy, yy } = self.sums;
        let determinant = vv * qq - vq * vq;
        if self.volume < TELLING_VOLUME || determinant <= 1e-3 * vv * qq {
            return;
        }
        let elastance = (vy * qq - qy * vq) / determinant;
        let resistance = (qy * vv - vy * vq) / determinant;
        if yy - elastance * vy - resistance * qy > UNEXPLAINED * yy {
            return;
        }
        let lung = (
            math::limit(elastance, ELASTANCES.0, ELASTANCES.1),
            math::limit(resistance, 0.0, RESISTANCE_MAX),
        );
        self.lungs = [Some(lung), self.lungs[0]];
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

    /// An inspiration with a constant command into a lung; the ticks at which the pressure was called silent.
    fn inspire(opinion: &mut Opinion, command: f32, pressure: impl Fn(&Opinion) -> f32) -> Vec<usize> {
        let times = Times::new(PERIOD_US);
        opinion.start(5.0, 5.0);
        let silent = (0..1000).filter(|_| {
            let silent = opinion.check(pressure(opinion), &times);
            opinion.applied(command);
            silent
        });
        let silent = silent.collect();
        opinion.learn();
        silent
    }

    fn lung(elastance: f32, resistance: f32) -> impl Fn(&Opinion) -> f32 {
        move |opinion| 5.0 + elastance * opinion.volume + resistance * opinion.flow
    }

    #[test]
    fn the_lung_is_found_from_one_inspiration() {
        for (compliance, resistance) in [(10.0, 5.0), (50.0, 50.0), (20.0, 20.0)] {
            let mut opinion = Opinion::new(PERIOD_US);
            inspire(&mut opinion, 30.0, lung(1.0 / compliance, resistance));
            let (e, r) = opinion.lung().unwrap();
            assert!((e * compliance - 1.0).abs() < 0.05, "C {compliance}: {}", 1.0 / e);
            assert!((r - resistance).abs() < 2.0, "R {resistance}: {r}");
        }
    }

    #[test]
    fn a_sound_lung_answers_and_a_silent_one_is_found_long_before_it_bursts() {
        let mut opinion = Opinion::new(PERIOD_US);
        let stiff = || lung(0.1, 5.0);
        assert!(inspire(&mut opinion, 40.0, stiff()).is_empty());
        assert!(inspire(&mut opinion, 40.0, stiff()).is_empty());
        let silent = inspire(&mut opinion, 100.0, |_| 5.3);
        assert!(silent[0] < 150, "found at {} ms", silent[0]);
    }

    #[test]
    fn before_the_lung_is_known_the_softest_one_is_foretold() {
        let silent = inspire(&mut Opinion::new(PERIOD_US), 100.0, |_| 5.0);
        assert!((700..950).contains(&silent[0]), "found at {} ms", silent[0]);
    }

    #[test]
    fn a_lung_that_becomes_twice_as_soft_still_answers() {
        let mut opinion = Opinion::new(PERIOD_US);
        inspire(&mut opinion, 40.0, lung(0.05, 20.0));
        assert!(inspire(&mut opinion, 40.0, lung(0.025, 20.0)).is_empty());
        assert!(inspire(&mut opinion, 40.0, lung(0.025, 5.0)).is_empty());
    }

    #[test]
    fn commands_take_effect_after_the_dead_time() {
        let mut opinion = Opinion::new(PERIOD_US);
        let times = Times::new(PERIOD_US);
        let opened = (0..40).position(|_| {
            opinion.applied(80.0);
            opinion.check(5.0, &times);
            opinion.flow > 0.0
        });
        assert_eq!(opened, Some(12));
    }
}
