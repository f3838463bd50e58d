//! Tests of what a device's news become.

use super::*;
use crate::stream::BreathFigures;
use monitoring::LineCounters;
use shared::breath::Phase;
use shared::device::annunciator::AudioStatus;
use shared::link::messages::AlarmStatus;
use shared::link::telemetry::{Counters, PackedSample};
use shared::safety::indications::FaultSet;
use shared::timing::{CycleStats, TickTimes};
use shared::ventilator::Sample;

fn watched() -> Watched {
    Watched::new(2, 1000)
}

fn sample(tick: u64) -> Sample {
    Sample {
        breath: 0,
        tick: tick as u32 + 1,
        phase: Phase::Expiration,
        target: 5.0,
        pressure: tick as f32,
        u_in: 5.0,
        u_out: true,
        explore: 0.0,
        learned: 0.0,
        flow: None,
    }
}

fn batch(first_tick: u64, count: usize) -> News {
    let samples: Vec<_> = (first_tick..).take(count).map(sample).collect();
    batch_of(first_tick, &samples)
}

fn batch_of(first_tick: u64, samples: &[Sample]) -> News {
    let samples = samples.iter().map(PackedSample::pack).collect();
    let counters = Counters::default();
    News::Event(Event::Telemetry(TelemetryBatch { sequence: 0, first_tick, counters, samples }))
}

fn timing(ticks: u32) -> News {
    let times = TickTimes { ticks, ..TickTimes::default() };
    News::Answer { request: Request::GetTiming { clear: false }, result: Ok(Response::Timing(times)) }
}

#[test]
fn a_device_without_a_clock_of_its_own_has_no_tick_times() {
    let mut watched = watched();
    take(&mut watched, &timing(10), 1);
    let ticks = watched.state(1, None, None, None).ticks;
    assert_eq!((ticks.mean_us, ticks.worst_us, ticks.missed), (None, None, 0));
    let work = CycleStats { shortest: 100, mean: 200.0, longest: 400 };
    let times = TickTimes { core_hz: 100_000_000, ticks: 20, work, ..TickTimes::default() };
    let result = Ok(Response::Timing(times));
    take(&mut watched, &News::Answer { request: Request::GetTiming { clear: false }, result }, 2);
    let ticks = watched.state(2, None, None, None).ticks;
    assert_eq!((ticks.mean_us, ticks.worst_us), (Some(2.0), Some(4.0)));
}

