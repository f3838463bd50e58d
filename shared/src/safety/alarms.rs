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
    /// The reading does not change although the pressure must.
    ReadingFrozen,
    /// The reading is far noisier than that of a working sensor.
    ReadingNoisy,
    /// The airway pressure stays above its limit while venting.
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
    /// The two pressure sensors disagree.
    SensorsDisagree,
    /// The pressure sensor at the machine's outlet gives no sound reading.
    OutletSensorLost,
    /// No pressure sensor is sound: the volume, or the commands, of earlier breaths are repeated.
    BackupVentilation,
    /// Much of the inspired volume does not come out again.
    Leak,
    /// Breaths are smaller than the limit.
    TidalVolumeLow,
    /// Breaths are larger than the limit.
    TidalVolumeHigh,
    /// The minute volume is below its limit.
    MinuteVolumeLow,
    /// The minute volume is above its limit.
    MinuteVolumeHigh,
    /// No gas goes in and out.
    Apnoea,
    /// The flow sensor gives no reading.
    FlowSensorLost,
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

impl Priority {
    /// Its word in texts and tables.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Low => "low",
            Self::Medium => "medium",
            Self::High => "high",
        }
    }
}

/// The ventilator's response to an alarm.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Action {
    /// The alarm is reported; its entry text names any further action.
    Report,
    /// The PID alone controls.
    Pid,
    /// The PID compiled into the program controls, with a capped command.
    CappedPid,
    /// The reading in question is not used: the other pressure sensor takes over, or without a sound one backup ventilation.
    Backup,
    /// Inspiratory valve closed, expiratory valve open until an operator acknowledges.
    Vent,
}

impl Action {
    /// Its name in tables.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Report => "report",
            Self::Pid => "PID",
            Self::CappedPid => "capped PID",
            Self::Backup => "backup",
            Self::Vent => "vent, latched",
        }
    }
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

/// What ends latched venting.
const ACKNOWLEDGED: &str = "an operator acknowledges, or the device restarts";
/// What ends a step down the ladder.
const CLEAN_BREATHS: &str = "one step up after 5 clean breaths (more after each return)";
/// What ends a response to an unsound sensor.
const SOUND_AGAIN: &str = "the sensor is sound for 5 s";
/// What ends a response to the state of lung or circuit.
const GONE: &str = "the condition is gone";

