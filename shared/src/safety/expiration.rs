//! What the ventilator does in expirations that do not go as they should.
//!
//! * Gas leaks: a bounded flow through the inspiratory valve makes up for the leak that the flow sensor has measured in earlier
//!   breaths, and for a pressure below PEEP all the same. So a leak does not look like an effort. Much flow is an alarm.
//! * It is still falling when the next breath is due (obstruction, trapped gas): the expiration lasts longer.
//! * It stands constant above PEEP (the PEEP valve is stuck): PIP rises by as much, so that the breaths keep their volume.
//!   Not so unless the flow sensor shows that the gas gets out again, and the pressure itself swings with the breath; and not
//!   for gas that is trapped behind a resistance, whose pressure falls as its flow does. An expiration that an effort ends is
//!   judged by what it was before the effort.

use super::breath_monitor::{ABOVE_PEEP, UNCHECKED_BREATHS};
use super::leak::{Leak, Loss};
use super::lung_estimator::command_for;
use super::monitors::{Monitors, in_a_row, ticks};
use super::responses::{Response, Responses};
use crate::breath::{Breath, Moment, Phase, period_s};
use crate::math;
use crate::safety::alarms::Fault;

/// Pressure below PEEP from which the leak is compensated, cmH2O.
const SAG: f32 = 0.5;
/// Rise of the compensation per sag, %/s per cmH2O.
const RISE: f32 = 40.0;
/// Fall of the compensation while the pressure does not sag, %/s.
const RELEASE: f32 = 8.0;
/// Highest command of the compensation, percent.
pub const BOUND: f32 = 40.0;
/// Leak that is an open tube, L/s at 1 cmH2O: 0.8 L/s at 30 cmH2O. No flow makes up for it.
const OPEN_TUBE: f32 = 0.15;
/// Flow of a leak at PEEP from which it is made up for in advance, and the flow beyond it that keeps the PEEP valve open, L/s.
const KNOWN_LEAK: f32 = 0.015;
const SURPLUS: f32 = 0.02;
/// Share of a leak's flow by which a valve may give too little.
const SPREAD: f32 = 0.2;
/// Pressure above PIP from which nothing is added to it, cmH2O: a patient coughs.
const OVERSHOOT: f32 = 2.0;
/// Compensation above which it indicates a leak, percent.
pub const LEAK: f32 = 5.0;
/// Share of the inspired volume that comes out of a tight circuit; efforts need compensation too, but their gas comes out.
pub const TIGHT: f32 = 0.75;
/// Share below which the circuit leaks, whatever the compensation: a low PEEP needs none.
pub const OPEN: f32 = 0.6;
/// Compensation of a sag throughout a breath above which PEEP is held by flow alone, percent: the PEEP valve is stuck open,
/// or the flow sensor does not show the leak.
pub const HELD: f32 = 20.0;
/// Rise of the compensation in an expiration that an effort ends of which no more is kept, percent: a leak needs a little more in
/// each breath, an effort much for a moment.
const KEPT: f32 = 5.0;
/// Breaths in a row with such a compensation or loss that raise the alarm.
pub const LEAKS: u32 = 5;
/// Incomplete expirations in a row to which the ventilator responds.
pub const IN_A_ROW: u32 = 2;
/// Part of a breath, one in so many, by which an expiration may be longer.
pub const LONGER: u32 = 2;
/// Time between two samples of the expiration, s.
const SAMPLED: f32 = 0.125;
/// Samples that are kept: a constant pressure has changed little since the oldest of them.
const SAMPLES: usize = 5;
/// Samples that may belong to the effort that ends an expiration.
const OF_EFFORT: usize = 1;
/// Largest such change without a flow, cmH2O.
const CONSTANT: f32 = 0.5;
/// Flow out of the lung from which it still empties, L/s.
const EMPTIES: f32 = 0.02;
/// Share of the fall that the flow's own predicts behind a resistance from which the pressure falls with the flow, and the smallest
/// such fall, cmH2O: noise causes less.
const WITH_FLOW: f32 = 0.5;
const WITH_FLOW_LEAST: f32 = 0.1;
/// Share of the inspired volume that must come out before PIP may follow its baseline.
const COMES_OUT: f32 = 0.5;
/// Distance from the pressure limit that PIP keeps when it rises, cmH2O: more than a normal overshoot.
pub const BELOW_LIMIT: f32 = 7.0;
/// Time constant of the smoothed pressure, s.
const SMOOTHING: f32 = 0.02;

/// Configuration.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Expiration {
    /// Whether the monitor of the baseline is enabled.
    enabled: bool,
    responses: Responses,
    period: f32,
    smoothing: f32,
    /// [`SAMPLED`] in ticks.
    sampled: u32,
    /// Expirations after which a leak, or a PEEP that flow alone holds, is an alarm.
    leaks: u32,
    held: u32,
}

