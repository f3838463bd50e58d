//! Checks each breath: once per phase, from pressure and command at its end; for a lost airway pressure in every tick.

use super::alarms::Fault;
use super::monitors::{Monitors, in_a_row, ticks};
use super::settling::{Settling, UNCHECKED_BREATHS, exchange_time, filling_time};
use super::volumes::BreathVolumes;
use super::windows::Windows;
use crate::breath::Moment;
use crate::settings::Settings;

/// Pressure above PEEP at which an expiration counts as incomplete, cmH2O. Fulfils: baseline-high.
pub const ABOVE_PEEP: f32 = 3.0;
/// Pressure below PEEP at which PEEP counts as lost, cmH2O. Fulfils: baseline-low.
pub const BELOW_PEEP: f32 = 2.0;
/// Share of an inspiration's gas that may refill the lung in a breath that is compared with others.
const REFILLS: f32 = 0.2;
/// Fall of the pressure from one window at the end of an expiration to the next that shows a lung which still empties, cmH2O.
const FALLS: f32 = 0.1;
/// Recent change of the pressure with which an effort draws it below PEEP, or lets it go, cmH2O.
pub const DRAWN: f32 = 1.0;
/// Pressure below PEEP that does not prove a sound baseline while PEEP changes, cmH2O.
const NEARLY_LOW: f32 = 1.0;
/// Fraction of the rise from PEEP to PIP that an inspiration must reach. Fulfils: low-pressure.
pub const REACHED: f32 = 0.3;
/// Mean command above which the valve counts as wide open, percent.
pub const WIDE_OPEN: f32 = 60.0;
/// Flow from which gas goes to the patient, L/s.
const DRAUGHT: f32 = 0.02;
/// Fraction of the rise below which an inspiration does not reach its pressure if a noisy reading caps its command: less of the volume
/// is too little in silence.
pub const CAPPED: f32 = 0.8;
/// Fraction of PEEP below which the airway is open; an effort rarely pulls the pressure so low.
pub const OPEN_END: f32 = 0.4;
/// Pressure up to which a tube may be open at any PEEP, cmH2O: what its end holds back from a full flow, and a sensor's offset. Gas
/// that does not come back proves it.
pub const ROOM: f32 = 1.5;
/// Lowest pressure of an open tube, cmH2O: an effort pulls a closed one lower.
const LOWEST_OPEN: f32 = -2.0;
/// Share of the gas that has gone in of which less comes back from an open tube.
pub const COMES_BACK: f32 = 0.2;
/// Gas, mL, that seems to come back besides because of the flow sensor's noise.
const NOISE: f32 = 12.0;
/// Smallest gas of which that can be told, mL, and the time at the end of its inspiration at such a pressure, s.
const TELLING_GAS: f32 = 20.0;
const OPEN_FOR: f32 = 0.04;
/// Time after an inspiration in which gas comes back, s: longer than an effort that keeps it.
pub const RETURNS: f32 = 2.0;
/// Pressure above which an airway is closed again, at a lower PEEP, cmH2O.
pub const CLOSED: f32 = 2.5;
/// Command above which the pressure of a connected airway must rise, percent.
pub const FILLING: f32 = 30.0;
/// Fraction of the earlier compliance below which the tube counts as occluded. Fulfils: occlusion.
pub const OCCLUDED: f32 = 1.0 / 3.0;
/// Share of the delivered volume that passes an open or narrowed tube to the patient, and comes out again. With an occluded one
/// the gas stays in the circuit.
pub const PASSES: f32 = 0.5;
/// Share of the delivered volume that comes out of an open tube: the circuit keeps the rest.
pub const OPEN: f32 = 0.8;
/// Breaths in a row that end above PEEP and are a fault.
pub const HIGH_BREATHS: u32 = 2;
/// Breaths in a row that end below PEEP and are a fault.
pub const LOW_BREATHS: u32 = 3;
/// Inspirations in a row that end with a low pressure and are a fault.
pub const WEAK_BREATHS: u32 = 2;
/// Breaths in a row with a low compliance that are a fault.
pub const OCCLUDED_BREATHS: u32 = 2;
/// Breaths in a row with a low compliance that are a fault although gas passes the tube: efforts against the machine can take
/// the volume of several.
pub const NARROWED_BREATHS: u32 = 10;
/// Breaths in a row that end above PEEP and are a fault although efforts end them early: a few can follow double efforts.
pub const TRAPPED_BREATHS: u32 = 4;
/// Smallest rise from which a compliance is estimated, cmH2O.
const TELLING_RISE: f32 = 3.0;

