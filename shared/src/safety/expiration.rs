//! What the ventilator does in expirations that do not go as they should.
//!
//! * Gas leaks: a bounded flow through the inspiratory valve makes up for the leak that the flow sensor has measured in earlier
//!   breaths, and for a pressure below PEEP all the same. So a leak does not look like an effort. Much flow is an alarm.
//! * It is still falling when the next breath is due (obstruction, trapped gas): the expiration lasts longer.
//! * It stands constant above PEEP (the PEEP valve is stuck): PIP rises by as much, so that the breaths keep their volume.
//!   Not so unless the flow sensor shows that the gas gets out again, and the pressure itself swings with the breath; and not
//!   for gas that is trapped behind a resistance, whose pressure falls as its flow does. An expiration that an effort ends is
//!   judged by what it was before the effort.

use super::breath_monitor::ABOVE_PEEP;
use super::leak::{KNOWN_LEAK, Leak, Loss};
use super::lung_estimator::command_for;
use super::monitors::{Monitors, in_a_row, ticks};
use super::responses::{Response, Responses};
use super::volumes::OUTFLOW;
use crate::breath::{Breath, Moment, Phase, period_s};
use crate::math;
use crate::safety::alarms::Fault;

/// Pressure below PEEP from which the leak is compensated, cmH2O: a sound sensor may read so much too low, and what it does not need opens
/// the valve, which looks like an effort.
const SAG: f32 = 1.0;
/// Pressure above PEEP from which a compensation is too much, cmH2O.
const SURPLUS_PRESSURE: f32 = 0.5;
/// Rise of the compensation per sag, %/s per cmH2O.
const RISE: f32 = 40.0;
/// Rise of the compensation in a breath from which the pressure has sagged, percent.
const SAGGED: f32 = 0.5;
/// Fall of the compensation while the pressure does not sag, %/s.
const RELEASE: f32 = 8.0;
/// Expirations after which a lung that never empties has filled.
const EVEN: u32 = 10;
/// Highest command of the compensation of a sag, percent. Fulfils: peep-flow.
pub const BOUND: f32 = 40.0;
/// Highest command that makes up for a leak which the flow sensor has measured, percent: at the highest PEEP a large one takes so much.
pub const LEAK_BOUND: f32 = 80.0;
/// Largest leak that is made up for in full, and the one that is an open tube, for which no flow makes up, L/s at 1 cmH2O: 1.1 and
/// 1.6 L/s at 30 cmH2O. Between them the flow fades.
const LARGE_LEAK: f32 = 0.2;
const OPEN_TUBE: f32 = 0.3;
/// Flow beyond that of a known leak that keeps the PEEP valve open, L/s.
const SURPLUS: f32 = 0.02;
/// Share of a leak's flow by which a valve may give too little.
const SPREAD: f32 = 0.2;
/// Pressure above PIP from which nothing is added to it, cmH2O: a patient coughs.
const OVERSHOOT: f32 = 2.0;
/// Compensation above which it indicates a leak, percent.
pub const LEAK: f32 = 5.0;
/// Share of the inspired volume that comes out of a tight circuit; efforts need compensation too, but their gas comes out.
pub const TIGHT: f32 = 0.75;
/// Share below which the circuit leaks, whatever the compensation: a low PEEP needs none. Fulfils: leak.
pub const OPEN: f32 = 0.6;
/// Compensation of a sag throughout a breath above which PEEP is held by flow alone, percent: the PEEP valve is stuck open,
/// or the flow sensor does not show the leak. Fulfils: baseline-low.
pub const HELD: f32 = 20.0;
/// Pressure below PEEP at the end of such a breath, cmH2O: flow alone raises it no further than to 1 cmH2O below.
pub const HELD_BELOW: f32 = 0.5 * SAG;
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
/// Longest time since the sample before those, s.
pub const RECENT: f32 = SAMPLED * (OF_EFFORT + 1) as f32;
/// Largest such change without a flow, cmH2O.
const CONSTANT: f32 = 0.5;
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
    /// Whether the pressure is below PEEP at the end of an expiration, before an effort.
    sags: bool,
    /// How many of the breaths in a row that indicate a leak a lung which fills explains.
    fills: u32,
    /// Lowest compensation in the breath: an effort raises it for a moment only.
    lowest: f32,
    /// Smoothed pressure, cmH2O.
    smooth: f32,
    /// Samples of the expiration, a ring, and their number so far.
    samples: [Sample; SAMPLES],
    sampled: usize,
    /// Incomplete expirations in a row.
    incomplete: u32,
    /// Whether the last of them was still falling.
    falling: bool,
    /// Expirations so far, and those in a row at whose end the lung had emptied.
    ended: u32,
    emptied: u32,
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
        if out > OUTFLOW { fall > WITH_FLOW_LEAST && fall * out > with_flow } else { fall > CONSTANT }
    }
}

/// What became of gas that has not come out of a breath.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Missing {
    /// A leak may have taken it.
    Lost,
    /// The lung may have kept it: more flows out at the end of the breath than of the one before.
    Kept,
    /// Other settings, or a breath that has taken much less gas than usual, explain it.
    Explained,
}