/// State; all zero before the first breath.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ExpirationState {
    /// Leak of the last breaths, and the command that makes up for it at PEEP, percent.
    leak: Leak,
    advance: f32,
    /// Compensation of what sags all the same, percent.
    compensation: f32,
    /// Whether the pressure is so high that no flow is added.
    high: bool,
    /// Breaths in a row that indicate a leak, and those whose PEEP flow alone holds.
    leaks: u32,
    held: u32,
    /// Lowest compensation in the breath: an effort raises it for a moment only.
    lowest: f32,
    /// Breaths that are still not compared after a change of the settings.
    unchecked: u32,
    /// Smoothed pressure, cmH2O.
    smooth: f32,
    /// Samples of the expiration, a ring, and their number so far.
    samples: [Sample; SAMPLES],
    sampled: usize,
    /// Incomplete expirations in a row.
    incomplete: u32,
    /// Whether the last of them was still falling.
    falling: bool,
    /// Constant baseline above PEEP, and the rise of PIP with it, cmH2O.
    above: f32,
    shift: f32,
}

/// Smoothed pressure, cmH2O, and smoothed flow towards the patient, L/s.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Sample {
    pressure: f32,
    flow: f32,
}

impl Sample {
    /// Whether the pressure falls from this sample to a later one. While gas comes out, it must fall as its flow does: then the gas is
    /// trapped behind a resistance. A PEEP valve that is stuck holds most of the pressure whatever the flow.
    fn falls_to(self, later: Self, peep: f32) -> bool {
        let fall = self.pressure - later.pressure;
        let (out, less) = (-self.flow, later.flow - self.flow);
        let with_flow = WITH_FLOW * (self.pressure - peep) * less;
        if out > EMPTIES { fall > WITH_FLOW_LEAST && fall * out > with_flow } else { fall > CONSTANT }
    }
}

impl Expiration {
    /// For a control period in microseconds; without the monitor of the baseline no expiration is lengthened.
    pub fn new(period_us: u32, enabled: Monitors) -> Self {
        let period = period_s(period_us);
        Self {
            enabled: enabled.has(Fault::BaselineHigh),
            responses: enabled.responses(),
            period,
            smoothing: math::lag_factor(SMOOTHING, period),
            sampled: ticks(SAMPLED, period_us),
            leaks: enabled.limit(Fault::Leak, LEAKS),
            held: enabled.limit(Fault::BaselineLow, LEAKS),
        }
    }

    /// Records the pressure of a tick of a breath, cmH2O, and its smoothed flow, L/s. A doubtful pressure, or that of an open tube,
    /// raises no flow.
    #[inline]
    pub fn observe(
        &self,
        state: &mut ExpirationState,
        moment: &Moment,
        pressure: f32,
        flow: f32,
        doubtful: bool,
    ) {
        let settings = moment.settings();
        state.smooth += self.smoothing * (pressure - state.smooth);
        state.high = pressure > settings.pip + OVERSHOOT;
        if let Some(since) = moment.tick.checked_sub(moment.breath.inspiration_ticks())
            && since.is_multiple_of(self.sampled)
        {
            state.sample(since == 0, flow);
        }
        let sag = settings.peep - SAG - pressure;
        if moment.phase == Phase::Expiration {
            let holds = sag > 0.0 && !doubtful && self.responses.has(Response::LeakCompensation);
            let rate = if holds { RISE * sag } else { -RELEASE };
            state.compensation = math::limit(state.compensation + rate * self.period, 0.0, BOUND);
            state.lowest = state.lowest.min(state.compensation);
        }
        if moment.left() == 1 {
            self.assess(state, settings.peep, flow);
        }
        debug_assert!((0.0..=BOUND).contains(&state.compensation()));
    }

    /// Assesses an expiration at its end.
    fn assess(&self, state: &mut ExpirationState, peep: f32, flow: f32) {
        let above = state.smooth - peep;
        state.incomplete = in_a_row(state.incomplete, self.enabled && above > ABOVE_PEEP);
        let now = Sample { pressure: state.smooth, flow };
        state.settle(now, peep);
        if above > SAG {
            state.forget_effort(state.lowest);
            state.flow_is_too_much();
        }
    }

