//! Chooses the pressure sensor that is believed: that at the airway, or that at the machine's outlet.
//!
//! Each sensor has a [`super::reading_monitor`] of its own; one that fails a check is not used until it has been sound for
//! some seconds. Each is the other's witness: a reading that stands still while the other sensor moves is frozen. Two sound
//! sensors that disagree are compared at the end of expirations, where the mechanical PEEP valve sets the pressure and hardly
//! any flow separates airway and outlet: the sensor that is closer to PEEP is used. Until then a large difference counts with
//! its higher pressure.
//!
//! A machine without the second sensor passes NaN for it and has only the first.

use super::alarms::Fault;
use super::expected::Expected;
use super::expiration::holds_peep;
use super::monitors::{Monitors, in_a_row, ticks};
use super::plateau::{DOUBTFUL, Judgement, Plateau, TUBE};
use super::reading_monitor::{Believed, ReadingMonitor, ReadingState};
use super::responses::Response;
use super::windows::Windows;
use crate::breath::{Moment, Phase, period_s};
use crate::math;
use crate::sensor::Readings;

/// Largest plausible difference between outlet and airway, cmH2O: at full flow the tube between them drops up to 5.
pub const FAR_APART: f32 = 10.0;
/// Flow of the valve while which that of two such sensors is wrong which follows the other by less, L/s.
const FILLS: f32 = 0.1;
/// By how much less it follows, cmH2O.
pub const FOLLOWS: f32 = 5.0;
/// Change over an inspiration, cmH2O, below which a sensor has stood still, if the other one has changed by more than [`FOLLOWS`] and what
/// the tube drops.
pub const STOOD: f32 = 1.0;
/// Time for which they may be further apart, s. Fulfils: sensors-disagree.
pub const APART: f32 = 0.02;
/// Expirations in a row with such a difference after which the worse sensor is not used.
pub const DOUBTFUL_BREATHS: u32 = 2;
/// Highest resistance of the expiratory valve, cmH2O/(L/s).
const EXPIRATORY: f32 = 7.0;
/// Distance from PEEP with which a sensor of two that are apart is wrong, cmH2O.
const OFF: f32 = 0.5 * DOUBTFUL;
/// Difference at the end of an expiration up to which they agree again, cmH2O.
pub const AGREE: f32 = 1.0;
/// Breaths in a row with so small a difference after which both are used again.
pub const AGREED_BREATHS: u32 = 3;
/// Change of the other sensor, beyond that of the drop in the tube, with which a sensor cannot stand still, cmH2O.
pub const MOVED: f32 = 2.0;
/// Time constant of the smoothed readings, s: noise alone must not look like a change.
const SMOOTHING: f32 = 0.01;
/// Time without a finding after which a sensor is used again, s. Fulfils: outlet-sensor-lost.
pub const SOUND_AGAIN: f32 = 5.0;

/// Checks both sensors and chooses one.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PressureSource {
    enabled: Monitors,
    monitor: ReadingMonitor,
    /// [`APART`] and [`SOUND_AGAIN`] in ticks.
    apart: u32,
    sound_again: u32,
    smoothing: f32,
    /// Expirations after which the worse sensor is not used.
    doubtful: u32,
}

/// The worst finding about a sensor since it was last sound for [`SOUND_AGAIN`].
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
enum Condition {
    /// None.
    #[default]
    Sound,
    /// It is too noisy.
    Noisy,
    /// It has failed another check.
    Lost,
}

/// State of one sensor.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct SensorState {
    reading: ReadingState,
    condition: Condition,
    /// Ticks without a finding.
    sound: u32,
    /// Whether it lost the comparison with the other sensor.
    doubted: bool,
    /// Smoothed reading, cmH2O.
    smooth: f32,
    /// When the reading last changed: smoothed reading of the other sensor, cmH2O, and flow of the valve, L/s.
    other_then: f32,
    flow_then: f32,
}

impl SensorState {
    /// Whether it has ever given a good reading.
    fn exists(&self) -> bool {
        self.reading.last_good().is_some()
    }

    /// Whether it is not used, whatever it reads.
    fn is_out_of_use(&self) -> bool {
        self.condition == Condition::Lost || self.doubted
    }