#[test]
fn the_newest_tick_is_that_of_the_last_sample_also_after_it_was_sent() {
    let mut watched = watched();
    assert_eq!(watched.newest_tick(), None);
    take(&mut watched, &batch(100, 16), 1);
    assert_eq!(watched.newest_tick(), Some(115));
    flushed(&mut watched);
    assert_eq!(watched.newest_tick(), Some(115));
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

fn answer(request: Request, response: Response) -> News {
    News::Answer { request, result: Ok(response) }
}

fn report(present: &[Fault], indicated: &[Fault], level: Level) -> News {
    let set = |faults: &[Fault]| {
        FaultSet::from_bits(faults.iter().fold(0, |bits, fault| bits | 1 << *fault as u32))
    };
    let status = AlarmStatus { present: set(present), indicated: set(indicated), level };
    answer(Request::GetAlarms, Response::Alarms(status))
}

#[test]
fn a_device_is_lost_when_it_does_not_answer_and_back_when_it_does() {
    let mut watched = watched();
    assert!(!watched.state(0, None, None, None).connected, "not heard yet");
    take(&mut watched, &timing(10), 1000);
    assert!(watched.state(3900, None, None, None).connected, "one lost frame delays an answer by 2.5 s");
    let lost = |at| watched.state(at, None, None, None);
    assert_eq!((lost(4100).connected, lost(4100).missing), (false, Some(Missing::Answers)));
    assert_eq!(lost(4100).lost, lost(9000).lost, "the text stays the same");
    take(&mut watched, &News::Traffic(LineCounters::default()), 9100);
    assert!(!watched.state(9100, None, None, None).connected, "counters are not from the device");
    take(&mut watched, &timing(20), 9200);
    assert!(watched.state(9200, None, None, None).connected);
}

#[test]
fn a_device_that_ventilates_without_samples_is_lost_although_it_answers() {
    let mut watched = watched();
    take(&mut watched, &answer(Request::Start, Response::Mode(Mode::Ventilating)), 1000);
    let missing = |watched: &Watched, at| watched.state(at, None, None, None).missing;
    assert_eq!(missing(&watched, 1700), None, "the first ones are not due yet");
    assert_eq!(missing(&watched, 1900), Some(Missing::Samples));
    take(&mut watched, &batch(0, 16), 2000);
    take(&mut watched, &timing(10), 2700);
    assert_eq!((missing(&watched, 2700), missing(&watched, 2900)), (None, Some(Missing::Samples)));
    take(&mut watched, &batch(16, 16), 4000);
    assert_eq!(missing(&watched, 4400), None, "a late answer alone is no loss");
    let mut replay = Watched::new(2, 1000).replaying(true);
    take(&mut replay, &answer(Request::Start, Response::Mode(Mode::Ventilating)), 1000);
    assert_eq!(missing(&replay, 3000), None, "a replay has gaps");
}

#[test]
fn an_alarm_whose_message_was_lost_comes_with_the_next_report() {
    let mut watched = watched();
    assert_eq!(events(&take(&mut watched, &report(&[], &[], Level::Learned), 1)), []);
    let faults = [Fault::Disconnection];
    let reported =
        |watched: &mut Watched| events(&take(watched, &report(&faults, &faults, Level::Learned), 2));
    assert_eq!((reported(&mut watched), reported(&mut watched)), (vec![EventKind::Alarm], vec![]));
    let repeated = News::Event(Event::Unacknowledged { fault: Fault::Disconnection, tick: 7 });
    assert_eq!(events(&take(&mut watched, &repeated, 5000)), []);
}

#[test]
fn the_safe_state_is_shown() {
    let mut watched = watched();
    let modes = [Mode::Standby, Mode::Ventilating, Mode::Fault(Fault::HighPressure)];
    let safe = modes.map(|mode| {
        take(&mut watched, &answer(Request::Stop, Response::Mode(mode)), 1);
        watched.state(1, None, None, None).safe_state
    });
    assert_eq!(safe, [false, false, true]);
}

#[test]
fn an_alarm_that_has_ended_stays_so_while_the_device_repeats_it() {
    let mut watched = watched();
    let alarm = News::Event(Event::Alarm { fault: Fault::Disconnection, tick: 7 });
    assert_eq!(events(&take(&mut watched, &alarm, 9)), [EventKind::Alarm]);
    take(&mut watched, &report(&[], &[Fault::Disconnection], Level::Learned), 1000);
    let repeated = News::Event(Event::Unacknowledged { fault: Fault::Disconnection, tick: 7 });
    assert_eq!(events(&take(&mut watched, &repeated, 5000)), []);
    let alarms = watched.state(5000, None, None, None).alarms;
    assert_eq!((alarms[0].present, alarms[0].since_ms), (false, Some(9)));
}

#[test]
fn after_a_lost_line_and_after_a_restart_nothing_can_be_steered_by_what_was_known() {
    let settings =
        || Response::Settings { in_force: Settings::default(), pending: Some(Settings::default()) };
    let known = |watched: &Watched| {
        let state = watched.state(9, None, None, None);
        (state.settings.is_some(), state.pending.is_some(), state.lease.is_some(), state.audio.pause_left)
    };
    for gone in [News::Lost("unplugged".into()), timing(3)] {
        let mut watched = watched();
        take(&mut watched, &timing(5000), 1);
        take(&mut watched, &answer(Request::GetSettings, settings()), 2);
        let audio = AudioStatus { priority: None, pause_left: 60 };
        take(&mut watched, &answer(Request::GetAudio, Response::Audio(audio)), 2);
        let lease = LeaseStatus { holder: Some(device::host_name()), yours: false };
        take(&mut watched, &answer(Request::GetLease, Response::Lease(lease)), 2);
        assert_eq!(known(&watched), (true, true, true, 60));
        take(&mut watched, &gone, 3);
        assert_eq!((known(&watched), watched.settings()), ((false, false, false, 0), None), "{gone:?}");
    }
}

#[test]
fn losses_count_on_when_a_line_is_opened_again() {
    let mut watched = watched();
    let traffic = |corrupt| News::Traffic(LineCounters { corrupt, ..LineCounters::default() });
    take(&mut watched, &traffic(5), 1);
    take(&mut watched, &News::Lost("unplugged".into()), 2);
    take(&mut watched, &News::Lost("still unplugged".into()), 3);
    take(&mut watched, &traffic(6), 4);
    take(&mut watched, &traffic(7), 5);
    assert_eq!(watched.state(6, None, None, None).line.corrupt, 12);
}

/// What a device reports of a breath.
fn summary(lesson: Lesson, adopted: u8, leak: Option<f32>) -> News {
    let summary = BreathSummary {
        breath: 3,
        mean_absolute_error: 1.0,
        peak_pressure: 20.0,
        end_pressure: 5.0,
        leak,
        lesson,
        adopted,
    };
    News::Event(Event::Breath(summary))
}

#[test]
fn the_adaptation_of_a_learned_controller_is_shown_until_the_line_is_lost() {
    let mut watched = watched();
    let adaptation = |watched: &Watched| watched.state(9, None, None, None).adaptation;
    take(&mut watched, &timing(5000), 1);
    take(&mut watched, &summary(Lesson::Adopt, 2, None), 1);
    assert_eq!(adaptation(&watched), None, "the controller is not known");
    let choose = |choice| answer(Request::SetController(choice), Response::Controller(choice));
    take(&mut watched, &choose(ControllerChoice::Pid(shared::control::pid::KNOWN_GOOD)), 2);
    assert_eq!(adaptation(&watched), None, "a PID does not learn");
    take(&mut watched, &choose(ControllerChoice::Learned), 2);
    let shown = |breaths, last| Some(Adaptation { breaths, of: LEARNING, last });
    assert_eq!(adaptation(&watched), shown(2, "adopted"));
    take(&mut watched, &summary(Lesson::Discard, 2, None), 3);
    assert_eq!(adaptation(&watched), shown(2, "discarded"));
    take(&mut watched, &summary(Lesson::Forget, 0, None), 4);
    assert_eq!(adaptation(&watched), shown(0, "all forgotten"));
    let mut restarted = watched;
    take(&mut restarted, &timing(3), 5);
    assert_eq!(adaptation(&restarted), None);
    take(&mut restarted, &summary(Lesson::Adopt, 1, None), 6);
    take(&mut restarted, &News::Lost("unplugged".into()), 7);
    assert_eq!(adaptation(&restarted), None);
}

#[test]
fn a_breath_has_the_leak_that_the_device_reported() {
    let mut watched = watched();
    let mut tick = 0;
    let mut breathe = |watched: &mut Watched| {
        let mut leak = None;
        for place in 0..3000 {
            let phase = if place < 1000 { Phase::Inspiration } else { Phase::Expiration };
            let sample = Sample { breath: 0, tick: place, phase, pressure: 9.0, ..sample(tick) };
            let out = take(watched, &batch_of(tick, &[sample]), 1);
            tick += 1;
            leak = out.iter().find_map(figures).map(|figures| figures.leak).or(leak);
        }
        leak.flatten()
    };
    breathe(&mut watched);
    assert_eq!(breathe(&mut watched), None);
    take(&mut watched, &summary(Lesson::Adopt, 1, Some(0.01)), 1);
    let leak = breathe(&mut watched).unwrap();
    assert!((leak - 0.01 * 3.0 * 60.0).abs() < 1e-3, "{leak} L/min");
    take(&mut watched, &summary(Lesson::Adopt, 1, None), 1);
    assert_eq!(breathe(&mut watched), None, "the flow sensor is lost");
}

/// The figures of a breath in a message.
fn figures(out: &Out) -> Option<&BreathFigures> {
    match out {
        Out::Message(ToPage::Breath { figures, .. }) => Some(figures),
        _ => None,
    }
}

#[test]
fn a_broken_line_is_reported_once() {
    let mut watched = watched();
    take(&mut watched, &timing(10), 1000);
    let lost = News::Lost("unplugged".into());
    assert_eq!(events(&take(&mut watched, &lost, 1100)), [EventKind::Lost]);
    assert_eq!(events(&take(&mut watched, &lost, 1600)), []);
    assert_eq!(watched.state(1600, None, None, None).lost.as_deref(), Some("unplugged"));
}

#[test]
fn a_restart_is_reported_and_later_figures_start_from_nothing() {
    let mut watched = watched();
    take(&mut watched, &timing(5000), 1);
    take(&mut watched, &batch(100, 16), 2);
    let out = take(&mut watched, &timing(3), 3);
    assert_eq!((frames(&out), events(&out)), (vec![(100, 16)], vec![EventKind::Restarted]));
}

#[test]
fn an_alarm_is_reported_once_and_listed() {
    let mut watched = watched();
    let alarm = News::Event(Event::Alarm { fault: Fault::Disconnection, tick: 7 });
    assert_eq!(events(&take(&mut watched, &alarm, 9)), [EventKind::Alarm]);
    assert_eq!(events(&take(&mut watched, &alarm, 10)), []);
    let state = watched.state(10, Some("page 1"), None, None);
    assert_eq!((state.alarms[0].id, state.alarms[0].since_ms), (Fault::Disconnection.alarm().id, Some(9)));
    assert_eq!(state.steered_by.as_deref(), Some("page 1"));
    let counted: u64 = watched.numbers(10).alarms.iter().sum();
    assert_eq!(counted, 1);
}

#[test]
fn a_latency_counts_from_the_tick_so_with_the_time_for_which_its_batch_was_filled() {
    let mut watched = watched();
    for number in 0..10 {
        take(&mut watched, &batch(16 * number, 16), 1000 + 16 * number);
    }
    // The third batch came at 1032, with tick 47 as its last one.
    assert_eq!(watched.latency_ms(47, 1100), Some(1100 - 1032));
    assert_eq!(watched.latency_ms(40, 1100), Some(1100 - 1032 + 7));
    assert_eq!(watched.latency_ms(32, 1100), Some(1100 - 1032 + 15));
    assert_eq!(watched.latency_ms(159, 1200), Some(1200 - 1144));
    assert_eq!((watched.latency_ms(0, 1200), watched.latency_ms(160, 1200)), (Some(215), None));
}

#[test]
fn the_level_names_the_controller_that_commands() {
    let pid = Some(ControllerChoice::Pid(shared::control::pid::KNOWN_GOOD));
    let found = [
        in_command(Level::Learned, Some(ControllerChoice::Learned)),
        in_command(Level::Learned, pid),
        in_command(Level::Pid, Some(ControllerChoice::Learned)),
        in_command(Level::CappedPid, pid),
        in_command(Level::Backup, None),
    ];
    assert_eq!(found, ["learned", "pid", "pid", "capped", "backup"]);
}

/// Texts of the events about the device itself.
fn complaints(out: &[Out]) -> Vec<&str> {
    fn text(out: &Out) -> Option<&str> {
        match out {
            Out::Message(ToPage::Event { kind: EventKind::Device, text, .. }) => Some(text),
            _ => None,
        }
    }
    out.iter().filter_map(text).collect()
}

#[test]
fn what_a_device_does_not_report_is_told_once_and_not_if_the_line_is_lost() {
    let unknown =
        News::Answer { request: Request::GetLease, result: Err("it does not know GetLease".to_owned()) };
    let traffic = News::Traffic(LineCounters::default());
    let mut watched = watched();
    take(&mut watched, &News::Answer { request: Request::GetAudio, result: Err("gone".into()) }, 1);
    take(&mut watched, &News::Lost("gone".into()), 2);
    assert_eq!(complaints(&take(&mut watched, &traffic, 3)), Vec::<&str>::new(), "that was the line");
    take(&mut watched, &unknown, 4);
    assert_eq!(complaints(&take(&mut watched, &traffic, 5)), ["not shown: it does not know GetLease"]);
    take(&mut watched, &unknown, 6);
    assert_eq!(complaints(&take(&mut watched, &traffic, 7)), Vec::<&str>::new());
    let started = News::Answer { request: Request::Start, result: Err("refused".into()) };
    take(&mut watched, &started, 8);
    assert_eq!(complaints(&take(&mut watched, &traffic, 9)), Vec::<&str>::new(), "the page has its answer");
}

#[test]
fn impossible_samples_are_left_out_and_told() {
    let mut watched = watched();
    let wrong = Sample { u_in: f32::NAN, ..sample(102) };
    take(&mut watched, &batch_of(100, &[sample(100), sample(101), wrong, sample(103)]), 1);
    assert_eq!(flushed(&mut watched), [(103, 1)], "those before the gap were given out");
    let told = take(&mut watched, &News::Traffic(LineCounters::default()), 2);
    assert!(complaints(&told)[0].contains("a valve command of NaN %"), "{told:?}");
    for way in 0..40 {
        let wrong = Sample { u_in: 200.0 + way as f32, ..sample(0) };
        take(&mut watched, &batch_of(200 + way, &[wrong]), 3);
    }
    assert_eq!(
        complaints(&take(&mut watched, &News::Traffic(LineCounters::default()), 4)).len(),
        COMPLAINTS - 1
    );
}
