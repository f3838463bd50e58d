//! The four promises, and whether a case keeps them.
//!
//! A case runs three times at most: as it is, without its faults, and with those alone that limit what the machine can do. The volume
//! is judged window by window, each two breaths or 15 s long.

use serde::{Deserialize, Serialize};
use shared::safety::alarms::{Fault, Priority};
use shared::safety::monitors::Monitors;

use super::case::Case;
use super::run::{Observed, Window, all_known, run, sound, window_s};
use crate::endure::deserved::Verdict;
use ventilator::SourceError;

/// Longest time far above the limit, ms.
const ABOVE_MS: u32 = 300;
/// Share of the volume that the machine can still give.
const SHARE: f64 = 0.8;
/// Breaths in a window below which two in a row are judged.
const FEW_BREATHS: f64 = 5.0;
/// Volume of a window below which nothing is given, mL.
const LEAST_ML: f64 = 1.0;
/// Share of the volume before a fault of machine or patient below which breaths have become small, and windows after which an alarm
/// must say so: a minute.
const SMALL: f64 = 2.0 / 3.0;
const SMALL_WINDOWS: usize = 4;

/// A promise.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Promise {
    /// Where the valves obey, the pressure is never more than 15 cmH2O above its limit for longer than 300 ms.
    Pressure,
    /// The patient gets 80 % of what the machine can still give at the set rate, or a high-priority alarm names the cause within two breaths or 15 s;
    /// and a loss of a third to a fault of machine or patient is an alarm within a minute.
    Volume,
    /// Nothing is latched unless a valve, or the way out, does not obey.
    NoLatch,
    /// No high-priority alarm comes that neither the truth deserves nor a fault explains.
    NoFalseAlarm,
}

impl Promise {
    /// All promises.
    pub const ALL: [Self; 4] = [Self::Pressure, Self::Volume, Self::NoLatch, Self::NoFalseAlarm];

    /// Its name in tables.
    pub fn name(self) -> &'static str {
        match self {
            Self::Pressure => "pressure",
            Self::Volume => "volume or alarm",
            Self::NoLatch => "no needless latch",
            Self::NoFalseAlarm => "no false high alarm",
        }
    }
}

/// A promise that a case broke, and how.
#[derive(Clone, Debug, PartialEq)]
pub struct Broken {
    /// The promise.
    pub promise: Promise,
    /// What happened, in words.
    pub how: String,
    /// The alarm without a reason, or the fault that was latched.
    pub alarm: Option<Fault>,
}

/// A case and the runs by which it is judged, all of them with all monitors and responses.
#[derive(Debug)]
pub struct Reference<'a> {
    case: &'a Case,
    whole: Observed,
    sound: Observed,
    able: Observed,
}

impl<'a> Reference<'a> {
    /// Runs a case as it is, without its faults, and with those alone that limit what the machine can do.
    ///
    /// # Errors
    /// A case that cannot be run.
    pub fn of(case: &'a Case) -> Result<Self, SourceError> {
        let run = |case: &Case, onset_s| run(case, onset_s, Monitors::ALL);
        let (onset_s, sound_case, able_case) = (case.onset_s(), sound(case), all_known(case));
        let (whole, sound) = (run(case, onset_s)?, run(&sound_case, onset_s)?);
        let able = match able_case {
            able if able == sound_case => sound.clone(),
            able if able == *case => whole.clone(),
            able => run(&able, onset_s)?,
        };
        Ok(Self { case, whole, sound, able })
    }

    /// The case with all monitors and responses.
    pub fn whole(&self) -> &Observed {
        &self.whole
    }

