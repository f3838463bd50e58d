//! Whether an alarm was deserved: one function per kind, from the true state of the running breath and the two before it.
//!
//! Each uses the bound that SAFETY.md's table of alarms names, with a tolerance: a sound machine
//! reads the pressure through a sensor with an offset, and its alarms must be judged by what they can know. Low-priority
//! alarms are only counted.
//!
//! Alarms about a breath's shape (low baseline, low pressure, occlusion, a share of the gas that is lost) are never deserved in the
//! first two breaths after a change of the settings; a high baseline is not in the first two after PEEP was lowered.

use shared::safety::alarms::{Fault, Priority};
use shared::settings::Settings;

use super::sensor_truth::SensorTruth;
use super::truth::{BreathTruth, History};

/// Accuracy of a sound sensor's reading, cmH2O: three standard deviations of the units' offsets.
pub const TOLERANCE: f64 = 1.0;
/// Bounds of the alarms, as their entries in the table state them, cmH2O.
const BASELINE_HIGH: f64 = 3.0;
const BASELINE_LOW: f64 = 2.0;
const SENSORS_APART: f64 = 2.0;
const NOISY: f64 = 0.4;
const JUMP: f64 = 15.0;
/// Missing readings that raise an alarm.
const MISSING: u32 = 5;
/// Time of a frozen reading that raises an alarm, ms.
const FROZEN_MS: u32 = 40;
/// Share of the rise from PEEP to PIP that an inspiration must reach, and the tolerance of its judgement.
const REACHED: (f64, f64) = (0.3, 0.1);
/// Share of the earlier volume per pressure below which the tube is occluded, and the tolerance.
const OCCLUDED: (f64, f64) = (1.0 / 3.0, 1.25);
/// Flow of a leak at PEEP from which it is one, L/s, and gas lost of the gas inspired: the alarm's bound is a quarter.
const LEAK_FLOW: f64 = 0.05;
const LEAK_SHARE: f64 = 0.15;
/// Leak of an open end, L/s at 30 cmH2O: more than the largest leak of a connected patient.
const OPEN: f64 = 1.0;
/// Effort at the end of an expiration that draws the pressure down by itself, cmH2O.
const EFFORT: f64 = 1.0;
/// Leak that can take PEEP away in spite of an effort, and that is one at any settings, L/s at 30 cmH2O.
const SMALL_LEAK: f64 = 0.1;
/// Time above the limit with an open expiratory valve, and away from PEEP, ms, after which the latched alarms are due.
const HARD_LIMIT_MS: u32 = 600;
const SUSTAINED_MS: u32 = 12_000;
/// Time without gas that shows a valve that does not obey, ms.
const STARVED_MS: u32 = 100;

/// Accuracy of a volume: three standard deviations of the flow sensors' gain.
pub const VOLUME_TOLERANCE: f64 = 0.1;
/// Time without a breath after which apnoea is due, s.
const APNOEA_S: f64 = 19.0;

/// Shares of the usual volume below which breaths are much smaller and a fraction, and the time after which the first is as
/// urgent, s.
const FALLS: f64 = 0.67;
const LOST: f64 = 0.5;
const PERSISTS_S: f64 = 50.0;

/// Judgement of an alarm.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Verdict {
    /// The condition was there.
    Deserved,
    /// It was not.
    Undeserved,
    /// A low-priority alarm, which is not judged.
    Counted,
}

/// Judges an alarm that begins now.
pub fn judge(fault: Fault, history: &History) -> Verdict {
    if fault.alarm().priority == Priority::Low {
        Verdict::Counted
    } else if deserved(fault, history) {
        Verdict::Deserved
    } else {
        Verdict::Undeserved
    }
}

