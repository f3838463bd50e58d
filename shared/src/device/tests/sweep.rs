//! A sweep of sines on a device: refused with a reason, and ended by whatever ends the supervision or the breaths that it counts.

use super::*;
use crate::explore::sines::{AMPLITUDE_MAX, SineSweep, SweepError, SweepQuantity};

const SWEEP: SineSweep = SineSweep {
    amplitude: 10.0,
    lowest_hz: 5.0,
    ratio: 1.0,
    frequencies: 1,
    phases: 64,
    first_breath: 0,
    from_s: 0.0,
};

/// A device that ventilates with this sweep, and runs this alarm alone.
fn sweeping(fault: Fault, sweep: SineSweep) -> Rig {
    let mut rig = Rig::new(None);
    let others = Fault::all().filter(|other| *other != fault && !Monitors::ANY_PLANT.has(*other));
    rig.control = rig.control.with_monitors(others.fold(Monitors::ALL, Monitors::without));
    rig.ask(Request::Telemetry { on: true });
    assert_eq!(rig.ask(Request::SetSweep(Some(sweep))), Response::Sweep(Some(sweep)));
    rig.start();
    rig
}

/// For each breath, whether a sine was added.
fn swept(rig: &mut Rig) -> Vec<bool> {
    let samples = rig.samples();
    let last = samples.last().map_or(0, |sample| sample.breath);
    let in_breath = |breath| samples.iter().any(|sample| sample.breath == breath && sample.explore != 0.0);
    (0..=last).map(in_breath).collect()
}

fn in_force(rig: &Rig) -> Option<SineSweep> {
    match rig.control.clone().execute(&ControlRequest::Status) {
        ControlReply::Status(status) => status.sweep,
        ControlReply::Response(_) => None,
    }
}

#[test]
fn a_sine_that_would_exceed_the_limit_is_refused_with_the_amplitude_that_is_allowed() {
    let mut rig = Rig::new(None);
    let refused = rig.ask(Request::SetSweep(Some(SineSweep { amplitude: AMPLITUDE_MAX + 1.0, ..SWEEP })));
    let error = SweepError { quantity: SweepQuantity::Amplitude, value: AMPLITUDE_MAX + 1.0 };
    assert_eq!(refused, Response::Refused(Refusal::Sweep(error)));
    assert_eq!(in_force(&rig), None);
}

#[test]
fn a_sweep_takes_the_place_of_the_exploration_and_ends_after_its_breaths() {
    let mut rig = sweeping(Fault::MissedTicks, SineSweep { phases: 3, first_breath: 1, ..SWEEP });
    rig.run(3 * TICKS_OF_A_BREATH);
    assert!(in_force(&rig).is_some());
    rig.run(3 * TICKS_OF_A_BREATH);
    assert_eq!(swept(&mut rig), [false, true, true, true, false, false]);
    assert_eq!(in_force(&rig), None);
    rig.ask(Request::SetExploration(Some(Exploration::default())));
    rig.ask(Request::SetSweep(Some(SWEEP)));
    assert!(matches!(rig.ask(Request::Identify), Response::Identity(i) if i.exploration.is_none()));
    rig.ask(Request::SetExploration(Some(Exploration::default())));
    assert_eq!(in_force(&rig), None);
}

#[test]
fn a_host_that_falls_silent_ends_the_sweep() {
    let mut rig = sweeping(Fault::HostSilent, SWEEP);
    rig.run(6 * TICKS_OF_A_BREATH);
    assert_eq!(swept(&mut rig), [true, true, true, true, false, false], "10 s end in the fourth breath");
    assert_eq!(in_force(&rig), None);
}

#[test]
fn an_alarm_ends_the_sweep_and_none_begins_during_it() {
    let mut rig = sweeping(Fault::Restarted, SWEEP);
    rig.run(TICKS_OF_A_BREATH + 500);
    assert!(in_force(&rig).is_some());
    rig.control.report_boot(ResetCause::Watchdog, true, &[SlotState::Empty; 2]);
    rig.run(1);
    assert_eq!(in_force(&rig), None);
    assert_eq!(rig.ask(Request::SetSweep(Some(SWEEP))), Response::Refused(Refusal::AlarmPresent));
}

#[test]
fn a_stop_ends_the_sweep_since_it_counts_breaths() {
    let mut rig = sweeping(Fault::MissedTicks, SWEEP);
    rig.run(500);
    rig.ask(Request::Stop);
    assert_eq!(in_force(&rig), None);
}
