//! Checks the flow sensor: whether its reading moves with the breaths, and whether it agrees with the gas that the valve gives.
//!
//! Once per breath, over the volumes of its two phases. While the expiratory valve is closed, all gas of the inspiratory valve goes into
//! the circuit, the lung and the leak, whatever the patient does: the sensor must show it. The valve's model is not exact, so the share
//! that a sound sensor shows is learned, for breaths with about as much gas. The *swing*, the volume of the inspiration less the mean
//! flow of the whole breath, contains no offset: a reading that stands still has none, with noise or without.
//!
//! The gas tells something only while pressure control works: in a breath that reaches its pressure, with more gas than the circuit
//! takes. A sensor that is found wrong is not used until it is sound again. Without a pressure reading a sound sensor tells whether the
//! gas gets to the patient.

use super::alarms::Fault;
use super::monitors::{Monitors, in_a_row, ticks};
use crate::breath::period_s;
use core::cmp::Ordering;

/// Lowest and highest share of the usual volume per gas of the valve that a sound sensor shows. Fulfils: flow-sensor-lost.
pub const GAIN: (f32, f32) = (0.5, 2.0);
/// The same share of the valve's model before there is a usual one: the valve of a newborn's machine gives a fifth of what the model
/// says, and a low compliance leaves half of that in the circuit.
const ANY_GAIN: (f32, f32) = (0.05, 3.0);
/// Offset by which the inspired volume may differ from the usual one, L/s.
pub const OFFSET: f32 = 0.1;
/// Share of the usual volume by which it may differ beyond that.
pub const INEXACT: f32 = 0.2;
/// Share of the usual volume and swing by which those of a breath may differ that is learned from.
const TYPICAL: f32 = 0.3;
/// Flow that a breath may gain or lose without a leak, L/s: more is an offset.
pub const NET: f32 = 0.08;
/// Volume that a breath may gain or lose beyond that, mL.
const NET_VOLUME: f32 = 30.0;
/// Share of the usual volume below which the swing is that of a reading that stands still, and of the model's before there is a usual
/// one. A leak at a PEEP near PIP leaves more.
const STILL: f32 = 0.03;
const STILL_OF_MODEL: f32 = 0.02;
/// Volume that the circuit takes per pressure, at most, mL/cmH2O.
const CIRCUIT: f32 = 2.0;
/// Smallest volume beyond that of the circuit that tells something, mL.
pub const TELLING: f32 = 60.0;
/// Factor on the valve's gas within which breaths are compared: its curve differs from the model's.
const SIMILAR: f32 = 1.5;
/// Inspirations in a row after which a sensor hides gas that shows more than the valve's model: a valve that is stuck open gives
/// more, too. One that shows far less hides it at once.
const HIDES: u32 = 2;
/// Breaths in a row with another gas and another share of it that become the usual ones.
const UNLIKE: u32 = 5;
/// Share of the usual volume below which the same gas of the valve shows a change of the sensor, not of the breath.
const CLEARLY_LESS: f32 = 0.8;
/// Time for which a sensor with noise cannot repeat a reading, s.
pub const STANDS: f32 = 0.1;
/// Share of the readings that repeat the one before, up to which a sensor has noise.
const REPEATS: f32 = 0.05;
/// Weight of a new breath in the usual one.
const NEW_BREATH: f32 = 0.3;
/// Breaths in a row that contradict the gas after which the sensor is not used: a patient's efforts make the gas differ from the usual.
pub const BELIED: u32 = 4;
/// The same while the reading hardly swings, which no effort does.
pub const BELIED_STILL: u32 = 2;
const _: () = assert!(BELIED.is_multiple_of(BELIED_STILL), "a breath that hardly swings counts as several");
/// The same with more gas out than in: a stiffer lung or a lower PEEP lets gas out for a few.
pub const ONLY_OUT: u32 = 5;
/// Time for which a sensor must be sound before it is used again, s.
pub const SOUND: f32 = 5.0;
/// Without a pressure reading: share of the usual volume below which the gas does not get to the patient.
pub const GETS_THROUGH: f32 = 0.25;
/// The smallest usual volume from which this shows, mL.
const TELLING_BLIND: f32 = 30.0;
/// Breaths in a row whose gas does not get to the patient that raise the alarm. Fulfils: occlusion.
pub const BLOCKED_BREATHS: u32 = 2;