    /// Assesses an expiration that an effort ends early. One that was too short to show a baseline raises PIP no further.
    /// `emptied`: it lasted long enough to have a baseline; `inhales`: gas flows to the patient while the pressure falls.
    pub fn triggered(&self, state: &mut ExpirationState, peep: f32, emptied: bool, inhales: bool) {
        let above = state.smooth - peep;
        // Without an effort, the flow has held PEEP.
        let (before, needed) = (state.lowest, state.compensation);
        state.lowest = if inhales { before } else { needed };
        state.forget_effort(before);
        if above > SAG {
            state.flow_is_too_much();
        }
        let before = state.sample_before(OF_EFFORT);
        let above = if emptied { before.pressure - peep } else { above };
        let incomplete = in_a_row(state.incomplete, self.enabled && above > ABOVE_PEEP);
        state.incomplete = if emptied { incomplete } else { incomplete.min(state.incomplete) };
        if emptied {
            state.settle(before, peep);
        } else {
            (state.falling, state.above) = (true, state.above.min(before.pressure - peep).max(0.0));
        }
    }

    /// Starts a breath after one of which this share of the volume came out, if that was measured: lets PIP follow the
    /// baseline, if the pressure `swings` with the breath. A finding if breaths indicate a leak or a PEEP valve that holds nothing.
    pub fn start_breath(
        &self,
        state: &mut ExpirationState,
        expired_share: Option<f32>,
        swings: bool,
    ) -> Option<Fault> {
        let comes_out = expired_share.is_some_and(|share| share >= COMES_OUT);
        let follows = comes_out && swings && self.responses.has(Response::HigherPip);
        state.shift = if follows { state.above } else { 0.0 };
        debug_assert!(state.shift >= 0.0, "PIP follows no baseline down");
        let least = if state.compensation() > LEAK { TIGHT } else { OPEN };
        let lost = state.unchecked == 0 && expired_share.is_some_and(|share| share < least);
        state.leaks = in_a_row(state.leaks, lost);
        state.unchecked = state.unchecked.saturating_sub(1);
        state.held = in_a_row(state.held, state.lowest > HELD);
        state.lowest = state.compensation;
        if state.leaks >= self.leaks {
            return Some(Fault::Leak);
        }
        (state.held >= self.held).then_some(Fault::BaselineLow)
    }

    /// Learns the leak from a breath's loss, to make up for it in advance at this PEEP, cmH2O. While gas stays in a lung that does
    /// not empty, no flow is added. Returns whether the leak has changed.
    pub fn learn_leak(&self, state: &mut ExpirationState, peep: f32, loss: Loss) -> bool {
        // Trapped gas adds to the loss of a breath, but not so much.
        if loss.leak() > 2.0 * OPEN_TUBE {
            return false;
        }
        let changed = state.leak.add(loss);
        let flow = state.leak() * math::square_root(peep);
        let holds = flow > KNOWN_LEAK && state.leak() <= OPEN_TUBE && state.incomplete == 0;
        let holds = holds && self.responses.has(Response::LeakCompensation);
        state.advance = if holds { command_for((1.0 + SPREAD) * flow + SURPLUS) } else { 0.0 };
        changed
    }

    /// Whether the expiration goes on at a tick at which the next breath is due.
    pub fn goes_on(&self, state: &ExpirationState, moment: &Moment) -> bool {
        let above = state.smooth - moment.settings().peep;
        let due = moment.breath.total_ticks();
        let incomplete = state.incomplete >= IN_A_ROW && above > ABOVE_PEEP;
        incomplete && state.falling && moment.tick < due + due / LONGER
    }
}

impl ExpirationState {
    /// The settings have changed, in the breath that starts now: neither it nor the next one indicates a leak, nor does the last one,
    /// and its baseline says nothing about another PEEP.
    pub fn settings_changed(&mut self) {
        self.unchecked = UNCHECKED_BREATHS + 1;
        (self.incomplete, self.above) = (0, 0.0);
    }

    /// Takes a sample; `first`: of this expiration.
    fn sample(&mut self, first: bool, flow: f32) {
        let before = if first { 0 } else { self.sampled };
        self.samples[before % SAMPLES] = Sample { pressure: self.smooth, flow };
        self.sampled = before + 1;
    }

    /// The sample so many before the last one; in a short expiration the first one. There the fall from PIP counts too, which errs on
    /// the side of a longer expiration.
    fn sample_before(&self, ago: usize) -> Sample {
        self.samples[self.sampled.saturating_sub(1 + ago) % SAMPLES]
    }

    /// Assesses the baseline at the end of an expiration, from its last telling pressure and flow.
    fn settle(&mut self, end: Sample, peep: f32) {
        self.falling = self.sample_before(SAMPLES - 1).falls_to(end, peep);
        let stands = self.incomplete >= IN_A_ROW && !self.falling;
        self.above = if stands { end.pressure - peep } else { 0.0 };
    }

