//! Tests of what a device's news become.

use super::*;
use device::LineCounters;
use shared::breath::Phase;
use shared::link::telemetry::{Counters, PackedSample};
use shared::timing::TickTimes;
use shared::ventilator::Sample;

fn watched() -> Watched {
    Watched::new(2, "a lung", 1000)
}

fn batch(first_tick: u64, count: usize) -> News {
    let sample = |tick: u64| Sample {
        breath: 0,
        tick: tick as u32 + 1,
        phase: Phase::Expiration,
        target: 5.0,
        pressure: tick as f32,
        u_in: 5.0,
        u_out: true,
        explore: 0.0,
    };
    let samples = (first_tick..).take(count).map(|tick| PackedSample::pack(&sample(tick))).collect();
    let counters = Counters::default();
    News::Event(Event::Telemetry(TelemetryBatch { sequence: 0, first_tick, counters, samples }))
}

fn timing(ticks: u32) -> News {
    let times = TickTimes { ticks, ..TickTimes::default() };
    News::Answer { request: Request::GetTiming { clear: false }, result: Ok(Response::Timing(times)) }
}

fn take(watched: &mut Watched, news: &News, now_ms: u64) -> Vec<Out> {
    let mut out = Vec::new();
    watched.take(news, now_ms, &mut out);
    out
}

fn flushed(watched: &mut Watched) -> Vec<(u64, u32)> {
    let mut out = Vec::new();
    watched.flush(&mut out);
    frames(&out)
}

/// First tick and number of samples of each message.
fn frames(out: &[Out]) -> Vec<(u64, u32)> {
    let frame = |out: &Out| match out {
        Out::Frame(frame) => {
            let tick = frame.bytes(0)[8..16].try_into().unwrap();
            Some((f64::from_le_bytes(tick) as u64, frame.samples()))
        }
        Out::Message(_) => None,
    };
    out.iter().filter_map(frame).collect()
}

fn events(out: &[Out]) -> Vec<EventKind> {
    let kind = |out: &Out| match out {
        Out::Message(ToPage::Event { kind, .. }) => Some(*kind),
        _ => None,
    };
    out.iter().filter_map(kind).collect()
}

#[test]
fn batches_that_follow_become_one_message_and_a_gap_starts_another() {
    let mut watched = watched();
    assert_eq!(frames(&take(&mut watched, &batch(100, 16), 1)), []);
    assert_eq!(frames(&take(&mut watched, &batch(116, 16), 2)), []);
    assert_eq!(frames(&take(&mut watched, &batch(148, 16), 3)), [(100, 32)]);
    assert_eq!(flushed(&mut watched), [(148, 16)]);
    assert_eq!(flushed(&mut watched), []);
    assert_eq!(watched.numbers(3).samples, 48);
}

#[test]
fn many_samples_become_several_messages() {
    let mut watched = watched();
    let sent: Vec<_> =
        (0..40).flat_map(|number| frames(&take(&mut watched, &batch(16 * number, 16), 1))).collect();
    assert_eq!(sent, [(0, 256), (256, 256)]);
    assert_eq!(flushed(&mut watched), [(512, 128)]);
}

#[test]
fn a_device_is_lost_when_it_is_silent_and_back_when_it_answers() {
    let mut watched = watched();
    assert!(!watched.state(0, None, None).connected, "not heard yet");
    take(&mut watched, &timing(10), 1000);
    assert!(watched.state(2400, None, None).connected);
    let state = watched.state(2600, None, None);
    assert_eq!(
        (state.connected, state.lost.as_deref()),
        (false, Some("the device has been silent for 1.6 s"))
    );
    take(&mut watched, &News::Traffic(LineCounters::default()), 2700);
    assert!(!watched.state(2700, None, None).connected, "counters are not from the device");
    take(&mut watched, &timing(20), 3000);
    assert!(watched.state(3000, None, None).connected);
}

#[test]
fn a_broken_line_is_told_once() {
    let mut watched = watched();
    take(&mut watched, &timing(10), 1000);
    let lost = News::Lost("unplugged".into());
    assert_eq!(events(&take(&mut watched, &lost, 1100)), [EventKind::Lost]);
    assert_eq!(events(&take(&mut watched, &lost, 1600)), []);
    assert_eq!(watched.state(1600, None, None).lost.as_deref(), Some("unplugged"));
}

#[test]
fn a_restart_is_told_and_later_figures_start_from_nothing() {
    let mut watched = watched();
    take(&mut watched, &timing(5000), 1);
    take(&mut watched, &batch(100, 16), 2);
    let out = take(&mut watched, &timing(3), 3);
    assert_eq!((frames(&out), events(&out)), (vec![(100, 16)], vec![EventKind::Restarted]));
}

#[test]
fn an_alarm_is_told_once_and_listed() {
    let mut watched = watched();
    let alarm = News::Event(Event::Alarm { fault: Fault::Disconnection, tick: 7 });
    assert_eq!(events(&take(&mut watched, &alarm, 9)), [EventKind::Alarm]);
    assert_eq!(events(&take(&mut watched, &alarm, 10)), []);
    let state = watched.state(10, Some("page 1"), None);
    assert_eq!((state.alarms[0].id, state.alarms[0].since_ms), (Fault::Disconnection.alarm().id, 9));
    assert_eq!(state.steered_by.as_deref(), Some("page 1"));
    let counted: u64 = watched.numbers(10).alarms.iter().sum();
    assert_eq!(counted, 1);
}

#[test]
fn a_latency_counts_from_the_arrival_of_the_ticks_batch() {
    let mut watched = watched();
    for number in 0..10 {
        take(&mut watched, &batch(16 * number, 16), 1000 + 16 * number);
    }
    assert_eq!(watched.latency_ms(40, 1100), Some(1100 - 1032));
    assert_eq!(watched.latency_ms(159, 1200), Some(1200 - 1144));
    assert_eq!((watched.latency_ms(0, 1200), watched.latency_ms(160, 1200)), (Some(200), None));
}

#[test]
fn the_level_names_the_controller_that_commands() {
    let pid = Some(ControllerChoice::Pid(shared::control::pid::KNOWN_GOOD));
    let found = [
        level(Level::Learned, Some(ControllerChoice::Learned)),
        level(Level::Learned, pid),
        level(Level::Pid, Some(ControllerChoice::Learned)),
        level(Level::CappedPid, pid),
        level(Level::Backup, None),
    ];
    assert_eq!(found, ["learned", "pid", "pid", "capped", "backup"]);
}