    fn is_sound(&self) -> bool {
        self.exists() && !self.is_out_of_use()
    }

    /// Remembers the other sensor and the flow when the reading changes.
    fn witness(&mut self, other: f32, flow: f32) {
        if self.reading.changed() {
            (self.other_then, self.flow_then) = (other, flow);
        }
    }

    /// A finding: it takes time without one until the sensor is sound again.
    fn fails(&mut self, condition: Condition) {
        (self.condition, self.sound) = (self.condition.max(condition), 0);
    }

    /// What this sensor reads, if it is the one in use.
    fn read(&self, believed: Believed) -> Reading {
        match believed.pressure {
            _ if self.is_out_of_use() => Reading::Lost,
            None => Reading::None,
            Some(pressure) if believed.fresh => Reading::Fresh(pressure),
            Some(pressure) => Reading::Bridged(pressure),
        }
    }
}

/// What the last inspiration has told of two sensors that disagree.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
enum Inspiration {
    /// Nothing.
    #[default]
    Silent,
    /// One has followed the gas by less, and is doubted until they are compared at rest.
    Undecided,
    /// One has stood still while the other one has breathed, so that rest tells nothing.
    Decided,
}

/// State of both sensors.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct SourceState {
    airway: SensorState,
    outlet: SensorState,
    apart: u32,
    /// Whether the last reading was a fresh one.
    was_fresh: bool,
    /// What the smoothed readings were at the start of the running inspiration, cmH2O; none after it.
    starts: Option<[f32; 2]>,
    inspiration: Inspiration,
    /// Whether the outlet sensor is used.
    uses_outlet: bool,
    /// Distances in the windows of the expiration: of airway and outlet from each other, and of each from PEEP. Distances, so that a
    /// hum does not look like its mean.
    rest: Windows<3>,
    doubtful: u32,
    agreed: u32,
    plateau: Plateau,
}

/// The pressure to control with, cmH2O.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum Reading {
    /// There has been no good reading yet.
    #[default]
    None,
    /// The reading of this tick.
    Fresh(f32),
    /// The last good reading in place of a missing one.
    Bridged(f32),
    /// No sensor is sound.
    Lost,
}

impl Reading {
    /// The pressure, cmH2O, if there is one.
    pub fn pressure(self) -> Option<f32> {
        match self {
            Self::Fresh(pressure) | Self::Bridged(pressure) => Some(pressure),
            Self::None | Self::Lost => None,
        }
    }
}

/// How a reading follows that of the last tick.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Follows {
    /// It or the last one is no fresh reading.
    #[default]
    Gap,
    /// Both are fresh readings of the same sensor.
    Same,
    /// Another sensor is used.
    Other,
}

/// The choice of one tick.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Chosen {
    /// What the sensor in use reads.
    pub reading: Reading,
    /// How the reading follows that of the last tick.
    pub follows: Follows,
    /// Whether two sound sensors differ by more than a small flow explains.
    pub doubtful: bool,
    /// What the sensor that is not used shows where the one in use is, unless one has failed a check, cmH2O: its reading, to which
    /// at the outlet the drop in the tube belongs.
    pub other: Option<f32>,
    /// Findings about the airway sensor, the outlet sensor and their difference.
    pub findings: [Option<Fault>; 3],
    /// Finding about the airway sensor to which the quiet outlet sensor in its place is the response.
    pub replaced: Option<Fault>,
}

impl PressureSource {
    /// A choice for a control period in microseconds; only the enabled monitors can take a sensor out of use.
    pub fn new(period_us: u32, enabled: Monitors) -> Self {
        let compared = |limit| enabled.limit(Fault::SensorsDisagree, limit);
        Self {
            enabled,
            monitor: ReadingMonitor::new(period_us, enabled),
            apart: compared(ticks(APART, period_us)),
            sound_again: ticks(SOUND_AGAIN, period_us),
            smoothing: math::lag_factor(SMOOTHING, period_s(period_us)),
            doubtful: compared(DOUBTFUL_BREATHS),
        }
    }