/// Whether a pressure shows that PEEP holds, both in cmH2O: it is hardly below, and no flow need raise it.
pub fn holds_peep(pressure: f32, peep: f32) -> bool {
    pressure > peep - HELD_BELOW
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
        doubtful: impl FnOnce() -> bool,
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
            let holds = sag > 0.0 && !doubtful() && self.responses.has(Response::LeakCompensation);
            let rate = if holds { RISE * sag } else { -RELEASE };
            state.compensation = math::limit(state.compensation + rate * self.period, 0.0, BOUND);
            state.lowest = state.lowest.min(state.compensation);
        }
        if moment.left() == 1 {
            self.assess(state, settings.peep, flow);
        }
        debug_assert!((0.0..=LEAK_BOUND).contains(&state.compensation()));
    }

    /// Assesses an expiration at its end.
    fn assess(&self, state: &mut ExpirationState, peep: f32, flow: f32) {
        let above = state.smooth - peep;
        state.incomplete = in_a_row(state.incomplete, self.enabled && above > ABOVE_PEEP);
        let now = Sample { pressure: state.smooth, flow };
        state.sags = !holds_peep(state.smooth, peep);
        state.note_outflow(flow);
        state.settle(now, peep);
        if above > SURPLUS_PRESSURE {
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
        if above > SURPLUS_PRESSURE {
            state.flow_is_too_much();
        }
        let before = state.sample_before(OF_EFFORT);
        state.sags = !holds_peep(before.pressure, peep);
        state.note_outflow(before.flow);
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
    /// baseline, if the pressure `swings` with the breath.
    pub fn start_breath(&self, state: &mut ExpirationState, expired_share: Option<f32>, swings: bool) {
        let comes_out = expired_share.is_some_and(|share| share >= COMES_OUT);
        let follows = comes_out && swings && self.responses.has(Response::HigherPip);
        state.shift = if follows { state.above } else { 0.0 };
        debug_assert!(state.shift >= 0.0, "PIP follows no baseline down");
    }

    /// Judges the breath before the one that has started, of which this share of the volume came out. A finding if breaths indicate a
    /// leak or a PEEP valve that holds nothing.
    pub fn judge_last(
        &self,
        state: &mut ExpirationState,
        expired_share: Option<f32>,
        missing: Missing,
    ) -> Option<Fault> {
        let least = if state.compensation() > LEAK { TIGHT } else { OPEN };
        let lost = expired_share.is_some_and(|share| share < least);
        if !lost {
            (state.leaks, state.fills) = (0, 0);
        } else if missing != Missing::Explained {
            state.leaks = state.leaks.saturating_add(1);
            // A lung that fills keeps gas in all of them.
            state.fills += u32::from(missing == Missing::Kept);
        }
        state.held = in_a_row(state.held, state.sags && state.lowest > HELD);
        state.lowest = state.compensation;
        if state.leaks >= self.leaks && state.fills < state.leaks {
            return Some(Fault::Leak);
        }
        (state.held >= self.held).then_some(Fault::BaselineLow)
    }

    /// Learns the leak from a breath's loss, to make up for it in advance at this PEEP, cmH2O, beyond this bias of the inspiratory
    /// valve, percent. While gas stays in a lung that does not empty, no flow is added. Returns whether the leak has changed.
    pub fn learn_leak(&self, state: &mut ExpirationState, (peep, bias): (f32, f32), loss: Loss) -> bool {
        // Trapped gas adds to the loss of a breath, but not so much.
        if loss.leak() > OPEN_TUBE {
            return false;
        }
        let changed = state.leak.add(loss);
        let flow = state.leak() * math::square_root(peep);
        let holds = flow > KNOWN_LEAK && state.incomplete == 0;
        let holds = holds && self.responses.has(Response::LeakCompensation);
        let share = math::limit((OPEN_TUBE - state.leak()) / (OPEN_TUBE - LARGE_LEAK), 0.0, 1.0);
        let command = command_for((1.0 + SPREAD) * flow + SURPLUS).min(LEAK_BOUND);
        let beyond = if holds { share * command - bias } else { 0.0 };
        state.advance = beyond.max(0.0);
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
    /// Another sensor is used, which reads this pressure, cmH2O.
    pub fn sensor_changed(&mut self, pressure: f32) {
        self.smooth = pressure;
    }

    /// PEEP has risen by this, cmH2O, which may be negative: PIP follows no more of a constant baseline than is above both.
    pub fn peep_changed(&mut self, rise: f32) {
        self.above = math::limit(self.above - rise, 0.0, self.above);
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

    /// Notes the smoothed flow at the end of an expiration, before an effort, L/s.
    fn note_outflow(&mut self, flow: f32) {
        self.ended = self.ended.saturating_add(1);
        self.emptied = in_a_row(self.emptied, flow >= -OUTFLOW);
    }

    /// Whether hardly any gas flowed out at the end of the last expiration.
    pub fn has_emptied(&self) -> bool {
        self.emptied > 0
    }

    /// Whether gas that a breath lacks may be lost, not in a lung that fills: hardly any flowed out at the end of the last two expirations,
    /// of which one may hide an effort, or breath has followed breath for long.
    pub fn is_even(&self) -> bool {
        self.emptied > 1 || self.ended >= EVEN
    }

    /// Change of the pressure since the last but one sample of the expiration, so within [`RECENT`], cmH2O.
    pub fn moved(&self) -> f32 {
        (self.smooth - self.sample_before(OF_EFFORT).pressure).abs()
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

    /// Command beyond the bias that holds PEEP against a leak, percent; from the fall on, so that its beginning does not look like an effort.
    pub fn compensation(&self) -> f32 {
        if self.high { 0.0 } else { (self.advance + self.compensation).min(self.advance.max(BOUND)) }
    }

    /// Whether the compensation of a sag has risen in this breath.
    pub fn has_sagged(&self) -> bool {
        self.compensation > self.lowest + SAGGED
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
mod tests;