/// Breaths in a row with a leak that make the earlier volumes useless; an occlusion looks like a leak for one breath.
const LEAKY_BREATHS: u32 = 3;
/// Breaths with a lower compliance after which it is taken for the lung's own.
const NEW_LUNG: u32 = 20;
/// Time for which the pressure of an inspiration must be back above PEEP after a disconnection, s.
const CONNECTED: f32 = 0.05;

/// Length of the averaging window at the end of a phase, s.
const END_OF_PHASE: f32 = 0.05;
/// Time in inspirations for which the airway pressure may be lost, s: strong efforts take more gas than there is for a while.
pub const DISCONNECTED: f32 = 0.6;
/// The same with a capped command, s. Fulfils: disconnection.
pub const SLOW_DISCONNECTED: f32 = 1.2;

/// Checks the phases of each breath.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BreathMonitor {
    /// [`END_OF_PHASE`], [`DISCONNECTED`], [`SLOW_DISCONNECTED`] and [`CONNECTED`] in ticks.
    end_of_phase: u32,
    disconnected: u32,
    slow_disconnected: u32,
    connected: u32,
    /// [`OPEN_FOR`] and [`RETURNS`] in ticks.
    open_for: u32,
    returns: u32,
    /// Whether a disconnection is a finding.
    finds_open: bool,
    /// Consecutive breaths with a condition that make it a fault.
    high: u32,
    above: u32,
    low: u32,
    weak: u32,
    occluded: u32,
}

/// State of the breath monitor.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct BreathState {
    pressure: Mean,
    command: Mean,
    /// Pressure in the windows of the expiration.
    rest: Windows<1>,
    gone: u32,
    /// Ticks at the end of the inspiration in which the tube may have been open.
    open: u32,
    /// Whether the patient is disconnected, and the ticks for which the pressure has been back.
    disconnected: bool,
    back: u32,
    /// Whether the running inspiration was ended at the pressure limit.
    cut: bool,
    /// Consecutive breaths that end above PEEP, without those that efforts end early and with them.
    high: u32,
    above: u32,
    /// Consecutive breaths with each further condition.
    low: u32,
    weak: u32,
    occluded: u32,
    /// Those of the last two good breaths, the newer first: an effort may have raised one of them.
    compliances: [Option<Compliance>; 2],
    /// Volumes of the last breath with a lower one, mL: the delivered one, and the expired one with which it is no occlusion.
    delivered: f32,
    normal: f32,
    /// Whether as much gas passed the tube in that breath.
    passed: bool,
    /// Breaths in a row with a leak.
    leaky: u32,
    /// Wait of the baseline after a change of the settings, and PEEP before it, cmH2O.
    settling: Settling,
    peep_before: f32,
}

/// Volume per pressure of a good breath.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Compliance {
    /// mL/cmH2O.
    value: f32,
    /// [`exchange_time`] of the breath as set, s.
    time: f32,
}

impl Compliance {
    /// The least that the same lung takes in a breath with this [`exchange_time`], s.
    fn at(self, time: f32) -> f32 {
        self.value * (time / self.time).min(1.0)
    }
}

impl BreathState {
    /// The settings have changed so that breaths have to settle: their baseline waits, and nothing else. PEEP was `peep_before`, cmH2O.
    pub fn settings_changed(&mut self, peep_before: f32) {
        if self.settling.begin(UNCHECKED_BREATHS) {
            (self.high, self.above, self.low) = (0, 0, 0);
        }
        self.peep_before = peep_before;
    }

    /// The lowest and the highest PEEP to which the lung may still be settling, cmH2O.
    fn peeps(&self, peep: f32) -> (f32, f32) {
        let before = if self.settling.has_rested() { peep } else { self.peep_before };
        (peep.min(before), peep.max(before))
    }

    /// Ends a breath of these volumes. An effort may take in the gas only in the expiration.
    fn breath_ended(&mut self, volumes: Option<BreathVolumes>) {
        if volumes.is_some_and(|volumes| volumes.expired >= self.normal) {
            self.occluded = 0;
        }
        let passed = volumes.map(|volumes| volumes.expired.max(volumes.inspired));
        self.passed = passed.is_some_and(|passed| passed >= PASSES * self.delivered);
    }