    /// Checks the readings of one tick, in which the commands predict this course of the pressure and this flow of the
    /// valve, L/s.
    #[inline]
    pub fn check(
        &self,
        state: &mut SourceState,
        readings: &Readings,
        expected: Expected,
        flow: f32,
    ) -> Chosen {
        let breathes = expected.breathes();
        let moves = [(&state.airway, &state.outlet), (&state.outlet, &state.airway)]
            .map(|(sensor, other)| self.must_change(sensor, other, expected, flow));
        let airway = self.judge(&mut state.airway, readings.airway, breathes, moves[0]);
        if !state.outlet.exists() && readings.outlet.is_nan() {
            let (findings, reading) = ([airway.fault, None, None], state.airway.read(airway));
            let follows = state.follows(reading, false);
            return Chosen { reading, follows, findings, ..Chosen::default() };
        }
        let outlet = self.judge(&mut state.outlet, readings.outlet, breathes, moves[1]);
        let smooth = [state.airway.smooth, state.outlet.smooth];
        state.airway.witness(smooth[1], flow);
        state.outlet.witness(smooth[0], flow);
        // A finding about a sensor that was never there is none.
        let outlet_fault = outlet.fault.filter(|_| state.outlet.exists()).map(|_| Fault::OutletSensorLost);
        let apart = (readings.airway - readings.outlet).abs();
        state.apart = in_a_row(state.apart, !state.is_one_lost() && apart > FAR_APART);
        let disagree = state.apart >= self.apart;
        let higher = readings.outlet > readings.airway;
        if disagree {
            state.agreed = 0;
            if flow > FILLS && state.are_both_sound() {
                state.doubt_what_stays();
            }
        }
        let both = state.are_both_sound();
        let quieter =
            state.airway.condition == Condition::Noisy && state.outlet.condition != Condition::Noisy;
        let use_outlet = match (state.airway.is_sound(), state.outlet.is_sound()) {
            (true, true) => (disagree && higher) || quieter,
            (_, sound) => sound,
        };
        let use_outlet = use_outlet && self.enabled.responses().has(Response::OtherSensor);
        debug_assert!(!use_outlet || state.outlet.is_sound(), "an unsound sensor takes no other's place");
        let (sensor, believed) = if use_outlet { (&state.outlet, outlet) } else { (&state.airway, airway) };
        let is_replaced = use_outlet && state.outlet.condition == Condition::Sound;
        let replaced = airway.fault.filter(|fault| is_replaced && *fault == Fault::ReadingNoisy);
        let airway_fault = airway.fault.filter(|_| replaced.is_none());
        let findings = [airway_fault, outlet_fault, disagree.then_some(Fault::SensorsDisagree)];
        let reading = sensor.read(believed);
        let follows = state.follows(reading, use_outlet);
        let doubtful = (both || state.inspiration == Inspiration::Undecided) && apart > DOUBTFUL;
        let other = if use_outlet { readings.airway + TUBE * flow.max(0.0) } else { readings.outlet };
        let other = (!state.is_one_lost()).then_some(other);
        Chosen { reading, follows, doubtful, other, findings, replaced }
    }

    /// Whether the reading of a sensor cannot stay the same: the other one has moved by more than the drop in the tube, or
    /// the commands predict a change and no other sensor denies it.
    fn must_change(&self, sensor: &SensorState, other: &SensorState, expected: Expected, flow: f32) -> bool {
        let tube = TUBE * (flow - sensor.flow_then).abs();
        let moved = other.is_sound() && (other.smooth - sensor.other_then).abs() > MOVED + tube;
        let denied = other.is_sound() && !self.monitor.stands(&other.reading);
        moved || (!denied && sensor.reading.last_good().is_some_and(|pressure| expected.moves(pressure)))
    }

    /// Checks a sensor's reading.
    fn judge(&self, state: &mut SensorState, reading: f32, breathes: bool, moves: bool) -> Believed {
        let existed = state.exists();
        let believed = self.monitor.check(&mut state.reading, reading, breathes, moves);
        if believed.fresh {
            let share = if existed { self.smoothing } else { 1.0 };
            state.smooth += share * (reading - state.smooth);
        }
        let fault = believed.fault.filter(|fault| self.enabled.has(*fault));
        match fault {
            Some(Fault::ReadingNoisy) => state.fails(Condition::Noisy),
            Some(_) => state.fails(Condition::Lost),
            None => state.sound = state.sound.saturating_add(1),
        }
        if state.sound >= self.sound_again {
            state.condition = Condition::Sound;
        }
        debug_assert!(fault.is_none() || state.condition != Condition::Sound);
        Believed { fault, ..believed }
    }