/// Places of the phases in a breath's sums: the open and the closed expiratory valve.
const REST: usize = 0;
const INSPIRATION: usize = 1;

/// Sums over a breath's ticks with a flow reading.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Sums {
    /// Flow by the sensor and by the valve's model in each phase, L/s.
    sensor: [f32; 2],
    valve: [f32; 2],
    ticks: [u32; 2],
    /// Ticks with an open expiratory valve, also those without a reading.
    rest: u32,
    /// The last reading, and how many were the same as the one before.
    latest: u32,
    repeats: u32,
    /// Rise of the pressure at the end of the inspiration if it was a good one, cmH2O.
    rise: Option<f32>,
}

/// Usual volumes per gas of the valve, and that gas, mL.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Usual {
    /// Of the inspired volume.
    share: f32,
    /// Of the swing.
    swing: f32,
    valve: f32,
}

/// What a breath says of the sensor.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Verdict {
    /// It stands still, to the last bit.
    Frozen,
    /// Its volumes are not those of the gas.
    Belied,
    /// More gas goes out than in, or more in than the valve gives.
    Unbalanced,
    /// Nothing.
    Silent,
    /// It shows the gas.
    Sound,
    /// It shows that the gas does not get to the patient.
    Blocked,
}

/// Why the sensor is not used.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Loss {
    /// By its own readings: any breath that does not repeat it is sound.
    Reading,
    /// By its gas: only a breath that shows gas is sound.
    Gas,
}

/// Configuration.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FlowMonitor {
    period: f32,
    /// [`STANDS`] in ticks.
    standing: u32,
    /// Whether the monitor of the flow sensor is enabled.
    enabled: bool,
}

/// State; all zero before the first breath.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct FlowState {
    running: Sums,
    last: Sums,
    /// Mean flow of the last breath, L/s.
    mean: f32,
    /// Ticks in a row with the same reading.
    standing: u32,
    /// Inspirations in a row in which the sensor did not show the gas of the valve's model.
    hides: u32,
    usual: Option<Usual>,
    /// Whether noise has changed nearly every reading of a breath.
    noisy: bool,
    /// Whether the last breath showed clearly less than the usual share of about as much gas.
    shows_less: bool,
    /// Breaths in a row that are unlike the usual one, in gas and share.
    unlike: u32,
    /// Breaths in a row that contradict the gas, in which more goes out than in, and whose gas does not get to the patient.
    belied: u32,
    only_out: u32,
    blocked: u32,
    lost: Option<Loss>,
    /// Time for which no breath has contradicted the sensor, s.
    sound: f32,
}

/// Volumes of a breath, mL, and its times, s.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Gas {
    inspired: f32,
    /// In the whole breath.
    net: f32,
    swing: f32,
    /// Gas of the valve, in the inspiration and in the whole breath.
    valve: f32,
    given: f32,
    seconds: f32,
    inspiration: f32,
}

impl Sums {
    #[inline]
    fn add(&mut self, flow: f32, valve: f32, phase: usize) {
        let bits = flow.to_bits();
        self.repeats += u32::from(bits == self.latest);
        self.latest = bits;
        self.sensor[phase] += flow;
        self.valve[phase] += valve;
        self.ticks[phase] += 1;
    }

    /// Mean flow, L/s; 0 without a reading.
    fn mean(&self) -> f32 {
        (self.sensor[REST] + self.sensor[INSPIRATION])
            / (self.ticks[REST] + self.ticks[INSPIRATION]).max(1) as f32
    }

    /// Volume of the inspiration beyond that of a constant flow, L/s, in ticks of `period` seconds; mL.
    fn beyond(&self, flow: f32, period: f32) -> f32 {
        1000.0 * period * (self.sensor[INSPIRATION] - flow * self.ticks[INSPIRATION] as f32)
    }

