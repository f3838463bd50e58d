//! All alarms: name, priority, the ventilator's action, entry and exit conditions, text.
//!
//! [`ALARMS`] is the single source: the chip acts on it, the trainer prints it, and SAFETY.md's table is generated from it.

use serde::{Deserialize, Serialize};

/// A finding of a monitor. The order of the variants is part of the link's protocol: append only.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub enum Fault {
    /// The pressure reading is not a number.
    ReadingNotANumber,
    /// The pressure reading is outside the sensor's range.
    ReadingOutOfRange,
    /// The airway pressure exceeded its limit in breath after breath, in the end with a capped command.
    HighPressure,
    /// Readings change faster than a pressure can.
    ReadingJumps,
    /// The reading does not change at all, not even by noise.
    ReadingFrozen,
    /// The reading is far noisier than that of a working sensor.
    ReadingNoisy,
    /// The airway pressure was far above its limit, or stayed above it while venting.
    HardLimit,
    /// The airway pressure has not returned to PEEP for a long time.
    SustainedPressure,
    /// The airway pressure is above PEEP at the end of expirations.
    BaselineHigh,
    /// The airway pressure is below PEEP at the end of expirations.
    BaselineLow,
    /// Inspirations do not reach their pressure although the valve is wide open.
    LowPressure,
    /// The airway pressure is lost during an inspiration.
    Disconnection,
    /// The same pressure delivers only a fraction of the earlier volume.
    Occlusion,
    /// The pressure does not respond to the delivered gas.
    NoResponse,
    /// Control ticks were missed.
    MissedTicks,
    /// Breaths of the chosen controller ended at the pressure limit: the PID controls alone.
    LearnedDistrusted,
    /// A breath of the PID also ended at the pressure limit: its command is capped.
    CommandCapped,
    /// The host sends no requests any more.
    HostSilent,
    /// Stored weights are incomplete, damaged or refused.
    WeightsRefused,
    /// The device has restarted without a request.
    Restarted,
}

/// Priority of an alarm (IEC 60601-1-8).
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub enum Priority {
    /// Awareness is required.
    Low,
    /// A prompt response is required.
    Medium,
    /// An immediate response is required.
    High,
}

/// The ventilator's response to an alarm.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Action {
    /// The alarm is reported; its entry text names any further action.
    Tell,
    /// The PID alone controls.
    Pid,
    /// The PID controls with a capped command.
    CappedPid,
    /// Inspiratory valve closed, expiratory valve open until an operator acknowledges.
    Vent,
}

/// A row of the table of alarms.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Alarm {
    /// The finding that raises it.
    pub fault: Fault,
    /// Stable name, for scripts.
    pub id: &'static str,
    /// Priority.
    pub priority: Priority,
    /// Response of the ventilator.
    pub action: Action,
    /// Condition that raises it.
    pub entry: &'static str,
    /// Event that ends it.
    pub exit: &'static str,
    /// Text for the operator.
    pub text: &'static str,
}

/// What ends a latched alarm.
const ACKNOWLEDGED: &str = "an operator acknowledges, or the device restarts";
/// What ends a step down the ladder.
const CLEAN_BREATHS: &str = "one step up after 5 clean breaths, up to 3 times; or a new start of ventilation";

const fn vent(
    fault: Fault,
    id: &'static str,
    priority: Priority,
    entry: &'static str,
    text: &'static str,
) -> Alarm {
    Alarm { fault, id, priority, action: Action::Vent, entry, exit: ACKNOWLEDGED, text }
}