    /// Smoothed pressure, cmH2O.
    pub fn smooth(&self) -> f32 {
        self.smooth
    }

    /// Expirations in a row that ended above PEEP.
    pub fn incomplete(&self) -> u32 {
        self.incomplete
    }

    /// Takes back most of what an effort has added to a compensation: it is not needed after the effort.
    fn forget_effort(&mut self, before: f32) {
        self.compensation = self.compensation.min(before + KEPT);
    }

    /// The pressure is above PEEP: half of the compensation goes, and the rest proves nothing.
    fn flow_is_too_much(&mut self) {
        self.compensation *= 0.5;
        self.lowest = 0.0;
    }

    /// Command that holds PEEP against a leak, percent; from the fall on, so that its beginning does not look like an effort.
    pub fn compensation(&self) -> f32 {
        if self.high { 0.0 } else { (self.advance + self.compensation).min(BOUND) }
    }

    /// Leak of the last breaths, L/s at 1 cmH2O; 0 before it is measured.
    pub fn leak(&self) -> f32 {
        self.leak.leak()
    }

    /// The same; none before it is measured.
    pub fn known_leak(&self) -> Option<f32> {
        self.leak.known()
    }

    /// Rise of PIP with a constant baseline, cmH2O.
    pub fn shift(&self, breath: &Breath) -> f32 {
        let settings = breath.settings();
        let highest = settings.pressure_limit - BELOW_LIMIT - settings.pip;
        math::limit(self.shift, 0.0, highest.max(0.0))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::breath::{DEFAULT_PERIOD_US, paper_settings};
    use crate::settings::Settings;

    fn breath() -> Breath {
        Breath::new(&paper_settings(25.0), DEFAULT_PERIOD_US).unwrap()
    }

    /// Runs breaths with a plateau and a pressure in the expiration by the tick since it began.
    fn breaths(count: usize, plateau: f32, pressure: impl Fn(u32) -> f32) -> (Expiration, ExpirationState) {
        breaths_with(count, plateau, Some(1.0), pressure)
    }

    /// The same, with this share of each breath's volume coming out.
    fn breaths_with(
        count: usize,
        plateau: f32,
        expired_share: Option<f32>,
        pressure: impl Fn(u32) -> f32,
    ) -> (Expiration, ExpirationState) {
        let (expiration, mut state) = (Expiration::new(1000, Monitors::ALL), ExpirationState::default());
        let breath = breath();
        for tick in (0..count).flat_map(|_| 0..breath.total_ticks()) {
            let since = tick.checked_sub(breath.inspiration_ticks());
            expiration.observe(&mut state, &breath.at(tick), since.map_or(plateau, &pressure), 0.0, false);
            if tick + 1 == breath.total_ticks() {
                expiration.start_breath(&mut state, expired_share, true);
            }
        }
        (expiration, state)
    }

    #[test]
    fn a_sag_is_compensated_and_the_compensation_ends_with_it() {
        let (expiration, mut state) = breaths(1, 25.0, |_| 4.0);
        assert!((15.0..35.0).contains(&state.compensation()), "{}", state.compensation());
        let (_, bounded) = breaths(9, 25.0, |_| 0.0);
        assert!((bounded.compensation() - BOUND).abs() < 1e-3);
        let breath = breath();
        for tick in (0..15).flat_map(|_| 1500..3000) {
            expiration.observe(&mut state, &breath.at(tick), 5.0, 0.0, false);
        }
        assert!(state.compensation().abs() < 1e-3);
    }

    #[test]
    fn a_sag_that_only_one_of_two_sensors_shows_raises_no_flow() {
        let (expiration, mut state) = breaths(0, 25.0, |_| 0.0);
        let breath = breath();
        for tick in 1500..3000 {
            expiration.observe(&mut state, &breath.at(tick), 2.0, 0.0, true);
        }
        assert!(state.compensation().abs() < 1e-3);
    }

    #[test]
    fn a_leak_takes_compensation_and_gas_and_an_effort_compensation_alone() {
        let leaks = |share, pressure: f32| {
            let (expiration, mut state) = breaths_with(6, 25.0, share, |_| pressure);
            state.compensation = state.compensation.max(if pressure < 4.5 { BOUND } else { 0.0 });
            expiration.start_breath(&mut state, share, true) == Some(Fault::Leak)
        };
        assert!(leaks(Some(0.7), 4.0) && leaks(Some(0.5), 5.0));
        assert!(!leaks(Some(0.9), 4.0) && !leaks(None, 4.0) && !leaks(Some(0.7), 5.0));
        let (expiration, mut state) = breaths_with(3, 25.0, Some(0.5), |_| 5.0);
        assert_eq!(expiration.start_breath(&mut state, Some(0.5), true), None);
        assert_eq!(expiration.start_breath(&mut state, Some(0.5), true), Some(Fault::Leak));
    }

    #[test]
    fn a_peep_that_flow_alone_holds_is_a_finding() {
        let (expiration, mut state) = breaths(0, 25.0, |_| 5.0);
        let mut held = |compensation, share| {
            (state.compensation, state.lowest) = (compensation, compensation);
            expiration.start_breath(&mut state, share, true)
        };
        assert_eq!([(); 5].map(|()| held(20.1, None)), [None, None, None, None, Some(Fault::BaselineLow)]);
        assert_eq!(held(20.0, None), None);
        assert_eq!(
            [(); 5].map(|()| held(30.0, Some(1.0))),
            [None, None, None, None, Some(Fault::BaselineLow)]
        );
    }

    #[test]
    fn an_effort_leaves_little_compensation_behind() {
        let (expiration, mut state) = breaths(0, 25.0, |_| 5.0);
        for inhales in [true, false] {
            for (needed, kept) in [(30.0, 17.0), (17.1, 17.0), (16.9, 16.9)] {
                (state.compensation, state.lowest) = (needed, 12.0);
                expiration.triggered(&mut state, 5.0, false, inhales);
                assert!((state.compensation() - kept).abs() < 1e-4);
            }
        }
    }

    #[test]
    fn flow_that_holds_peep_is_found_in_breaths_that_no_effort_has_started() {
        let found = |inhales: bool, flow: f32| {
            let (expiration, mut state) = breaths(0, 25.0, |_| 5.0);
            (0..5).any(|_| {
                (state.compensation, state.lowest) = (flow, 5.0);
                expiration.triggered(&mut state, 5.0, false, inhales);
                expiration.start_breath(&mut state, None, true) == Some(Fault::BaselineLow)
            })
        };
        assert!(found(false, 20.1) && !found(false, 20.0) && !found(true, 30.0));
    }

    /// A breath that loses the gas of a leak, L/s at 1 cmH2O.
    fn lost(leak: f32) -> Loss {
        Loss { gas: 1000.0 * leak, root: 1.0, inspired: 200.0 }
    }

    #[test]
    fn a_leak_that_earlier_breaths_have_shown_is_made_up_for_in_advance() {
        let (expiration, mut state) = breaths(0, 25.0, |_| 5.0);
        let learnt = |state: &mut ExpirationState, leak: f32, peep: f32| {
            for _ in 0..60 {
                expiration.learn_leak(state, peep, lost(leak));
            }
            state.compensation()
        };
        // 0.1 L/s at PEEP, a fifth more, and 0.02 L/s: the valve's flow at 30 % is 0.303 L/s, at 20 % 0.161, at 10 % 0.046.
        assert!((learnt(&mut state, 0.05, 4.0) - 18.17).abs() < 0.05, "{}", state.compensation());
        assert!((learnt(&mut state, 0.05, 16.0) - 26.95).abs() < 0.1, "{}", state.compensation());
        assert!(learnt(&mut state, 0.0074, 4.0).abs() < 1e-6, "a tight circuit");
        assert!(learnt(&mut state, 0.0076, 4.0) > 5.0);
        assert!(learnt(&mut state, -0.3, 4.0).abs() < 1e-6);
        assert!((learnt(&mut state, OPEN_TUBE, 16.0) - BOUND).abs() < 1e-6);
        assert!(learnt(&mut state, 0.151, 4.0).abs() < 1e-6, "an open tube");
        assert!(learnt(&mut state, 0.05, 4.0) > 5.0 && (state.leak() - 0.05).abs() < 1e-5);
        learnt(&mut state, 0.301, 4.0);
        assert!((state.leak() - 0.05).abs() < 1e-5, "a disconnected patient");
        learnt(&mut state, 0.3, 4.0);
        assert!((state.leak() - 0.3).abs() < 1e-5);
    }

    #[test]
    fn nothing_is_added_to_a_pressure_above_pip() {
        let (expiration, mut state) = breaths(0, 25.0, |_| 5.0);
        expiration.learn_leak(&mut state, 5.0, lost(0.1));
        for (pressure, flows) in [(27.0, true), (27.1, false), (24.0, true)] {
            expiration.observe(&mut state, &breath().at(1200), pressure, 0.0, false);
            assert_eq!(state.compensation() > 5.0, flows, "{pressure} cmH2O at a PIP of 25");
        }
    }

    #[test]
    fn a_leak_at_the_bound_needs_no_flow() {
        let expiration = Expiration::new(1000, Monitors::ALL);
        let compensation = |leak: f32| {
            let mut state = ExpirationState::default();
            expiration.learn_leak(&mut state, 1.0, lost(leak));
            state.compensation()
        };
        assert!(compensation(0.99 * KNOWN_LEAK).abs() < 1e-6 && compensation(1.01 * KNOWN_LEAK) > 5.0);
    }

    #[test]
    fn while_a_lung_does_not_empty_no_flow_is_added_to_it() {
        let (expiration, mut state) = breaths(0, 25.0, |_| 5.0);
        expiration.learn_leak(&mut state, 5.0, lost(0.1));
        assert!(state.compensation() > 5.0);
        state.incomplete = 1;
        expiration.learn_leak(&mut state, 5.0, lost(0.1));
        assert!(state.compensation().abs() < 1e-6 && (state.leak() - 0.1).abs() < 1e-6, "the leak is known");
    }

    #[test]
    fn flow_that_holds_more_than_peep_is_halved() {
        let (expiration, _) = breaths(0, 25.0, |_| 5.0);
        let after = |smooth: f32, inhales: Option<bool>| {
            let mut state =
                ExpirationState { smooth, compensation: 37.0, lowest: 21.0, ..Default::default() };
            match inhales {
                None => expiration.assess(&mut state, 5.0, 0.0),
                Some(inhales) => expiration.triggered(&mut state, 5.0, false, inhales),
            }
            (state.compensation, state.lowest)
        };
        assert_eq!([after(5.5, None), after(5.51, None)], [(37.0, 21.0), (13.0, 0.0)]);
        assert_eq!([after(5.5, Some(true)), after(5.51, Some(true))], [(26.0, 21.0), (13.0, 0.0)]);
        assert_eq!([after(5.5, Some(false)), after(5.51, Some(false))], [(26.0, 37.0), (13.0, 0.0)]);
    }

    /// Expirations that an effort ends after so many ticks, each with this pressure until 0.1 s before their end, where the effort
    /// begins, and this flow, L/s.
    fn triggered(
        count: usize,
        ticks: u32,
        pressure: impl Fn(u32) -> f32,
        flow: impl Fn(u32) -> f32,
    ) -> ExpirationState {
        let (expiration, mut state) = breaths(0, 25.0, |_| 5.0);
        let breath = breath();
        for since in (0..count).flat_map(|_| 0..ticks) {
            let effort = 0.05 * (since + 100).saturating_sub(ticks) as f32;
            let pressure = pressure(since) - effort;
            expiration.observe(&mut state, &breath.at(1000 + since), pressure, flow(since), false);
            if since + 1 == ticks {
                expiration.triggered(&mut state, 5.0, ticks >= 1000, true);
                expiration.start_breath(&mut state, Some(1.0), true);
            }
        }
        state
    }

    /// A lung that empties with this time constant, ticks.
    fn empties(time_constant: f32) -> impl Fn(u32) -> f32 {
        move |since: u32| (-(since as f32) / time_constant).exp()
    }

    #[test]
    fn pip_follows_a_stuck_peep_valve_as_well_if_efforts_end_the_expirations() {
        let stuck = |since: u32| if since < 100 { 25.0 } else { 15.0 };
        let shift =
            |count| triggered(count, 1500, stuck, |since| -0.5 * empties(250.0)(since)).shift(&breath());
        assert!(shift(1).abs() < 1e-6 && (shift(2) - 10.0).abs() < 0.1, "{} {}", shift(1), shift(2));
        // A slow lung still empties, and the valve's own resistance lets the pressure fall a little.
        let slow = |since: u32| 15.0 + 0.8 * empties(1000.0)(since);
        let shift = triggered(2, 1500, slow, |since| -0.4 * empties(1000.0)(since)).shift(&breath());
        assert!((10.0..10.4).contains(&shift), "{shift}");
    }

    #[test]
    fn pip_does_not_follow_gas_that_is_trapped_behind_a_resistance() {
        for time_constant in [2000.0, 3000.0, 6000.0] {
            let share = empties(time_constant);
            let state = triggered(3, 1500, |since| 5.0 + 14.0 * share(since), |since| -0.3 * share(since));
            assert!(state.shift(&breath()).abs() < 1e-6, "{time_constant} ms, and an effort");
            let (expiration, mut state) = breaths(0, 25.0, |_| 5.0);
            for tick in (0..3).flat_map(|_| 1000..3000) {
                let share = share(tick - 1000);
                expiration.observe(&mut state, &breath().at(tick), 5.0 + 14.0 * share, -0.3 * share, false);
                if tick == 2999 {
                    expiration.start_breath(&mut state, Some(1.0), true);
                }
            }
            assert!(state.shift(&breath()).abs() < 1e-6 && state.incomplete == 3, "{time_constant} ms");
        }
    }

    #[test]
    fn an_expiration_too_short_for_a_baseline_raises_pip_no_further() {
        let (expiration, _) = breaths(0, 25.0, |_| 5.0);
        let shift = |baseline: f32| {
            let mut state = triggered(2, 1500, |_| 15.0, |_| 0.0);
            state.samples = [Sample { pressure: baseline, flow: 0.0 }; SAMPLES];
            expiration.triggered(&mut state, 5.0, false, true);
            expiration.start_breath(&mut state, Some(1.0), true);
            state.shift(&breath())
        };
        assert!((shift(19.0) - 10.0).abs() < 0.1 && (shift(12.0) - 7.0).abs() < 1e-3 && shift(4.0) == 0.0);
    }

    #[test]
    fn pip_follows_only_a_pressure_that_swings() {
        let (expiration, mut state) = breaths(2, 25.0, |_| 15.0);
        assert!(state.shift(&breath()) > 9.0);
        expiration.start_breath(&mut state, Some(1.0), false);
        assert!(state.shift(&breath()).abs() < 1e-6);
    }

    #[test]
    fn an_expiration_that_an_effort_ends_counts_as_incomplete_by_its_pressure_before() {
        let state = triggered(2, 1500, |_| 8.1, |_| 0.0);
        assert_eq!(state.incomplete, 2, "the effort lowers the pressure to 3.1 cmH2O");
        assert_eq!(triggered(2, 1500, |_| 8.0, |_| 0.0).incomplete, 0, "at the bound");
        let (expiration, mut state) = breaths(0, 25.0, |_| 5.0);
        for (smooth, left) in [(8.1, 2), (8.0, 0)] {
            (state.incomplete, state.smooth) = (2, smooth);
            expiration.triggered(&mut state, 5.0, false, true);
            assert_eq!((state.incomplete, state.falling), (left, true), "still emptying");
        }
    }

    #[test]
    fn the_breaths_around_a_change_of_the_settings_tell_of_no_leak() {
        let (expiration, mut state) = breaths_with(2, 25.0, Some(0.5), |_| 5.0);
        state.settings_changed();
        let told = (1..9).find(|_| expiration.start_breath(&mut state, Some(0.5), true).is_some());
        assert_eq!(told, Some(8), "the last breath, two new ones, and five that count");
    }

    #[test]
    fn a_baseline_at_other_settings_moves_no_pip() {
        let (expiration, mut state) = breaths(2, 25.0, |_| 15.0);
        state.settings_changed();
        expiration.start_breath(&mut state, Some(1.0), true);
        assert!(state.shift(&breath()).abs() < 1e-6 && !expiration.goes_on(&state, &breath().at(3000)));
    }

    #[test]
    fn noise_around_peep_is_no_sag() {
        let (_, state) = breaths(10, 25.0, |tick| if tick % 2 == 0 { 4.6 } else { 5.4 });
        assert!(state.compensation().abs() < 1e-3);
    }

    #[test]
    fn an_expiration_that_still_falls_lasts_up_to_half_a_breath_longer() {
        let slowly = |tick: u32| 25.0 - 0.005 * tick as f32;
        let (expiration, state) = breaths(2, 25.0, slowly);
        let breath = breath();
        assert!(expiration.goes_on(&state, &breath.at(3000)) && expiration.goes_on(&state, &breath.at(4499)));
        assert!(!expiration.goes_on(&state, &breath.at(4500)));
        assert!(state.shift(&breath).abs() < 1e-6, "PIP does not rise");
        let (expiration, state) = breaths(1, 25.0, slowly);
        assert!(!expiration.goes_on(&state, &breath.at(3000)), "after the second one");
        let (mut expiration, state) = breaths(2, 25.0, slowly);
        expiration = Expiration { enabled: false, ..expiration };
        let mut without = ExpirationState { incomplete: 0, ..state };
        expiration.assess(&mut without, 5.0, 0.0);
        assert!(!expiration.goes_on(&without, &breath.at(3000)));
    }

    #[test]
    fn pip_follows_a_constant_baseline_up_to_the_limit() {
        let (expiration, state) = breaths(2, 25.0, |_| 15.0);
        assert!((state.shift(&breath()) - 10.0).abs() < 0.1);
        assert!(!expiration.goes_on(&state, &breath().at(3000)), "it would not fall any further");
        let tight = Settings { pressure_limit: 36.0, ..paper_settings(25.0) };
        let tight = Breath::new(&tight, DEFAULT_PERIOD_US).unwrap();
        assert!((state.shift(&tight) - 4.0).abs() < 1e-3);
        let (_, back) = breaths(3, 25.0, |_| 5.0);
        assert!(back.shift(&breath()).abs() < 1e-6);
    }

    #[test]
    fn pip_does_not_rise_if_the_gas_does_not_get_out() {
        for share in [Some(0.2), None] {
            let (_, state) = breaths_with(4, 25.0, share, |_| 15.0);
            assert!(state.shift(&breath()).abs() < 1e-6);
        }
    }

    #[test]
    fn a_sag_of_one_raises_the_compensation_by_forty_a_second_and_its_end_lowers_it_by_eight() {
        let change = |tick, pressure, doubtful| {
            let mut state = ExpirationState { compensation: 10.0, ..ExpirationState::default() };
            let expiration = Expiration::new(1000, Monitors::ALL);
            expiration.observe(&mut state, &breath().at(tick), pressure, 0.0, doubtful);
            (1e4 * (state.compensation() - 10.0) + 0.5).floor() as i32
        };
        assert_eq!((change(2000, 3.5, false), change(2000, 4.0, false)), (400, 200));
        assert_eq!((change(2000, 4.5, false), change(2000, 3.5, true)), (-80, -80), "no sag");
        assert_eq!(
            (change(1499, 3.5, false), change(1500, 3.5, false)),
            (0, 400),
            "from the end of the fall on"
        );
    }

    #[test]
    fn an_expiration_at_a_bound_is_on_its_better_side() {
        let (expiration, breath) = (Expiration::new(1000, Monitors::ALL), breath());
        let second = |smooth, earlier| {
            let samples = [Sample { pressure: earlier, flow: 0.0 }; SAMPLES];
            let mut state = ExpirationState { smooth, samples, incomplete: 1, ..ExpirationState::default() };
            expiration.assess(&mut state, 5.0, 0.0);
            (state.incomplete, state.falling, expiration.goes_on(&state, &breath.at(3000)))
        };
        assert_eq!(second(8.0, 9.0), (0, true, false), "3 cmH2O above PEEP");
        assert_eq!(second(8.1, 9.0), (2, true, true));
        assert_eq!(second(8.5, 9.0), (2, false, false), "a fall of half a cmH2O");
        let state =
            ExpirationState { smooth: 8.0, incomplete: 2, falling: true, ..ExpirationState::default() };
        assert!(!expiration.goes_on(&state, &breath.at(3000)));
    }

    #[test]
    fn the_shares_of_a_leak_and_of_gas_that_comes_out_are_exact() {
        let expiration = Expiration::new(1000, Monitors::ALL);
        let started = |compensation, share| {
            let mut state =
                ExpirationState { compensation, leaks: LEAKS - 1, above: 10.0, ..ExpirationState::default() };
            (expiration.start_breath(&mut state, Some(share), true).is_some(), state.shift(&breath()) > 9.0)
        };
        assert_eq!([started(LEAK, 0.6), started(LEAK, 0.59)], [(false, true), (true, true)]);
        assert_eq!([started(5.1, TIGHT), started(5.1, 0.74)], [(false, true), (true, true)]);
        assert_eq!([started(0.0, 0.5), started(0.0, 0.49)], [(true, true), (true, false)]);
    }

    #[test]
    fn a_short_expiration_that_still_falls_lasts_longer_and_pip_does_not_rise() {
        // At 60 breaths a minute expiration and fall take 0.6 s, of which the fall takes 0.17.
        let settings =
            Settings { rate: 60.0, inspiratory_time: 0.4, fall_time: 0.17, ..paper_settings(25.0) };
        let breath = Breath::new(&settings, DEFAULT_PERIOD_US).unwrap();
        let (expiration, mut state) = (Expiration::new(1000, Monitors::ALL), ExpirationState::default());
        for tick in (0..3).flat_map(|_| 0..1000_u32) {
            let pressure = 25.0 - 0.02 * tick.saturating_sub(400) as f32;
            expiration.observe(&mut state, &breath.at(tick), pressure, 0.0, false);
            if tick == 999 {
                expiration.start_breath(&mut state, Some(1.0), true);
            }
        }
        assert!(expiration.goes_on(&state, &breath.at(1000)));
        assert!(state.shift(&breath).abs() < 1e-6);
    }

    #[test]
    fn pip_is_never_lowered_however_close_the_limit() {
        let close = Settings { pressure_limit: 30.0, ..paper_settings(25.0) };
        let close = Breath::new(&close, DEFAULT_PERIOD_US).unwrap();
        for shift in [0.0, 10.0] {
            let state = ExpirationState { shift, ..ExpirationState::default() };
            assert!(state.shift(&close).abs() < 1e-6, "{}", state.shift(&close));
        }
    }
}