    fn gas(&self, period: f32) -> Gas {
        let volume = |flow: f32| 1000.0 * period * flow;
        let [rest, inspiration] = self.ticks.map(|ticks| ticks as f32 * period);
        let inspired = volume(self.sensor[INSPIRATION]);
        let valve = volume(self.valve[INSPIRATION]);
        Gas {
            inspired,
            net: inspired + volume(self.sensor[REST]),
            swing: self.beyond(self.mean(), period),
            valve,
            given: valve + volume(self.valve[REST]),
            seconds: rest + inspiration,
            inspiration,
        }
    }

    /// Whether all readings were the same. A quiet sensor may show no flow where there is none.
    fn is_frozen(&self, quiet: bool) -> bool {
        let [rest, inspiration] = self.ticks;
        let all = rest > 0 && inspiration > 0 && self.repeats + 1 >= rest + inspiration;
        all && !(quiet && f32::from_bits(self.latest) == 0.0)
    }

    /// Whether so few readings repeat the one before that it is noise that changes them.
    fn is_noisy(&self) -> bool {
        self.repeats as f32 <= REPEATS * (self.ticks[REST] + self.ticks[INSPIRATION]) as f32
    }
}

impl Usual {
    fn of(gas: &Gas) -> Self {
        Self { share: gas.inspired / gas.valve, swing: gas.swing / gas.valve, valve: gas.valve }
    }

    /// Whether a breath has about as much gas.
    fn is_like(&self, gas: &Gas) -> bool {
        gas.valve <= SIMILAR * self.valve && SIMILAR * gas.valve >= self.valve
    }

    /// Whether a breath shows about the usual shares of its gas.
    fn is_typical(&self, gas: &Gas) -> bool {
        let near = |shown: f32, usual: f32| (shown - usual * gas.valve).abs() <= TYPICAL * usual * gas.valve;
        near(gas.inspired, self.share) && near(gas.swing, self.swing)
    }

    /// Whether a breath with about as much gas shows clearly less of it than usual.
    fn exceeds(&self, gas: &Gas) -> bool {
        gas.inspired < CLEARLY_LESS * self.share * gas.valve
    }

    /// Whether a breath with about as much gas shows it as usual.
    fn agrees(&self, gas: &Gas) -> bool {
        let (inspired, swing) = (self.share * gas.valve, self.swing * gas.valve);
        let weak = gas.inspired < GAIN.0 * inspired && gas.swing < GAIN.0 * swing;
        let strong = gas.inspired > GAIN.1 * inspired && gas.swing > GAIN.1 * swing;
        let shift = 1000.0 * OFFSET * gas.inspiration + INEXACT * inspired;
        let near = (gas.inspired - inspired).abs() <= shift;
        !weak && !strong && near && gas.swing >= STILL * inspired
    }

    fn add(&mut self, gas: &Gas) {
        let new = Self::of(gas);
        let toward = |mean: &mut f32, value: f32| *mean += NEW_BREATH * (value - *mean);
        toward(&mut self.share, new.share);
        toward(&mut self.swing, new.swing);
        toward(&mut self.valve, new.valve);
    }
}

impl FlowMonitor {
    /// A monitor for a control period in microseconds; without the alarm about the sensor it is always used.
    pub fn new(period_us: u32, enabled: Monitors) -> Self {
        Self {
            period: period_s(period_us),
            standing: ticks(STANDS, period_us),
            enabled: enabled.has(Fault::FlowSensorLost),
        }
    }

    /// Adds the flow of a tick by the sensor and by the valve's model, L/s; NaN without a reading. `inspires`: the expiratory valve is
    /// closed. A sensor with noise that repeats itself is lost at once; the alarm comes with the next judgement.
    #[inline]
    pub fn add(&self, state: &mut FlowState, sensor: f32, valve: f32, inspires: bool) {
        state.running.rest += u32::from(!inspires);
        if sensor.is_nan() {
            return;
        }
        let repeats = state.running.repeats;
        state.running.add(sensor, valve, usize::from(inspires));
        state.standing = in_a_row(state.standing, state.running.repeats > repeats);
        let stands = state.noisy && state.standing >= self.standing;
        if self.enabled && stands && state.lost.is_none() {
            (state.lost, state.sound) = (Some(Loss::Reading), 0.0);
        }
    }

