//! Alarms of a device: asked for, acknowledged, and a start that they prevent.

use super::*;
use crate::device::annunciator::AudioStatus;
use crate::safety::alarms::Priority;

/// A device with all monitors, after some ticks at a reading.
fn sensing(reading: f32) -> Rig {
    let mut rig = Rig::new(None);
    rig.control = Control::new(DeviceKind::Simulated, DEFAULT_PERIOD_US, CORE_HZ).unwrap();
    rig.run_at(100, reading);
    rig
}

fn alarms(rig: &mut Rig) -> AlarmStatus {
    match rig.ask(Request::GetAlarms) {
        Response::Alarms(alarms) => alarms,
        other => panic!("{other:?}"),
    }
}

/// Verifies: sensor-at-start.
#[test]
fn without_a_sound_pressure_sensor_nothing_starts_and_the_reason_is_indicated() {
    let mut rig = sensing(f32::NAN);
    rig.ask(Request::ApplySettings(Settings::default()));
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
    rig.start();
    rig.run_at(20, f32::NAN);
    let lost = alarms(&mut rig);
    assert!(lost.present.has(Fault::ReadingNotANumber) && lost.indicated.has(Fault::BackupVentilation));
    assert_eq!(lost.level, Level::Backup);
    assert_eq!(rig.ask(Request::Acknowledge), Response::Mode(Mode::Ventilating));
    assert_eq!(alarms(&mut rig).indicated, lost.present, "present alarms stay indicated");
    assert_eq!(rig.ask(Request::Acknowledge), Response::Refused(Refusal::NoFault));
}

#[test]
fn the_sounder_is_paused_and_asked_for_over_the_link() {
    let mut rig = sensing(5.0);
    assert_eq!(rig.ask(Request::PauseAudio { seconds: 30 }), Response::Refused(Refusal::NothingSounds));
    rig.run_at(50, f32::NAN);
    assert!(rig.control.signals().sounder && rig.control.signals().red);
    let audio = |pause_left| Response::Audio(AudioStatus { priority: Some(Priority::High), pause_left });
    assert_eq!(rig.ask(Request::PauseAudio { seconds: 121 }), Response::Refused(Refusal::PauseTooLong));
    assert_eq!(rig.ask(Request::PauseAudio { seconds: 30 }), audio(30));
    rig.run_at(2000, f32::NAN);
    assert_eq!((rig.ask(Request::GetAudio), rig.control.signals().sounder), (audio(28), false));
    rig.ask(Request::Acknowledge);
    rig.run_at(1, f32::NAN);
    assert_eq!(rig.ask(Request::GetAudio), Response::Audio(AudioStatus::default()));
}

/// Capacity of the queue between the halves in the firmware.
const CAPACITY: usize = 128;

/// Runs a device whose host reads nothing: its queue fills, and nothing leaves it.
fn unread(control: &mut Control, queue: &mut Vec<ControlReport>, ticks: usize, reading: f32) {
    for _ in 0..ticks {
        let output = control.step(reading);
        control.report(&output, &mut |report| {
            let room = queue.len() < CAPACITY;
            if room {
                queue.push(report);
            }
            room
        });
    }
}

/// Verifies: alarm-repeats.
#[test]
fn a_host_that_reads_nothing_for_a_while_gets_every_alarm_as_soon_as_it_reads() {
    let control = Control::new(DeviceKind::Simulated, DEFAULT_PERIOD_US, CORE_HZ).unwrap();
    let (mut control, mut queue) = (control.with_monitors(Monitors::ANY_PLANT), Vec::new());
    unread(&mut control, &mut queue, 10, 5.0);
    begin(&mut control);
    unread(&mut control, &mut queue, CAPACITY, 5.0);
    assert_eq!(queue.len(), CAPACITY, "full of samples");
    unread(&mut control, &mut queue, 2000, f32::NAN);
    assert!(!queue.iter().any(|report| matches!(report, ControlReport::Alarm { .. })));
    let wanted = control.state().indications().unacknowledged();
    assert!(wanted.has(Fault::ReadingNotANumber));
    // It reads one report in each tick: as much as the samples alone need.
    let mut told = std::collections::BTreeMap::new();
    for _ in 0..2 * CAPACITY {
        if let ControlReport::Alarm { fault, tick } = queue.remove(0) {
            assert!(told.insert(fault, tick).is_none(), "{fault:?} twice");
        }
        unread(&mut control, &mut queue, 1, f32::NAN);
    }
    assert_eq!(told.keys().copied().collect::<Vec<_>>(), wanted.faults().collect::<Vec<_>>());
    let began = |fault| told[&fault];
    assert!(
        (138..170).contains(&began(Fault::ReadingNotANumber)),
        "with the tick at which it began, {}",
        began(Fault::ReadingNotANumber)
    );
}

#[test]
fn an_alarm_whose_frame_was_lost_arrives_again_until_it_is_acknowledged() {
    let mut rig = sensing(5.0);
    rig.run_at(20, f32::NAN);
    rig.events.clear();
    let again = |rig: &Rig| {
        let is = |event: &ToHost| {
            matches!(
                event,
                ToHost::Event(Event::Unacknowledged { fault: Fault::ReadingNotANumber, tick: 100..=120 })
            )
        };
        rig.events.iter().filter(|event| is(event)).count()
    };
    rig.run_at(15_000, f32::NAN);
    assert_eq!(again(&rig), 3, "every 5 s");
    rig.ask(Request::Acknowledge);
    rig.events.clear();
    rig.run_at(15_000, f32::NAN);
    assert_eq!(again(&rig), 0);
}

#[test]
fn each_tick_reports_one_alarm_and_the_first_in_the_tick_in_which_it_begins() {
    let reports = |slot: SlotState, room: &[bool]| -> Vec<usize> {
        let mut control = Control::new(DeviceKind::Simulated, DEFAULT_PERIOD_US, CORE_HZ).unwrap();
        control.report_boot(ResetCause::Watchdog, false, &[slot, SlotState::Empty]);
        let mut tick = |room: bool| {
            let (output, mut count) = (control.step(5.0), 0);
            control.report(&output, &mut |report| {
                count += usize::from(room && matches!(report, ControlReport::Alarm { .. }));
                room
            });
            count
        };
        room.iter().map(|room| tick(*room)).collect()
    };
    assert_eq!(reports(SlotState::Empty, &[true; 3]), [1, 0, 0]);
    assert_eq!(reports(SlotState::Torn, &[false, false, true, true, true]), [0, 0, 1, 1, 0]);
}