/// All alarms, in the order of [`Fault`].
pub const ALARMS: [Alarm; 20] = [
    vent(
        Fault::ReadingNotANumber,
        "reading-nan",
        Priority::High,
        "no number for 5 ms, or more than a tenth of the readings missing",
        "pressure reading is not a number",
    ),
    vent(
        Fault::ReadingOutOfRange,
        "reading-range",
        Priority::High,
        "as `reading-nan`, with most missing readings outside -30 to 110 cmH2O",
        "pressure reading out of range",
    ),
    vent(
        Fault::HighPressure,
        "high-pressure",
        Priority::High,
        "a breath ends at the pressure limit under the capped PID",
        "pressure above its limit",
    ),
    vent(
        Fault::ReadingJumps,
        "reading-jumps",
        Priority::High,
        "as `reading-nan`, with most missing readings more than 15 cmH2O per ms from the last good one",
        "pressure reading jumps",
    ),
    vent(
        Fault::ReadingFrozen,
        "reading-frozen",
        Priority::High,
        "the same reading, to the last bit, for 40 ms of a breath",
        "pressure reading is frozen",
    ),
    Alarm {
        fault: Fault::ReadingNoisy,
        id: "reading-noisy",
        priority: Priority::Medium,
        action: Action::CappedPid,
        entry: "noise of more than 0.4 cmH2O (standard deviation), averaged over about 50 ms",
        exit: CLEAN_BREATHS,
        text: "pressure reading is noisy",
    },
    vent(
        Fault::HardLimit,
        "hard-limit",
        Priority::High,
        "3 ms at more than 15 cmH2O above the limit, or 150 ms above the limit and the expiratory valve commanded open",
        "pressure far above its limit",
    ),
    vent(
        Fault::SustainedPressure,
        "sustained-pressure",
        Priority::High,
        "more than 3 cmH2O above PEEP for 15 s",
        "pressure does not come down",
    ),
    vent(
        Fault::BaselineHigh,
        "baseline-high",
        Priority::High,
        "more than 3 cmH2O above PEEP at the end of 2 expirations in a row",
        "pressure does not return to PEEP",
    ),
    vent(
        Fault::BaselineLow,
        "baseline-low",
        Priority::Medium,
        "more than 2 cmH2O below PEEP at the end of 3 breaths in a row, none of them cut at the limit",
        "pressure below PEEP: check for leaks",
    ),
    vent(
        Fault::LowPressure,
        "low-pressure",
        Priority::High,
        "less than 30 % of the rise from PEEP to PIP, with a command above 60 %, at the end of 2 inspirations in a row",
        "inspiration does not reach its pressure",
    ),
    vent(
        Fault::Disconnection,
        "disconnection",
        Priority::High,
        "150 ms of an inspiration at more than 2 cmH2O below PEEP, with a command above 30 %",
        "patient disconnected",
    ),
    vent(
        Fault::Occlusion,
        "occlusion",
        Priority::High,
        "less than a third of the last good breath's volume per pressure rise in 2 breaths in a row",
        "tube occluded",
    ),
    vent(
        Fault::NoResponse,
        "no-response",
        Priority::High,
        "40 ms with less than 12 % of a predicted rise above 10 cmH2O, or 20 ms with no change over 64 ms that should bring one",
        "pressure does not respond to the valve",
    ),
    vent(
        Fault::MissedTicks,
        "missed-ticks",
        Priority::High,
        "5 control ticks missed within a breath (the PID controls from the first one on)",
        "control ticks missed",
    ),
    Alarm {
        fault: Fault::LearnedDistrusted,
        id: "learned-distrusted",
        priority: Priority::Low,
        action: Action::Pid,
        entry: "2 breaths in a row end at the pressure limit under the selected controller",
        exit: CLEAN_BREATHS,
        text: "pressure limit reached twice: PID only",
    },
    Alarm {
        fault: Fault::CommandCapped,
        id: "command-capped",
        priority: Priority::Medium,
        action: Action::CappedPid,
        entry: "a breath ends at the pressure limit under the PID",
        exit: CLEAN_BREATHS,
        text: "valve command capped",
    },
    Alarm {
        fault: Fault::HostSilent,
        id: "host-silent",
        priority: Priority::Low,
        action: Action::Tell,
        entry: "10 s without a request while ventilating; ventilation continues, exploration ends",
        exit: "the next request from a host",
        text: "host is silent",
    },
    Alarm {
        fault: Fault::WeightsRefused,
        id: "weights-refused",
        priority: Priority::Low,
        action: Action::Tell,
        entry: "at start-up a slot holds torn or damaged weights; the other slot's weights or the PID run",
        exit: "valid weights are stored in that slot",
        text: "stored weights rejected",
    },
    Alarm {
        fault: Fault::Restarted,
        id: "restarted",
        priority: Priority::High,
        action: Action::Tell,
        entry: "a reset by the watchdog, by a supply dip or during ventilation; the device is then in standby",
        exit: "an operator starts ventilation",
        text: "device restarted by itself",
    },
];

impl Fault {
    /// All faults, in the order of the variants.
    pub fn all() -> impl Iterator<Item = Self> {
        ALARMS.iter().map(|alarm| alarm.fault)
    }

    /// The fault's row of [`ALARMS`].
    pub fn alarm(self) -> &'static Alarm {
        &ALARMS[self as usize % ALARMS.len()]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_fault_finds_its_own_row() {
        for (place, alarm) in ALARMS.iter().enumerate() {
            assert_eq!(alarm.fault as usize, place);
            assert_eq!(alarm.fault.alarm(), alarm);
        }
    }

    #[test]
    fn names_and_texts_are_unique() {
        for (place, alarm) in ALARMS.iter().enumerate() {
            assert!(ALARMS[..place].iter().all(|other| other.id != alarm.id && other.text != alarm.text));
        }
    }
}