    /// Judges the last breath, once; `blind`: without a pressure reading. Returns what it has found.
    pub fn judge(&self, state: &mut FlowState, blind: bool) -> Option<Fault> {
        let gas = state.last.gas(self.period);
        if state.last.ticks[INSPIRATION] == 0 || !self.enabled {
            return None;
        }
        let verdict = state.verdict(&gas, blind);
        let unlike = state.last.rise.is_some() && state.usual.is_some_and(|usual| !usual.is_like(&gas));
        state.unlike = in_a_row(state.unlike, unlike && verdict == Verdict::Silent && !state.is_lost());
        state.only_out = in_a_row(state.only_out, gas.net < -allowed_net(&gas));
        state.belied = match verdict {
            Verdict::Belied | Verdict::Unbalanced => {
                let still = gas.swing.abs() < STILL_OF_MODEL * gas.valve;
                state.belied + if still { BELIED / BELIED_STILL } else { 1 }
            }
            Verdict::Sound | Verdict::Blocked => 0,
            Verdict::Frozen | Verdict::Silent => state.belied,
        };
        state.blocked = in_a_row(state.blocked, verdict == Verdict::Blocked);
        state.noisy |= state.last.is_noisy() && !state.is_lost();
        state.shows_less = state.usual.is_some_and(|usual| usual.is_like(&gas) && usual.exceeds(&gas));
        state.lose(verdict);
        state.find(verdict, &gas);
        if state.is_lost() {
            return Some(Fault::FlowSensorLost);
        }
        (state.blocked >= BLOCKED_BREATHS).then_some(Fault::Occlusion)
    }

    /// Swing of the last breath, mL.
    pub fn swing(&self, state: &FlowState) -> f32 {
        state.last.beyond(state.mean, self.period)
    }

    /// Length of the last expiration, s.
    pub fn expiration(&self, state: &FlowState) -> f32 {
        state.last.rest as f32 * self.period
    }
}

/// Volume that a breath may gain or lose without a leak, mL.
fn allowed_net(gas: &Gas) -> f32 {
    1000.0 * NET * gas.seconds + NET_VOLUME
}

impl FlowState {
    /// Starts a breath.
    pub fn start_breath(&mut self) {
        self.last = core::mem::take(&mut self.running);
        self.running.latest = self.last.latest;
        self.mean = self.last.mean();
    }

    /// Ends an inspiration in which the sensor has shown the gas of the valve's model, or far less or more.
    pub fn inspired(&mut self, shown: Ordering) {
        self.hides = match shown {
            Ordering::Less => HIDES,
            _ => in_a_row(self.hides, shown == Ordering::Greater),
        };
    }

    /// Whether the sensor, by the last inspirations alone, does not show the gas that the valve gives. Before a fault is latched, this
    /// short memory counts: one breath may decide.
    pub fn hides_gas(&self) -> bool {
        self.hides >= HIDES
    }

    /// Takes note of the rise at the end of a good inspiration, cmH2O.
    pub fn rose(&mut self, rise: f32) {
        self.running.rise = Some(rise);
    }

    /// Share of the gas by the valve's model that a sound sensor usually shows, at most 1; 1 before it is known.
    pub fn usual_share(&self) -> f32 {
        self.usual.map_or(1.0, |usual| usual.share.min(1.0))
    }

    /// Whether the last breath's volumes can be compared with those before.
    pub fn is_comparable(&self) -> bool {
        !self.is_doubtful() && !self.shows_less
    }

    /// Whether the sensor is out of use.
    pub fn is_lost(&self) -> bool {
        self.lost.is_some()
    }

    /// Whether the last breath contradicts the sensor, or it is out of use.
    pub fn is_doubtful(&self) -> bool {
        self.belied > 0 || self.is_lost()
    }

    /// Volume that has reached the patient in the running inspiration, mL, if the mean flow of the last breath was an offset or a leak.
    pub fn reached(&self, period: f32) -> f32 {
        self.running.beyond(self.mean, period)
    }