    /// The lower volume per pressure that the last two good breaths let expect of one with this [`exchange_time`], s; mL/cmH2O.
    fn compliance(&self, time: f32) -> Option<f32> {
        self.compliances.into_iter().flatten().map(|before| before.at(time)).reduce(f32::min)
    }

    /// Another pressure sensor is used: by it, the same gas may raise the pressure by more or less.
    pub fn sensor_changed(&mut self) {
        self.compliances = [None; 2];
    }

    /// The inspiration ends because its gas may flow out of an open tube: the expiration shows whether it does.
    pub fn doubt(&mut self) {
        self.open = u32::MAX;
    }

    /// Whether the airway is open, by the running inspiration.
    pub fn is_disconnected(&self) -> bool {
        self.disconnected
    }
}

/// Input of the monitor in one tick.
#[derive(Clone, Copy, Debug)]
pub struct BreathInput<'a> {
    /// The tick of the running breath.
    pub moment: Moment<'a>,
    /// Whether its inspiration was ended at the pressure limit.
    pub cut: bool,
    /// Believed pressure, cmH2O.
    pub pressure: f32,
    /// Last command, percent.
    pub command: f32,
    /// Cap of the command.
    pub cap: Cap,
    /// Volume delivered so far in this inspiration, mL.
    pub volume: f32,
    /// Share of it that a sound flow sensor usually shows.
    pub share: f32,
    /// Volume that has reached the patient so far, mL; none if the flow is not measured.
    pub reached: Option<f32>,
    /// Volume that the flow sensor has shown towards the patient so far, mL; none if the flow is not measured.
    pub inspired: Option<f32>,
    /// Volume that has come back from the patient so far, mL.
    pub returned: f32,
    /// Gas that the lung has given out beyond its breaths, as in a strain, and takes in again, mL.
    pub refill: f32,
    /// Whether a part of it is lost through a leak.
    pub leaks: bool,
    /// Smoothed flow to the patient, L/s, without which no tube is open; none without a sound flow sensor.
    pub flow: Option<f32>,
    /// Whether the two pressure sensors differ.
    pub doubtful: bool,
    /// Recent change of the pressure at the end of an expiration, cmH2O.
    pub moved: f32,
    /// Volumes that went in and came out in the last breath, mL; none if the flow was not measured.
    pub last: Option<BreathVolumes>,
}

/// Running mean over the end of a phase.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Mean {
    sum: f32,
    count: u32,
}

impl Mean {
    fn add(&mut self, value: f32) {
        self.sum += value;
        self.count += 1;
    }

    /// Returns the mean and starts a new one.
    fn take(&mut self) -> f32 {
        let Self { sum, count } = core::mem::take(self);
        sum / count.max(1) as f32
    }
}

/// Whether the command is capped, and why.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Cap {
    /// It is not.
    None,
    /// Breaths have ended at the pressure limit.
    ByLimit,
    /// The pressure reading is noisy.
    ByNoise,
}

/// Whether a pressure is that of an open airway at this PEEP, cmH2O.
fn is_gone(pressure: f32, peep: f32) -> bool {
    pressure < peep - BELOW_PEEP && pressure < OPEN_END * peep
}

/// Whether a tube with gas that flows in may be open at this pressure and PEEP, cmH2O; only the gas that comes back tells.
pub fn may_be_open(pressure: f32, peep: f32) -> bool {
    pressure > LOWEST_OPEN && (pressure < ROOM || is_gone(pressure, peep))
}

impl BreathMonitor {
    /// A monitor for a control period in microseconds that reports the enabled findings only.
    pub fn new(period_us: u32, enabled: Monitors) -> Self {
        Self {
            end_of_phase: ticks(END_OF_PHASE, period_us),
            disconnected: enabled.limit(Fault::Disconnection, ticks(DISCONNECTED, period_us)),
            slow_disconnected: enabled.limit(Fault::Disconnection, ticks(SLOW_DISCONNECTED, period_us)),
            connected: ticks(CONNECTED, period_us),
            open_for: ticks(OPEN_FOR, period_us),
            returns: ticks(RETURNS, period_us),
            finds_open: enabled.has(Fault::Disconnection),
            high: enabled.limit(Fault::BaselineHigh, HIGH_BREATHS),
            above: enabled.limit(Fault::BaselineHigh, TRAPPED_BREATHS),
            low: enabled.limit(Fault::BaselineLow, LOW_BREATHS),
            weak: enabled.limit(Fault::LowPressure, WEAK_BREATHS),
            occluded: enabled.limit(Fault::Occlusion, OCCLUDED_BREATHS),
        }
    }