fn deserved(fault: Fault, history: &History) -> bool {
    match fault {
        Fault::ReadingNotANumber => sensors(history, |sensor| sensor.missing >= MISSING),
        Fault::ReadingOutOfRange => sensors(history, |sensor| sensor.beyond),
        Fault::ReadingJumps => sensors(history, jumped),
        Fault::ReadingFrozen => sensors(history, frozen),
        Fault::ReadingNoisy => sensors(history, noisy),
        Fault::HighPressure | Fault::CommandCapped => any(history, high_pressure),
        Fault::HardLimit => any(history, |breath| breath.vented_above_ms >= HARD_LIMIT_MS),
        Fault::SustainedPressure => any(history, |breath| breath.away_ms >= SUSTAINED_MS),
        // What stays above PEEP is so from the first breath on, unless PEEP has just been lowered.
        Fault::BaselineHigh => history.window().filter(|b| !b.peep_is_lower && baseline_high(b)).count() >= 2,
        Fault::BaselineLow => twice(history, baseline_low),
        Fault::LowPressure => twice(history, low_pressure),
        Fault::Disconnection => any(history, disconnected),
        Fault::Occlusion => twice(history, |breath| occluded(breath, history.lung())),
        Fault::NoResponse => any(history, unresponsive),
        Fault::SensorsDisagree => any(history, sensors_disagree),
        Fault::BackupVentilation => {
            any(history, |breath| (unsound(&breath.airway) && unsound(&breath.outlet)) || unanswered(breath))
        }
        Fault::Leak => {
            // What the leak lets through at PEEP does not depend on the breath.
            let flows = |breath: &&BreathTruth| breath.leak * (breath.peep() / 30.0).sqrt() > LEAK_FLOW;
            twice(history, leak) || large_leaks(history) >= 2 || history.window().filter(flows).count() >= 2
        }
        // Each breath has the limits that were in force with it.
        Fault::TidalVolumeLow => twice_ended(history, |breath| {
            below(breath.flow.shown(breath.expired).0, breath.settings.tidal_volume_low)
        }),
        Fault::TidalVolumeHigh => twice_ended(history, |breath| {
            above(breath.flow.shown(breath.expired).1, breath.settings.tidal_volume_high)
        }),
        Fault::MinuteVolumeLow => any(history, |breath| {
            breath
                .minute_volume
                .is_some_and(|volume| below(breath.flow.shown(volume).0, breath.minute_limits.0))
        }),
        Fault::MinuteVolumeHigh => any(history, |breath| {
            breath
                .minute_volume
                .is_some_and(|volume| above(breath.flow.shown(volume).1, breath.minute_limits.1))
        }),
        Fault::Apnoea => any(history, |breath| breath.without_s >= APNOEA_S),
        Fault::VentilationFalls => twice_ended(history, |breath| smaller(breath, FALLS)),
        Fault::VentilationLost => twice_ended(history, |breath| {
            smaller(breath, LOST) || (smaller(breath, FALLS) && breath.small_s >= PERSISTS_S)
        }),
        // The bench neither misses ticks nor resets the device; the others have a low priority.
        Fault::MissedTicks
        | Fault::Restarted
        | Fault::LearnedDistrusted
        | Fault::HostSilent
        | Fault::WeightsRefused
        | Fault::OutletSensorLost
        | Fault::FlowSensorLost => false,
    }
}

/// Whether this holds in the running breath or the two before it.
fn any(history: &History, holds: impl Fn(&BreathTruth) -> bool) -> bool {
    history.window().any(holds)
}

/// Whether this holds in two of these breaths that have ended, whatever their settings.
fn twice_ended(history: &History, holds: impl Fn(&BreathTruth) -> bool) -> bool {
    history.window().filter(|breath| breath.ended && holds(breath)).count() >= 2
}

/// Whether this holds in two of these breaths, with settings that are not new: these alarms need several breaths.
fn twice(history: &History, holds: impl Fn(&BreathTruth) -> bool) -> bool {
    history.window().filter(|breath| breath.settled && holds(breath)).count() >= 2
}

/// The same, of either pressure sensor.
fn sensors(history: &History, holds: impl Fn(&SensorTruth) -> bool) -> bool {
    history.window().any(|breath| holds(&breath.airway) || holds(&breath.outlet))
}

fn jumped(sensor: &SensorTruth) -> bool {
    sensor.worst >= JUMP - TOLERANCE
}

fn frozen(sensor: &SensorTruth) -> bool {
    sensor.frozen_ms >= FROZEN_MS / 2
}

fn noisy(sensor: &SensorTruth) -> bool {
    sensor.noise() >= 0.8 * NOISY
}