    /// What the last breath says.
    fn verdict(&self, gas: &Gas, blind: bool) -> Verdict {
        let share = self.usual.map_or(1.0, |usual| usual.share.max(1.0));
        if self.last.is_frozen(!self.noisy) {
            Verdict::Frozen
        } else if gas.net > GAIN.1 * share * gas.given + allowed_net(gas) {
            Verdict::Unbalanced
        } else if blind {
            self.blind_verdict(gas)
        } else if self.last.rise.is_some_and(|rise| gas.valve - CIRCUIT * rise >= TELLING) {
            self.controlled_verdict(gas)
        } else {
            Verdict::Silent
        }
    }

    /// What a breath with pressure control says.
    fn controlled_verdict(&self, gas: &Gas) -> Verdict {
        let shown = Usual::of(gas);
        let possible =
            shown.share >= ANY_GAIN.0 && shown.share <= ANY_GAIN.1 && shown.swing >= STILL_OF_MODEL;
        match self.usual {
            Some(usual) if usual.is_like(gas) => {
                if usual.agrees(gas) {
                    Verdict::Sound
                } else {
                    Verdict::Belied
                }
            }
            _ if !possible => Verdict::Belied,
            None if self.is_lost() => Verdict::Silent,
            None => Verdict::Sound,
            // The valve's curve differs from the model's, but a fault of the sensor can make the gas differ too, as it starts a breath.
            Some(usual) if self.unlike >= UNLIKE || usual.is_typical(gas) => Verdict::Sound,
            Some(_) => Verdict::Silent,
        }
    }

    /// What a breath without a pressure reading says.
    fn blind_verdict(&self, gas: &Gas) -> Verdict {
        let usual = self.usual.map_or(0.0, |usual| usual.share * gas.valve);
        if usual < TELLING_BLIND {
            Verdict::Silent
        } else if gas.inspired < GETS_THROUGH * usual {
            Verdict::Blocked
        } else if gas.swing < STILL * usual {
            Verdict::Belied
        } else {
            Verdict::Sound
        }
    }

    /// Takes the sensor out of use if it is wrong.
    fn lose(&mut self, verdict: Verdict) {
        let loss = match verdict {
            Verdict::Frozen => Loss::Reading,
            Verdict::Unbalanced if self.belied >= BELIED => Loss::Reading,
            Verdict::Belied if self.belied >= BELIED => Loss::Gas,
            _ if self.only_out >= ONLY_OUT => Loss::Reading,
            _ => return,
        };
        if self.lost.is_none() {
            self.sound = 0.0;
        }
        if self.lost != Some(Loss::Gas) {
            self.lost = Some(loss);
        }
    }

    /// Takes a sound sensor into use again, and learns from it. A single contradiction, as by a leak that begins, is forgotten after as
    /// long: the breaths of a newborn may never tell anything again.
    fn find(&mut self, verdict: Verdict, gas: &Gas) {
        let sound = match (self.lost, verdict) {
            (_, Verdict::Sound) => true,
            (None | Some(Loss::Reading), Verdict::Silent) => self.only_out == 0,
            _ => false,
        };
        let wrong = matches!(verdict, Verdict::Frozen | Verdict::Belied | Verdict::Unbalanced);
        if sound {
            self.sound += gas.seconds;
        } else if wrong || self.only_out > 0 {
            self.sound = 0.0;
        }
        if self.sound >= SOUND {
            self.belied = 0;
            if self.is_lost() {
                (self.lost, self.only_out) = (None, 0);
            }
        }
        if !self.is_lost() {
            self.learn(verdict, gas);
        }
    }

    /// Learns the usual volumes from a sound breath.
    fn learn(&mut self, verdict: Verdict, gas: &Gas) {
        if verdict != Verdict::Sound || self.last.rise.is_none() {
            return;
        }
        self.unlike = 0;
        match &mut self.usual {
            // One that an effort ends, or a sensor's fault, tells little.
            Some(usual) if usual.is_like(gas) && !usual.is_typical(gas) => {}
            Some(usual) if usual.is_like(gas) => usual.add(gas),
            usual => *usual = Some(Usual::of(gas)),
        }
    }
}

#[cfg(test)]
mod tests;