const fn row(
    fault: Fault,
    id: &'static str,
    (priority, action): (Priority, Action),
    [entry, exit, text]: [&'static str; 3],
) -> Alarm {
    Alarm { fault, id, priority, action, entry, exit, text }
}

use Action::{Backup, CappedPid, Report, Vent};
use Priority::{High, Low, Medium};

/// All alarms, in the order of [`Fault`].
pub const ALARMS: [Alarm; 30] = [
    row(
        Fault::ReadingNotANumber,
        "reading-nan",
        (High, Backup),
        [
            "no number for 5 ms, or more than a tenth of the readings missing",
            SOUND_AGAIN,
            "pressure reading is not a number",
        ],
    ),
    row(
        Fault::ReadingOutOfRange,
        "reading-range",
        (High, Backup),
        [
            "as `reading-nan`, with most missing readings outside -30 to 110 cmH2O",
            SOUND_AGAIN,
            "pressure reading out of range",
        ],
    ),
    row(
        Fault::HighPressure,
        "high-pressure",
        (High, Report),
        [
            "3 breaths in a row end at the pressure limit, or one does so under the capped PID because of its gas",
            GONE,
            "pressure above its limit",
        ],
    ),
    row(
        Fault::ReadingJumps,
        "reading-jumps",
        (High, Backup),
        [
            "as `reading-nan`, with most missing readings more than 15 cmH2O per ms from the last good one",
            SOUND_AGAIN,
            "pressure reading jumps",
        ],
    ),
    row(
        Fault::ReadingFrozen,
        "reading-frozen",
        (High, Backup),
        [
            "the same reading, to the last bit, for 60 ms in which it must change: the other pressure sensor moves by \
             more than 2 cmH2O, gas flows in more than 2 below the target, or out more than 5 above PEEP",
            SOUND_AGAIN,
            "pressure reading is frozen",
        ],
    ),
    row(
        Fault::ReadingNoisy,
        "reading-noisy",
        (Medium, CappedPid),
        [
            "noise of more than 0.4 cmH2O (standard deviation), averaged over about 50 ms; the cap applies if the other \
             pressure sensor is not sound",
            CLEAN_BREATHS,
            "pressure reading is noisy",
        ],
    ),
    row(
        Fault::HardLimit,
        "hard-limit",
        (High, Vent),
        [
            "0.7 s above the limit with the expiratory valve commanded open",
            ACKNOWLEDGED,
            "pressure stays above its limit",
        ],
    ),
    row(
        Fault::SustainedPressure,
        "sustained-pressure",
        (High, Vent),
        [
            "more than 3 cmH2O above PEEP for 15 s, and with the expiratory valve commanded open a fall of less \
             than 30 % of that in half a second and in half a second after that, or less than a fifth of the inspired volume \
             coming out (three tenths without the gas of a known leak)",
            ACKNOWLEDGED,
            "pressure does not come down",
        ],
    ),
    row(
        Fault::BaselineHigh,
        "baseline-high",
        (High, Report),
        [
            "more than 3 cmH2O above PEEP at the end of 2 expirations in a row, or of 4 if efforts end them early; then an \
             expiration in which the pressure still falls lasts up to half a breath longer, and PIP rises with a constant \
             baseline, up to 7 cmH2O below the limit",
            GONE,
            "pressure does not return to PEEP",
        ],
    ),
    row(
        Fault::BaselineLow,
        "baseline-low",
        (Medium, Report),
        [
            "more than 2 cmH2O below PEEP at the end of 3 breaths in a row, none of them cut at the limit, or 5 in a row \
             with a command of more than 20 % above the bias to hold PEEP, without an effort",
            GONE,
            "pressure below PEEP: check for leaks",
        ],
    ),
    row(
        Fault::LowPressure,
        "low-pressure",
        (High, Report),
        [
            "less than 30 % of the rise from PEEP to PIP, with a command above 60 %, at the end of 2 inspirations in a row",
            GONE,
            "inspiration does not reach its pressure",
        ],
    ),
    row(
        Fault::Disconnection,
        "disconnection",
        (High, Report),
        [
            "600 ms of inspirations (1.2 s with a capped command) at less than 40 % of PEEP and more than 2 cmH2O below it, \
             with a command above 30 %; until the patient is back, the PID probes with a capped command",
            "the pressure of an inspiration is above PEEP again",
            "patient disconnected",
        ],
    ),
    row(
        Fault::Occlusion,
        "occlusion",
        (High, Action::Pid),
        [
            "in 2 breaths in a row less than a third of the volume per pressure rise of the last good breaths, and less than \
             half of the gas reaches the patient or comes out again; in 10 breaths in a row if more does, but less than 80 % \
             comes out again",
            GONE,
            "tube occluded",
        ],
    ),
    row(
        Fault::NoResponse,
        "no-response",
        (High, Backup),
        [
            "for 40 ms less than 12 % of a predicted rise of more than 10 cmH2O, or for 20 ms no change over the last 64 ms \
             although such a rise is predicted; not if two pressure sensors agree, the gas reaches the patient, and the \
             pressure is up, less than 40 cmH2O are missing, or the lung has not been estimated from 2 inspirations, at least \
             one begun by the clock",
            "2 inspirations in a row raise the pressure",
            "pressure does not respond to the valve",
        ],
    ),
    row(
        Fault::MissedTicks,
        "missed-ticks",
        (High, Action::Pid),
        [
            "5 control ticks missed within a breath (the PID controls from the first one on)",
            CLEAN_BREATHS,
            "control ticks missed",
        ],
    ),
    row(
        Fault::LearnedDistrusted,
        "learned-distrusted",
        (Low, Action::Pid),
        [
            "2 breaths in a row end at the pressure limit under the selected controller",
            CLEAN_BREATHS,
            "pressure limit reached twice: PID only",
        ],
    ),
    row(
        Fault::CommandCapped,
        "command-capped",
        (Medium, CappedPid),
        ["a breath ends at the pressure limit under the PID", CLEAN_BREATHS, "valve command capped"],
    ),
    row(
        Fault::HostSilent,
        "host-silent",
        (Low, Report),
        [
            "10 s without a request while ventilating; ventilation continues, exploration ends",
            "the next request from a host",
            "host is silent",
        ],
    ),
    row(
        Fault::WeightsRefused,
        "weights-refused",
        (Low, Report),
        [
            "at start-up a slot holds torn or damaged weights; the other slot's weights or the PID run",
            "valid weights are stored in that slot",
            "stored weights rejected",
        ],
    ),
    row(
        Fault::Restarted,
        "restarted",
        (High, Action::Pid),
        [
            "a reset by the watchdog or a supply dip, or any reset or power cut during ventilation; see SAFETY.md for when it resumes",
            "an operator acknowledges",
            "device restarted by itself",
        ],
    ),
    row(
        Fault::SensorsDisagree,
        "sensors-disagree",
        (High, Backup),
        [
            "the pressure sensors more than 10 cmH2O apart for 20 ms (the higher one counts), or more than 2 at the end of \
             2 expirations in a row (the one closer to PEEP counts)",
            "less than 1 cmH2O apart at the end of 3 expirations in a row",
            "pressure sensors disagree",
        ],
    ),
    row(
        Fault::OutletSensorLost,
        "outlet-sensor-lost",
        (Low, Report),
        [
            "the outlet's pressure sensor fails one of the checks named `reading-`",
            SOUND_AGAIN,
            "outlet pressure sensor lost",
        ],
    ),
    row(
        Fault::BackupVentilation,
        "backup-ventilation",
        (High, Backup),
        [
            "no pressure sensor is sound, or none responds: the volume of the last good breaths is delivered, or without a sound \
             flow sensor their mean commands are repeated",
            "a pressure sensor is sound and responds",
            "backup ventilation without a pressure reading",
        ],
    ),
    row(
        Fault::Leak,
        "leak",
        (Medium, Report),
        [
            "less than 60 % of the inspired volume comes out in 5 breaths in a row, or less than 75 % if holding PEEP takes a \
             command of more than 5 % above the bias",
            GONE,
            "leak: check tube and mask",
        ],
    ),
    row(
        Fault::TidalVolumeLow,
        "tidal-volume-low",
        (Medium, Report),
        [
            "an expired volume, and its mean with the inspired one, below `tidal_volume_low` in 3 breaths in a row",
            GONE,
            "tidal volume too low",
        ],
    ),
    row(
        Fault::TidalVolumeHigh,
        "tidal-volume-high",
        (Medium, Report),
        [
            "an expired volume, and its mean with the inspired one, above `tidal_volume_high` in 3 breaths in a row",
            GONE,
            "tidal volume too high",
        ],
    ),
    row(
        Fault::MinuteVolumeLow,
        "minute-volume-low",
        (High, Report),
        [
            "an expired minute volume below `minute_volume_low`, averaged over 30 s, or over 10 s after the leak has changed",
            GONE,
            "minute volume too low",
        ],
    ),
    row(
        Fault::MinuteVolumeHigh,
        "minute-volume-high",
        (Medium, Report),
        [
            "an expired minute volume above `minute_volume_high`, averaged over 30 s, or over 10 s after the leak has changed",
            GONE,
            "minute volume too high",
        ],
    ),
    row(
        Fault::Apnoea,
        "apnoea",
        (High, Report),
        [
            "no breath of 3 mL in and out for 20 s, or for two breaths if these take longer; time in which gas goes one way \
             only counts half",
            "a breath of such a volume",
            "no gas goes in and out",
        ],
    ),
    row(
        Fault::FlowSensorLost,
        "flow-sensor-lost",
        (Low, Report),
        [
            "no number in more than a tenth of a breath's flow readings; volumes and leaks are not monitored until it is back",
            "a breath with flow readings",
            "flow sensor lost",
        ],
    ),
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
    fn the_responses_have_the_names_of_the_safety_document() {
        let names = [Report, Action::Pid, CappedPid, Backup, Vent].map(Action::name);
        assert_eq!(names, ["report", "PID", "capped PID", "backup", "vent, latched"]);
    }

    #[test]
    fn names_and_texts_are_unique() {
        for (place, alarm) in ALARMS.iter().enumerate() {
            assert!(ALARMS[..place].iter().all(|other| other.id != alarm.id && other.text != alarm.text));
        }
    }
}