/// Whether a reading is wrong in any way that takes the sensor out of use.
fn unsound(sensor: &SensorTruth) -> bool {
    sensor.missing >= MISSING
        || sensor.beyond
        || jumped(sensor)
        || frozen(sensor)
        || sensor.offset().abs() >= SENSORS_APART - TOLERANCE / 2.0
}

/// Pressure above the limit.
pub fn high_pressure(breath: &BreathTruth) -> bool {
    breath.peak > breath.limit() - TOLERANCE
}

/// Pressure above PEEP at the end of the expiration.
fn baseline_high(breath: &BreathTruth) -> bool {
    breath.baseline.is_some_and(|baseline| baseline > breath.peep() + BASELINE_HIGH - TOLERANCE)
}

/// Pressure below PEEP at the end of the expiration, and not by an effort at that moment alone.
fn baseline_low(breath: &BreathTruth) -> bool {
    let low = breath.baseline.is_some_and(|baseline| baseline < breath.peep() - BASELINE_LOW + TOLERANCE);
    low && (breath.effort_at_end < EFFORT || breath.leak > SMALL_LEAK)
}

/// An inspiration that does not reach its pressure.
fn low_pressure(breath: &BreathTruth) -> bool {
    let wanted = f64::from(breath.settings.pip) - breath.peep();
    let enough = breath.peep() + (REACHED.0 + REACHED.1) * wanted;
    breath.plateau.is_some_and(|plateau| plateau < enough)
}

/// An open end.
fn disconnected(breath: &BreathTruth) -> bool {
    breath.leak > OPEN
}

/// A lung that fills with a third of the gas that it takes with the patient's own resistance.
fn occluded(breath: &BreathTruth, (own, compliance): (f64, f64)) -> bool {
    let fills = |resistance: f64| fills(&breath.settings, resistance, compliance);
    breath.resistance.is_some_and(|now| fills(now) < OCCLUDED.0 * OCCLUDED.1 * fills(own))
}

/// Share of its volume to which a passive lung fills in an inspiration.
fn fills(settings: &Settings, resistance: f64, compliance: f64) -> f64 {
    1.0 - (-f64::from(settings.inspiratory_time) / (resistance * compliance * 1e-3)).exp()
}

/// A valve without gas, an open end, or a sensor in use that does not follow.
fn unresponsive(breath: &BreathTruth) -> bool {
    unanswered(breath) || [&breath.airway, &breath.outlet].into_iter().any(unsound)
}

/// Gas that raises no pressure: the valve gives none, or it escapes.
fn unanswered(breath: &BreathTruth) -> bool {
    breath.starved_ms >= STARVED_MS || disconnected(breath)
}

/// Errors of the sensors that differ by the bound.
fn sensors_disagree(breath: &BreathTruth) -> bool {
    (breath.airway.offset() - breath.outlet.offset()).abs() > SENSORS_APART - TOLERANCE / 2.0
        || breath.airway.worst.max(breath.outlet.worst) > JUMP
}

/// A leak that takes considerable flow at PEEP, or much of the gas; a flow sensor with a wrong zero shows such a loss too.
fn leak(breath: &BreathTruth) -> bool {
    breath.leak_at_end > LEAK_FLOW || breath.leak_share + breath.flow.lost_share() > LEAK_SHARE
}

/// Breaths with much of their gas through a leak that is no small one: new settings cannot feign that.
fn large_leaks(history: &History) -> usize {
    history.window().filter(|breath| breath.leak > SMALL_LEAK && leak(breath)).count()
}

/// Whether a breath has less than a share of what the patient had in the minutes before.
fn smaller(breath: &BreathTruth, share: f64) -> bool {
    breath
        .usual
        .is_some_and(|usual| breath.flow.shown(breath.given()).0 < share * (1.0 + VOLUME_TOLERANCE) * usual)
}

/// Whether a volume is below its limit.
fn below(volume: f64, limit: f32) -> bool {
    volume < f64::from(limit) * (1.0 + VOLUME_TOLERANCE)
}

/// Whether a volume is above its limit, if it has one.
fn above(volume: f64, limit: f32) -> bool {
    limit > 0.0 && volume > f64::from(limit) * (1.0 - VOLUME_TOLERANCE)
}

#[cfg(test)]
#[path = "deserved_tests.rs"]
mod tests;