    /// Records the readings of a tick of a breath in which the valve gives this flow, L/s, for [`Self::compare`] and
    /// [`Self::at_plateau`]; `window` is the length of their means, ticks.
    #[inline]
    pub fn record(
        &self,
        state: &mut SourceState,
        moment: &Moment,
        window: u32,
        readings: &Readings,
        flow: f32,
    ) {
        let (airway, outlet, peep) = (readings.airway, readings.outlet, moment.settings().peep);
        let both = state.airway.exists() && state.outlet.exists() && airway.is_finite() && outlet.is_finite();
        if moment.tick == 0 {
            state.starts = both.then_some([state.airway.smooth, state.outlet.smooth]);
        }
        if moment.inspires() {
            state.plateau.add(moment, window, both.then_some([airway, outlet, flow]));
        }
        // While the pressure falls, much gas flows between the sensors.
        let near_end = moment.left() <= window;
        let resting = both && (near_end || moment.phase == Phase::Expiration);
        // Gas that flows out of the lung raises the pressure above PEEP.
        let above = if readings.flow < 0.0 { -EXPIRATORY * readings.flow } else { 0.0 };
        let from_peep = |pressure: f32| (pressure - peep - above).max(0.0).max(peep - pressure);
        let distances = || [(airway - outlet).abs(), from_peep(airway), from_peep(outlet)];
        state.rest.add(moment, window, resting.then(distances));
    }

    /// Compares the sensors at the end of an inspiration from this PEEP, cmH2O, that delivered this volume, mL; true if one of them is
    /// wrong.
    pub fn at_plateau(&self, state: &mut SourceState, peep: f32, volume: f32) -> bool {
        // What shows at rest is judged there, where PEEP is the witness.
        let compares =
            self.enabled.has(Fault::SensorsDisagree) && !state.is_one_lost() && state.doubtful == 0;
        let Some(judgement) = state.plateau.judge(peep, volume).filter(|_| compares) else { return false };
        match judgement {
            Judgement::Agree | Judgement::Apart => return false,
            Judgement::AirwayWrong => state.doubt(true, false),
            Judgement::OutletWrong => state.doubt(false, true),
        }
        true
    }

    /// The inspiration ends at this flow of the valve, L/s, or was cut: doubts a sensor that has stood still over a whole one while the
    /// other one has breathed, whatever they read at rest, where an effort shows as well. Returns whether there is one.
    pub fn inspired(&self, state: &mut SourceState, flow: f32, cut: bool) -> bool {
        // In the fall, the sensor that stays up is the one that does not follow.
        let starts = state.starts.take();
        let compares = !cut && !state.is_one_lost() && self.enabled.has(Fault::SensorsDisagree);
        let moved = starts.filter(|_| compares).map(|[airway, outlet]| {
            [(state.airway.smooth - airway).abs(), (state.outlet.smooth - outlet).abs()]
        });
        let far = FOLLOWS + TUBE * flow;
        let stood = |[airway, outlet]: &[f32; 2]| airway.min(*outlet) < STOOD && airway.max(*outlet) > far;
        if let Some([airway, outlet]) = moved.filter(stood) {
            state.doubt(airway < outlet, outlet < airway);
            state.inspiration = Inspiration::Decided;
        } else if state.inspiration == Inspiration::Decided {
            state.inspiration = Inspiration::Silent;
        }
        state.inspiration == Inspiration::Decided
    }

    /// Judges the sensors when the pressure does not respond to the gas of this flow, L/s: the one that responded less is
    /// not used. Returns whether there is another one.
    pub fn unresponsive(&self, state: &mut SourceState, readings: &Readings, flow: f32) -> bool {
        if !self.enabled.has(Fault::SensorsDisagree) || !state.airway.is_sound() || !state.outlet.is_sound() {
            return false;
        }
        let outlet_rose = readings.outlet - readings.airway;
        state.doubt(outlet_rose > DOUBTFUL + TUBE * flow, outlet_rose < -DOUBTFUL);
        state.airway.doubted || state.outlet.doubted
    }