    /// Length of the window at the end of a phase in which its means are taken, ticks.
    pub fn end_of_phase(&self) -> u32 {
        self.end_of_phase
    }

    /// Checks one tick. An inspiration that is ended at the pressure limit is checked for occlusion only.
    #[inline]
    pub fn check(&self, state: &mut BreathState, input: &BreathInput) -> Option<Fault> {
        let BreathInput { moment, cut, pressure, command, leaks, last, .. } = *input;
        if moment.tick == 0 {
            state.leaky = in_a_row(state.leaky, leaks);
            state.breath_ended(last);
        }
        if state.leaky >= LEAKY_BREATHS {
            // Volumes with and without a leak are not comparable.
            state.compliances = [None; 2];
        }
        let (peep, inspires) = (moment.settings().peep, moment.inspires());
        let left = if inspires { moment.breath.inspiration_ticks() - moment.tick } else { moment.left() };
        if inspires && !cut {
            let gone = state.gone.saturating_add(u32::from(command > FILLING));
            let flows = input.flow.is_none_or(|flow| flow >= DRAUGHT);
            let open = flows && pressure > LOWEST_OPEN && is_gone(pressure, peep);
            state.gone = if open { gone } else { 0 };
            if left <= self.open_for {
                state.open = in_a_row(state.open, may_be_open(pressure, peep));
            }
        } else if !inspires && (left == 1 || moment.tick == moment.breath.inspiration_ticks() + self.returns)
        {
            state.disconnected |= self.finds_open && self.loses_all(state, input);
        }
        let longest = if input.cap == Cap::None { self.disconnected } else { self.slow_disconnected };
        state.back = in_a_row(state.back, inspires && pressure > peep && pressure > CLOSED);
        state.disconnected = (state.disconnected || state.gone >= longest) && state.back < self.connected;
        if state.disconnected {
            state.cut = cut;
            return Some(Fault::Disconnection);
        }
        // A high baseline has another cause.
        let cut_now = inspires && cut && !state.cut && state.high == 0;
        if cut_now && self.occluded(state, pressure - peep, input) {
            return Some(Fault::Occlusion);
        }
        state.cut = cut;
        // What only one of two sensors shows is the concern of their comparison.
        state.rest.add(&moment, self.end_of_phase, (!input.doubtful).then_some([pressure]));
        if inspires && left <= self.end_of_phase {
            state.pressure.add(pressure);
            state.command.add(command);
        }
        if left != 1 {
            return None;
        }
        if !inspires {
            let falls = state.rest.fall().is_some_and(|[fall]| fall > FALLS);
            return self.expired(state, state.rest.last(), (peep, falls), cut || input.moved > DRAWN);
        }
        let (pressure, command) = (state.pressure.take(), state.command.take());
        if cut {
            return None;
        }
        self.inspired(state, &BreathInput { pressure, command, ..*input })
    }

    /// Whether the tube was open at the end of the inspiration and still is: its pressure is that of the room, and its gas does not
    /// come back.
    fn loses_all(&self, state: &mut BreathState, input: &BreathInput) -> bool {
        let was_open = core::mem::take(&mut state.open) >= self.open_for;
        let open = was_open && may_be_open(input.pressure, input.moment.settings().peep);
        // A valve that gives none of its gas leaves the tube without a pressure, too.
        let least = TELLING_GAS.max(PASSES * input.share * input.volume);
        let lost = |gas: f32| gas >= least && input.returned < COMES_BACK * gas + NOISE;
        // What refills a lung that a strain has emptied does not come back.
        open && input.inspired.is_some_and(|gas| lost(gas - input.refill))
    }

    /// Checks an expiration that an effort ends early at this PEEP, cmH2O, by its pressure before that.
    /// `emptied`: it lasted long enough to have a baseline.
    pub fn triggered(&self, state: &mut BreathState, peep: f32, emptied: bool, cut: bool) -> Option<Fault> {
        let before = state.high;
        let fault = self.expired(state, state.rest.before(), (peep, false), cut);
        if !emptied {
            state.high = state.high.min(before);
        }
        fault.filter(|fault| *fault != Fault::BaselineHigh || emptied || self.is_trapped(state))
    }

    /// Whether the pressure has stayed above PEEP for so many breaths that gas is trapped, however short the expirations are.
    fn is_trapped(&self, state: &BreathState) -> bool {
        state.above >= self.above
    }