    /// The promises that a run of the case breaks.
    pub fn broken(&self, seen: &Observed) -> Vec<Broken> {
        let case = self.case;
        let found = [
            (seen.above_ms > ABOVE_MS && !case.disobeys()).then(|| {
                let how = format!("{} ms above, peak {:.0} cmH2O", seen.above_ms, seen.peak);
                Broken { promise: Promise::Pressure, how, alarm: None }
            }),
            starved(case, seen, &self.able, &self.sound).map(|how| Broken {
                promise: Promise::Volume,
                how,
                alarm: None,
            }),
            latched(case, seen),
            false_alarm(case, seen),
        ];
        found.into_iter().flatten().collect()
    }
}

/// The promises that a case breaks with these monitors and responses.
///
/// # Errors
/// A case that cannot be run.
pub fn broken(case: &Case, monitors: Monitors) -> Result<Vec<Broken>, SourceError> {
    let reference = Reference::of(case)?;
    if monitors == Monitors::ALL {
        return Ok(reference.broken(&reference.whole));
    }
    Ok(reference.broken(&run(case, case.onset_s(), monitors)?))
}

fn latched(case: &Case, seen: &Observed) -> Option<Broken> {
    let (fault, time_s) = seen.latched.filter(|_| !case.disobeys())?;
    let how = format!("{} latched at {time_s:.1} s", fault.alarm().id);
    Some(Broken { promise: Promise::NoLatch, how, alarm: Some(fault) })
}

fn false_alarm(case: &Case, seen: &Observed) -> Option<Broken> {
    let undeserved = |(fault, time_s, verdict): &&(Fault, f64, Verdict)| {
        let explained = *time_s >= case.onset_s() && case.is_named_by(*fault);
        fault.alarm().priority == Priority::High && *verdict == Verdict::Undeserved && !explained
    };
    let (fault, time_s, _) = seen.alarms.iter().find(undeserved)?;
    let how = format!("{} at {time_s:.1} s", fault.alarm().id);
    Some(Broken { promise: Promise::NoFalseAlarm, how, alarm: Some(*fault) })
}

/// Whether the patient gets too little without an alarm that says why.
fn starved(case: &Case, seen: &Observed, able: &Observed, sound: &Observed) -> Option<String> {
    let named = |window: &Window, least: Priority| {
        let names = |fault: &Fault| fault.alarm().priority >= least && case.is_named_by(*fault);
        window.indicated.faults().any(|fault| names(&fault))
    };
    // The last window may be short, and there is none after it in which an alarm could come.
    let whole = seen.windows.len().min(able.windows.len()).min(sound.windows.len()).saturating_sub(2);
    // Breaths that a patient adds to the set rate are his own: a fault may hide an effort.
    let set = window_s(case) * f64::from(case.settings.rate) / 60.0;
    let promised = |window: &Window| window.volume_ml * (set / f64::from(window.breaths.max(1))).min(1.0);
    // Where nothing can be given, nothing is missing.
    let share = |of: &Observed, place: usize| match promised(&of.windows[place]) {
        little if little < LEAST_ML => 1.0,
        volume_ml => seen.windows[place].volume_ml / volume_ml,
    };
    // One breath more or less is much of a window with few of them.
    let others = usize::from(set < FEW_BREATHS);
    for place in 0..whole.saturating_sub(others) {
        let told = (place..=place + 1).any(|near| named(&seen.windows[near], Priority::High));
        let most = (place..=place + others).map(|place| share(able, place)).fold(0.0, f64::max);
        if most < SHARE && !told {
            return Some(format!("{:.0} % of what could be given, window {place}", 100.0 * most));
        }
    }
    for start in 0..(whole + 1).saturating_sub(SMALL_WINDOWS) {
        let minute = start..start + SMALL_WINDOWS;
        let small = minute.clone().all(|place| share(sound, place) < SMALL);
        if small && !minute.clone().any(|place| named(&seen.windows[place], Priority::Medium)) {
            let least = minute.map(|place| share(sound, place)).fold(f64::INFINITY, f64::min);
            return Some(format!("breaths of {:.0} % for a minute without an alarm", 100.0 * least));
        }
    }
    None
}