    /// The gas denies what the sensor in use reads: it is not used, if the other one reads something else, even if
    /// that has lost a comparison. Returns whether it does.
    pub fn deny(&self, state: &mut SourceState, readings: &Readings) -> bool {
        let differ = (readings.airway - readings.outlet).abs() > DOUBTFUL;
        let denies = differ && !state.is_one_lost() && self.enabled.has(Fault::SensorsDisagree);
        if denies {
            state.doubt(!state.uses_outlet, state.uses_outlet);
        }
        denies
    }

    /// Compares the sensors at the end of an expiration at this flow of the valve, L/s; true if one of them is wrong. `triggered`: an
    /// effort ends it early.
    pub fn compare(&self, state: &mut SourceState, flow: f32, triggered: bool) -> bool {
        let means = if triggered { state.rest.before() } else { state.rest.last() };
        let Some([apart, airway, outlet]) = means.filter(|_| !state.is_one_lost()) else {
            return false;
        };
        // While the lung empties, neither may be off.
        let tells = airway.max(outlet) >= OFF;
        let apart_at_rest = apart > DOUBTFUL + TUBE * flow && tells;
        state.doubtful = in_a_row(state.doubtful, apart_at_rest);
        state.agreed = in_a_row(state.agreed, apart <= AGREE && state.plateau.agreed());
        if state.agreed >= AGREED_BREATHS {
            state.doubt(false, false);
        }
        let wrong = state.doubtful >= self.doubtful && state.inspiration != Inspiration::Decided;
        if wrong || state.agreed > 0 {
            state.inspiration = Inspiration::Silent;
        }
        if wrong {
            state.doubt(airway > outlet, airway <= outlet);
        }
        wrong
    }
}

impl SourceState {
    /// Takes note of the sensor that is used in this tick, and of whether it gives a fresh reading.
    fn follows(&mut self, reading: Reading, outlet: bool) -> Follows {
        let fresh = matches!(reading, Reading::Fresh(_));
        let was_fresh = core::mem::replace(&mut self.was_fresh, fresh);
        let used_outlet = core::mem::replace(&mut self.uses_outlet, outlet);
        if used_outlet != outlet {
            Follows::Other
        } else if fresh && was_fresh {
            Follows::Same
        } else {
            Follows::Gap
        }
    }

    /// Doubts these sensors from now on.
    fn doubt(&mut self, airway: bool, outlet: bool) {
        (self.airway.doubted, self.outlet.doubted) = (airway, outlet);
    }

    /// Whether the reading in use is noisy.
    pub fn is_noisy(&self) -> bool {
        let sensor = if self.uses_outlet { &self.outlet } else { &self.airway };
        sensor.condition == Condition::Noisy
    }

    /// While gas goes in: doubts the sensor that follows the other one by less since the start of the breath. At rest PEEP tells more.
    fn doubt_what_stays(&mut self) {
        let Some([airway, outlet]) = self.starts else { return };
        let more = (self.outlet.smooth - outlet) - (self.airway.smooth - airway);
        if more.abs() > FOLLOWS {
            self.doubt(more > 0.0, more < 0.0);
            self.inspiration = Inspiration::Undecided;
        }
    }

    /// Whether a sensor has failed a check, so that the two cannot be compared.
    fn is_one_lost(&self) -> bool {
        self.airway.condition == Condition::Lost || self.outlet.condition == Condition::Lost
    }

    /// Whether the higher of two readings shows that PEEP holds, cmH2O, at this flow of the valve, L/s, whatever the other one says.
    pub fn shows_peep(&self, readings: &Readings, flow: f32, peep: f32) -> bool {
        // On its way from the outlet to the airway, the flow loses some pressure in the tube.
        let higher = readings.airway.max(readings.outlet) - TUBE * flow;
        !self.is_one_lost() && holds_peep(higher, peep)
    }

    /// Whether both pressure sensors are sound.
    pub fn are_both_sound(&self) -> bool {
        self.airway.is_sound() && self.outlet.is_sound()
    }

    /// Whether a pressure sensor is sound.
    pub fn is_sound(&self) -> bool {
        self.airway.is_sound() || self.outlet.is_sound()
    }
}

#[cfg(test)]
mod tests;