    /// Checks an inspiration by the means over its end.
    fn inspired(&self, state: &mut BreathState, end: &BreathInput) -> Option<Fault> {
        let settings = end.moment.settings();
        let rise = end.pressure - settings.peep;
        // A lung that a lower PEEP has left takes gas before its pressure rises.
        let least = state.peeps(settings.peep).0 + REACHED * (settings.pip - settings.peep);
        let capped = end.cap == Cap::ByNoise && rise < CAPPED * (settings.pip - settings.peep);
        let weak = capped || (end.pressure < least && end.command > WIDE_OPEN);
        state.weak = in_a_row(state.weak, weak);
        let occluded = self.occluded(state, rise, end);
        if state.weak >= self.weak {
            return Some(Fault::LowPressure);
        }
        occluded.then_some(Fault::Occlusion)
    }

    /// Compares the ratio of volume to rise with that of the last good breaths; whether the tube is occluded. A patient's
    /// effort or cough changes the ratio too, but gas passes the tube.
    fn occluded(&self, state: &mut BreathState, rise: f32, end: &BreathInput) -> bool {
        let BreathInput { volume, reached, cut, .. } = *end;
        let settings = end.moment.settings();
        // An inspiration begins at the PEEP of the breath before.
        let began = if state.settling.is_new() { state.peep_before } else { settings.peep };
        let rise = rise - (began - settings.peep).max(0.0);
        if rise <= TELLING_RISE || end.refill > REFILLS * volume {
            return false;
        }
        let compliance = Compliance { value: volume / rise, time: exchange_time_of(settings) };
        let before = state.compliance(compliance.time);
        let occluded = before.is_some_and(|before| compliance.value < OCCLUDED * before);
        state.occluded = in_a_row(state.occluded, occluded);
        // A breath that a cough ends has little gas, all of which comes out.
        let given = end.share * volume;
        (state.delivered, state.normal) = (given, given * if cut { PASSES } else { OPEN });
        // The new compliance is believed in the end: a lung can change for good, and the alarm has long been raised.
        if !occluded || state.occluded >= NEW_LUNG {
            state.compliances = [Some(compliance), state.compliances[0]];
        }
        let passes = state.passed || reached.is_some_and(|reached| reached >= PASSES * given);
        state.occluded >= self.occluded && (!passes || state.occluded >= NARROWED_BREATHS)
    }

    /// Checks an expiration by a mean pressure at its end, against PEEP, and by whether that pressure still falls. `by_patient`: a low one is
    /// the patient's, as in an effort, or after a cough, which leaves less gas in the lung than at PEEP.
    fn expired(
        &self,
        state: &mut BreathState,
        pressure: Option<[f32; 1]>,
        (peep, falls): (f32, bool),
        by_patient: bool,
    ) -> Option<Fault> {
        if !state.settling.judges() {
            return None;
        }
        let [pressure] = pressure?;
        let above_peep = pressure - peep;
        let (lowest, highest) = state.peeps(peep);
        let is_high = above_peep > ABOVE_PEEP;
        let is_low = above_peep < -BELOW_PEEP && !by_patient;
        // While PEEP changes again and again, a pressure that is right by chance tells nothing: it would be wrong at the PEEP before.
        // And a lung still empties what larger breaths have left in it: that is trapped only if it stays.
        let empties = falls && !state.settling.has_rested();
        if is_high || pressure <= lowest + ABOVE_PEEP {
            state.high = if is_high && empties { state.high } else { in_a_row(state.high, is_high) };
            state.above = in_a_row(state.above, is_high);
        }
        let nearly_low = above_peep < -NEARLY_LOW && pressure < highest - BELOW_PEEP && !by_patient;
        if is_low || !nearly_low {
            state.low = in_a_row(state.low, is_low);
        }
        debug_assert!(state.high <= state.above, "efforts shorten no row but one");
        if state.high >= self.high || self.is_trapped(state) {
            return Some(Fault::BaselineHigh);
        }
        (state.low >= self.low).then_some(Fault::BaselineLow)
    }
}

/// [`exchange_time`] of a breath with these settings that the clock ends, s.
fn exchange_time_of(settings: &Settings) -> f32 {
    let filling = filling_time(settings.inspiratory_time, settings.rise_time);
    exchange_time(filling, 60.0 / settings.rate - settings.inspiratory_time)
}

#[cfg(test)]
mod tests;
