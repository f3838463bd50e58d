//! All alarms: name, priority, the ventilator's action, text.
//!
//! [`ALARMS`] is the single source: the chip acts on it, the trainer prints it, and SAFETY.md's table is
//! generated from it. That table also states when an alarm begins and ends, with the numbers of the monitors'
//! constants (`tests/tests/safety_document`).

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
    /// Breaths have become much smaller than those before, at the same settings.
    VentilationFalls,
    /// Breaths have become a fraction of those before, or have been much smaller for long.
    VentilationLost,
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
    /// The alarm is reported; SAFETY.md names any further action.
    Report,
    /// The PID alone controls.
    Pid,
    /// The PID compiled into the program controls, with a capped command.
    CappedPid,
    /// The reading in question is not used: the other pressure sensor takes over, or without a sound one
    /// backup ventilation.
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
    /// Text for the operator, without numbers.
    pub text: &'static str,
}

const fn row(
    fault: Fault,
    id: &'static str,
    (priority, action): (Priority, Action),
    text: &'static str,
) -> Alarm {
    Alarm { fault, id, priority, action, text }
}

use Action::{Backup, CappedPid, Report, Vent};
use Priority::{High, Low, Medium};

/// All alarms, in the order of [`Fault`].
pub const ALARMS: [Alarm; 32] = [
    row(Fault::ReadingNotANumber, "reading-nan", (High, Backup), "pressure reading is not a number"),
    row(Fault::ReadingOutOfRange, "reading-range", (High, Backup), "pressure reading out of range"),
    row(Fault::HighPressure, "high-pressure", (High, Report), "pressure above its limit"),
    row(Fault::ReadingJumps, "reading-jumps", (High, Backup), "pressure reading jumps"),
    row(Fault::ReadingFrozen, "reading-frozen", (High, Backup), "pressure reading is frozen"),
    row(Fault::ReadingNoisy, "reading-noisy", (Medium, CappedPid), "pressure reading is noisy"),
    row(Fault::HardLimit, "hard-limit", (High, Vent), "pressure stays above its limit"),
    row(Fault::SustainedPressure, "sustained-pressure", (High, Vent), "pressure does not come down"),
    row(Fault::BaselineHigh, "baseline-high", (High, Report), "pressure does not return to PEEP"),
    row(Fault::BaselineLow, "baseline-low", (Medium, Report), "pressure below PEEP: check for leaks"),
    row(Fault::LowPressure, "low-pressure", (High, Report), "inspiration does not reach its pressure"),
    row(Fault::Disconnection, "disconnection", (High, Report), "patient disconnected"),
    row(Fault::Occlusion, "occlusion", (High, Action::Pid), "tube occluded"),
    row(Fault::NoResponse, "no-response", (High, Backup), "pressure does not respond to the valve"),
    row(Fault::MissedTicks, "missed-ticks", (High, Action::Pid), "control ticks missed"),
    row(
        Fault::LearnedDistrusted,
        "learned-distrusted",
        (Low, Action::Pid),
        "pressure limit reached repeatedly: PID only",
    ),
    row(Fault::CommandCapped, "command-capped", (Medium, CappedPid), "valve command capped"),
    row(Fault::HostSilent, "host-silent", (Low, Report), "host is silent"),
    row(Fault::WeightsRefused, "weights-refused", (Low, Report), "stored weights rejected"),
    row(Fault::Restarted, "restarted", (High, Action::Pid), "device restarted by itself"),
    row(Fault::SensorsDisagree, "sensors-disagree", (High, Backup), "pressure sensors disagree"),
    row(Fault::OutletSensorLost, "outlet-sensor-lost", (Low, Report), "outlet pressure sensor lost"),
    row(
        Fault::BackupVentilation,
        "backup-ventilation",
        (High, Backup),
        "backup ventilation without a pressure reading",
    ),
    row(Fault::Leak, "leak", (Medium, Report), "leak: check tube and mask"),
    row(Fault::TidalVolumeLow, "tidal-volume-low", (Medium, Report), "tidal volume too low"),
    row(Fault::TidalVolumeHigh, "tidal-volume-high", (Medium, Report), "tidal volume too high"),
    row(Fault::MinuteVolumeLow, "minute-volume-low", (High, Report), "minute volume too low"),
    row(Fault::MinuteVolumeHigh, "minute-volume-high", (Medium, Report), "minute volume too high"),
    row(Fault::Apnoea, "apnoea", (High, Report), "no gas goes in and out"),
    row(Fault::FlowSensorLost, "flow-sensor-lost", (Low, Report), "flow sensor lost"),
    row(Fault::VentilationFalls, "ventilation-falls", (Medium, Report), "breaths have become much smaller"),
    row(
        Fault::VentilationLost,
        "ventilation-lost",
        (High, Report),
        "breaths have become a fraction of what they were",
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
    fn names_and_texts_are_unique_and_state_no_number() {
        for (place, alarm) in ALARMS.iter().enumerate() {
            assert!(ALARMS[..place].iter().all(|other| other.id != alarm.id && other.text != alarm.text));
            assert!(!alarm.text.contains(|letter: char| letter.is_numeric()), "{}", alarm.text);
        }
    }
}
