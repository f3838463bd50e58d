//! Modes, alarms, controllers and reset causes as text.

use std::cmp::Reverse;
use std::ops::RangeInclusive;

use shared::control::memory::Lesson;
use shared::device::annunciator::AudioStatus;
use shared::link::messages::{AlarmStatus, ControllerChoice, DeviceIdentity, DeviceKind, LeaseStatus};
use shared::reset::ResetCause;
use shared::safety::alarms::Fault;
use shared::safety::ladder::Level;
use shared::settings::{FIELDS, Field, Settings};
use shared::ventilator::{Mode, Sample};

/// Pressures that count as such, cmH2O: ten times what breaks a lung.
const PRESSURE: RangeInclusive<f32> = -1000.0..=1000.0;
/// Valve commands that count as such, percent.
const VALVE: RangeInclusive<f32> = 0.0..=100.0;

/// The ventilator's mode.
pub fn mode(mode: Mode) -> String {
    match mode {
        Mode::Standby => "standby".to_owned(),
        Mode::Ventilating => "ventilating".to_owned(),
        Mode::Fault(latched) => format!("safe state: {}", fault(latched)),
    }
}

/// The fault detected by a monitor.
pub fn fault(fault: Fault) -> &'static str {
    fault.alarm().text
}

/// The level of the ladder that commands the inspiratory valve.
pub fn level(level: Level) -> &'static str {
    match level {
        Level::Learned => "chosen controller",
        Level::Pid => "PID alone",
        Level::CappedPid => "capped PID",
        Level::Backup => "backup ventilation",
    }
}

/// The indicated alarms: the most urgent first, of equal ones those that are present.
pub fn indicated(alarms: &AlarmStatus) -> Vec<Fault> {
    let mut faults: Vec<Fault> = alarms.indicated.faults().collect();
    faults.sort_by_key(|fault| Reverse((fault.alarm().priority, alarms.present.has(*fault))));
    faults
}

/// An indicated alarm: priority, text, and whether its condition is gone.
pub fn alarm(indicated: Fault, alarms: &AlarmStatus) -> String {
    let gone = if alarms.present.has(indicated) { "" } else { " (gone)" };
    format!("{}: {}{gone}", indicated.alarm().priority.name(), fault(indicated))
}

/// The state of the sounder.
pub fn audio(audio: &AudioStatus) -> String {
    match audio {
        AudioStatus { pause_left: 0, priority: None } => "no alarm sounds".to_owned(),
        AudioStatus { pause_left: 0, priority: Some(sounding) } => {
            format!("sounds for an alarm of {} priority", sounding.name())
        }
        AudioStatus { pause_left, .. } => format!("paused, {pause_left} s left"),
    }
}

/// What a controller has made of a breath.
pub fn lesson(lesson: Lesson) -> &'static str {
    match lesson {
        Lesson::Adopt => "adopt",
        Lesson::Discard => "discard",
        Lesson::Forget => "forget",
    }
}

/// What is impossible about a sample, in words. A pressure that is not a number is possible: no sensor may be sound.
pub fn impossible(sample: &Sample) -> Option<String> {
    let Sample { target, pressure, u_in, explore, learned, flow, .. } = *sample;
    if !VALVE.contains(&u_in) {
        Some(format!("a valve command of {u_in} %"))
    } else if !PRESSURE.contains(&target) {
        Some(format!("a target of {target} cmH2O"))
    } else if !pressure.is_nan() && !PRESSURE.contains(&pressure) {
        Some(format!("a pressure of {pressure} cmH2O"))
    } else if !explore.is_finite() || !learned.is_finite() {
        Some(format!("a perturbation of {explore} % and a learned part of {learned} %"))
    } else {
        flow.filter(|flow| !flow.is_finite()).map(|flow| format!("a flow of {flow} L/s"))
    }
}

/// The running controller.
pub fn controller(choice: ControllerChoice) -> String {
    match choice {
        ControllerChoice::Pid(gains) => format!("PID {},{},{}", gains.p, gains.i, gains.d),
        ControllerChoice::Learned => "learned".to_owned(),
    }
}

/// Who steers a device.
pub fn lease(status: &LeaseStatus) -> String {
    match status.holder {
        None => "nobody".to_owned(),
        Some(_) if status.yours => "this program".to_owned(),
        Some(holder) => format!("{holder} (this program only reads)"),
    }
}

/// The kind of a device.
pub fn device(kind: DeviceKind) -> &'static str {
    match kind {
        DeviceKind::Ventilator => "ventilator",
        DeviceKind::HardwareInTheLoop => "hardware in the loop",
        DeviceKind::Simulated => "simulated",
        DeviceKind::ThirdParty => "third-party device",
        DeviceKind::Desk => "simulated on the board",
    }
}

/// The cause of a device's start.
pub fn reset(cause: ResetCause) -> &'static str {
    match cause {
        ResetCause::PowerOn => "power on",
        ResetCause::BrownOut => "supply dipped",
        ResetCause::Pin => "reset pin",
        ResetCause::Software => "program",
        ResetCause::Watchdog => "watchdog",
        ResetCause::Other => "unknown cause",
    }
}

/// A device in one line.
pub fn identity(identity: &DeviceIdentity) -> String {
    let [major, minor, patch] = identity.firmware;
    let period = identity.period_us;
    let build = if is_development(identity) { ", development build" } else { "" };
    format!("{}, firmware {major}.{minor}.{patch}, tick {period} us{build}", device(identity.device))
}

/// Whether the device runs this project's firmware, built without a key.
pub fn is_development(identity: &DeviceIdentity) -> bool {
    identity.weights_key.is_none()
        && matches!(identity.device, DeviceKind::Ventilator | DeviceKind::HardwareInTheLoop)
}

/// The name of a setting.
pub fn name(field: &Field) -> String {
    field.name.replace('_', " ")
}

/// A setting in force with its unit, and its next value if that differs.
pub fn setting(field: &Field, in_force: &Settings, pending: Option<&Settings>) -> String {
    let now = field.value(in_force);
    let next = pending.map(|pending| field.value(pending)).filter(|next| next.total_cmp(&now).is_ne());
    let next = next.map_or_else(String::new, |next| format!(", {next} from the next breath on"));
    format!("{now} {}{next}", field.unit)
}

/// All settings with their units.
pub fn settings(settings: &Settings) -> String {
    let one = |field: &Field| format!("{} {}", name(field), setting(field, settings, None));
    FIELDS.iter().map(one).collect::<Vec<_>>().join(", ")
}

/// A control tick as time since power-up.
pub fn moment(tick: u64, period_us: u32) -> String {
    format!("at {:.3} s", tick as f64 * f64::from(period_us) * 1e-6)
}
