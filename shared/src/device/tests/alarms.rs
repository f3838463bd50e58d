//! Alarms of a device: asked for, acknowledged, and a start that they prevent.

use super::*;

/// A device with all monitors, after some ticks at a reading.
fn sensing(reading: f32) -> Rig {
    let mut rig = Rig::new(None);
    rig.control = Control::new(DeviceKind::Simulated, DEFAULT_PERIOD_US, None, CORE_HZ).unwrap();
    rig.run_at(100, reading);
    rig
}

fn alarms(rig: &mut Rig) -> AlarmStatus {
    match rig.ask(Request::GetAlarms) {
        Response::Alarms(alarms) => alarms,
        other => panic!("{other:?}"),
    }
}

#[test]
fn without_a_sound_pressure_sensor_nothing_starts_and_the_reason_is_indicated() {
    let mut rig = sensing(f32::NAN);
    assert!(matches!(rig.ask(Request::Identify), Response::Identity(i) if i.mode == Mode::Standby));
    assert!(alarms(&mut rig).indicated.has(Fault::ReadingNotANumber));
    assert_eq!(rig.ask(Request::Start), Response::Refused(Refusal::NoSensor));
    rig.run(4000);
    assert_eq!(rig.ask(Request::Start), Response::Refused(Refusal::NoSensor), "sound for 4 s only");
    rig.run(1100);
    assert_eq!(rig.ask(Request::Start), Response::Mode(Mode::Ventilating));
}

#[test]
fn alarms_are_asked_for_and_acknowledged_while_ventilating() {
    let mut rig = sensing(5.0);
    assert_eq!(alarms(&mut rig), AlarmStatus::default());
    rig.ask(Request::Start);
    rig.run_at(20, f32::NAN);
    let lost = alarms(&mut rig);
    assert!(lost.present.has(Fault::ReadingNotANumber) && lost.indicated.has(Fault::BackupVentilation));
    assert_eq!(lost.level, Level::Backup);
    assert_eq!(rig.ask(Request::Acknowledge), Response::Mode(Mode::Ventilating));
    assert_eq!(alarms(&mut rig).indicated, lost.present, "present alarms stay indicated");
    assert_eq!(rig.ask(Request::Acknowledge), Response::Refused(Refusal::NoFault));
}
