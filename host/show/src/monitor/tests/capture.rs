//! The file of `--mcap`.

use std::fs;
use std::path::Path;

use data::export::ExportError;
use mcap::read::Options;
use mcap::{MessageStream, Summary};
use serde_json::Value;

use super::*;
use crate::monitor::capture::Capture;

/// A time of the wall clock, ns since 1970.
const NOON: u64 = 1_800_000_000_000_000_000;
const MS: u64 = 1_000_000;

fn started(folder: &Path) -> Capture {
    Capture::create(&folder.join("a.mcap"), "COM3", &identity(Mode::Standby), NOON).unwrap()
}

/// Time, topic and content of each message of a file, which may lack its end.
fn messages(bytes: &[u8]) -> Vec<(u64, String, Value)> {
    let stream = MessageStream::new_with_options(bytes, Options::IgnoreEndMagic.into()).unwrap();
    let message = |message: mcap::Message| {
        let value = serde_json::from_slice(&message.data).unwrap();
        (message.log_time, message.channel.topic.clone(), value)
    };
    stream.map_while(Result::ok).map(message).collect()
}

/// The messages after this news, each with the time in ms at which it came.
fn captured(news: impl IntoIterator<Item = (u64, News)>) -> Vec<(u64, String, Value)> {
    let folder = tempfile::tempdir().unwrap();
    let mut capture = started(folder.path());
    for (ms, news) in news {
        assert!(!capture.take(&news, NOON + ms * MS));
    }
    let counts = capture.finish().unwrap();
    let bytes = fs::read(folder.path().join("a.mcap")).unwrap();
    let summary = Summary::read(&bytes).unwrap().expect("the file is finished");
    assert_eq!(summary.stats.unwrap().message_count, counts.values().sum::<u64>());
    assert_eq!(summary.metadata_indexes.len(), 1);
    messages(&bytes)
}

fn of<'a>(topic: &str, messages: &'a [(u64, String, Value)]) -> Vec<(u64, &'a Value)> {
    messages.iter().filter(|message| message.1 == topic).map(|(time, _, value)| (*time, value)).collect()
}

#[test]
fn samples_have_the_times_of_their_ticks_whenever_they_arrive() {
    let pressures = [5.1, 5.2, 5.3, f32::NAN];
    // The second batch is late, and the third long before its time, as from an emulated device; then it restarts.
    let found = captured([
        (4, telemetry(1000, &pressures)),
        (30, telemetry(1004, &pressures)),
        (40, telemetry(9004, &pressures)),
        (2040, telemetry(0, &pressures)),
    ]);
    let times: Vec<_> = of("/pressure", &found).into_iter().map(|(time, _)| (time - NOON) / MS).collect();
    let after = |ms: u64| ms..ms + 4;
    let expected = [after(0), after(4), after(8004), after(8008 + 2000 - 4)];
    assert_eq!(times, expected.into_iter().flatten().collect::<Vec<_>>());
    let (_, first) = of("/pressure", &found)[0];
    assert_eq!((first["measured"].as_f64().unwrap() as f32, &first["target"]), (5.1, &20.0.into()));
    assert!(of("/pressure", &found)[3].1.get("measured").is_none(), "no reading");
    let (_, valves) = of("/valves", &found)[0];
    assert_eq!((&valves["u_in"], &valves["u_out"]), (&0.0.into(), &100.0.into()));
    let (_, place) = of("/breath", &found)[1];
    assert_eq!(
        (&place["tick"], &place["phase"], &place["phase_name"]),
        (&1001.into(), &1.into(), &"fall".into())
    );
}

/// A batch starting at this tick with these learned parts and flows.
fn measured(first_tick: u64, values: &[(f32, Option<f32>)]) -> News {
    let mut batch = batch(first_tick, &[5.0]);
    let sample = batch.samples[0].unpack();
    let packed = |(learned, flow): &(f32, Option<f32>)| {
        PackedSample::pack(&Sample { learned: *learned, flow: *flow, ..sample })
    };
    batch.samples = values.iter().map(packed).collect();
    News::Event(Event::Telemetry(batch))
}

#[test]
fn the_learned_part_and_the_flow_are_written_and_a_missing_flow_is_not() {
    let found = captured([(2, measured(1000, &[(-1.5, Some(0.25)), (0.0, None)]))]);
    let learned: Vec<_> = of("/valves", &found).into_iter().map(|(_, valves)| &valves["learned"]).collect();
    assert_eq!(learned, [-1.5, 0.0]);
    let [(time, flow)] = of("/flow", &found)[..] else { panic!("{found:?}") };
    assert_eq!((time, flow), (NOON, &serde_json::json!({ "patient": 0.25 })));
}

#[test]
fn an_alarm_is_written_once_at_the_time_of_its_tick() {
    let repeated = News::Event(Event::Unacknowledged { fault: Fault::Leak, tick: 4321 });
    let found = captured([(16, telemetry(4310, &[5.0; 16])), (20, alarm(Fault::Leak)), (900, repeated)]);
    let [(time, alarm)] = of("/alarms", &found)[..] else { panic!("{found:?}") };
    assert_eq!((time, &alarm["id"], &alarm["tick"]), (NOON + 11 * MS, &"leak".into(), &4321.into()));
}

#[test]
fn a_marker_is_written_at_the_time_of_the_device() {
    let folder = tempfile::tempdir().unwrap();
    let mut capture = started(folder.path());
    assert!(!capture.take(&telemetry(1000, &[5.0; 4]), NOON + 4 * MS));
    assert!(!capture.mark("suction", NOON + 10 * MS));
    assert_eq!(capture.finish().unwrap()["/markers"], 1);
    let found = messages(&fs::read(folder.path().join("a.mcap")).unwrap());
    let [(time, marker)] = of("/markers", &found)[..] else { panic!("{found:?}") };
    assert_eq!((time, &marker["text"]), (NOON + 10 * MS, &"suction".into()));
}

#[test]
fn alarms_of_every_start_of_the_device_are_written_though_their_ticks_are_equal() {
    let alarm = |tick| News::Event(Event::Alarm { fault: Fault::Restarted, tick });
    let again = |tick| News::Event(Event::Unacknowledged { fault: Fault::Restarted, tick });
    let ticks = |news: Vec<News>| {
        let found = captured(news.into_iter().zip(1..).map(|(news, seconds)| (1000 * seconds, news)));
        let alarms = of("/alarms", &found).into_iter();
        alarms.map(|(_, alarm)| alarm["tick"].as_u64().unwrap()).collect::<Vec<_>>()
    };
    let night = |seconds: u64| telemetry(1000 * seconds, &[5.0; 16]);
    let start = || telemetry(0, &[5.0; 16]);
    let twice = vec![start(), alarm(3), again(3), night(1), start(), alarm(3), again(3), night(1), again(3)];
    assert_eq!(ticks(twice), [3, 3], "reported, and repeated until it is acknowledged");
    let missed = vec![start(), again(3), night(1), again(3), start(), again(3), night(1), again(3)];
    assert_eq!(ticks(missed), [3, 3], "the first reports were lost");
    let early = vec![start(), alarm(3), night(1), alarm(3), start(), again(3)];
    assert_eq!(ticks(early), [3, 3], "an alarm overtakes the first batch");
    let link = vec![start(), alarm(3), night(1), News::Lost("cable".into()), night(2), again(3)];
    assert_eq!(ticks(link), [3], "only the connection was lost");
}

#[test]
fn each_schema_describes_the_fields_that_are_written() {
    let folder = tempfile::tempdir().unwrap();
    let mut capture = started(folder.path());
    let measured = measured(0, &[(1.5, Some(0.25))]);
    let news = [greeting(Mode::Ventilating), measured, alarm(Fault::Leak), breath(1)];
    for news in news.into_iter().chain([News::Traffic(LineCounters::default())]) {
        capture.take(&news, NOON);
    }
    capture.finish().unwrap();
    let bytes = fs::read(folder.path().join("a.mcap")).unwrap();
    let mut topics = Vec::new();
    for message in MessageStream::new(&bytes).unwrap() {
        let message = message.unwrap();
        let topic = message.channel.topic.as_str();
        let schema: Value = serde_json::from_slice(&message.channel.schema.as_ref().unwrap().data).unwrap();
        let properties = schema["properties"].as_object().unwrap();
        let content: Value = serde_json::from_slice(&message.data).unwrap();
        let content = content.as_object().unwrap();
        // The virtual bench alone knows the true pressure.
        let written = |name: &str| !matches!((topic, name), ("/pressure", "true") | ("/flow", "in" | "out"));
        let described: Vec<_> = properties.keys().filter(|name| written(name)).collect();
        assert_eq!(content.keys().collect::<Vec<_>>(), described, "{topic}");
        for (name, value) in content {
            let right = match properties[name]["type"].as_str().unwrap() {
                "integer" => value.is_u64(),
                "number" => value.is_number(),
                "boolean" => value.is_boolean(),
                "string" => value.is_string(),
                other => panic!("{other}"),
            };
            assert!(right, "{topic} {name}: {value}");
        }
        topics.push(topic.to_owned());
    }
    topics.sort_unstable();
    assert_eq!(topics, ["/alarms", "/breath", "/breaths", "/device", "/flow", "/pressure", "/valves"]);
}

#[test]
fn figures_that_are_no_numbers_are_left_out() {
    let figures = |mean_absolute_error, peak_pressure, end_pressure| {
        let summary = BreathSummary {
            breath: 4,
            mean_absolute_error,
            peak_pressure,
            end_pressure,
            leak: None,
            lesson: Lesson::Discard,
            adopted: 0,
        };
        News::Event(Event::Breath(summary))
    };
    let news = [figures(f32::NAN, f32::NEG_INFINITY, 5.5), figures(0.5, 20.0, f32::NAN)];
    let found = captured(news.map(|news| (0, news)));
    let breaths: Vec<_> = of("/breaths", &found).into_iter().map(|(_, breath)| breath.clone()).collect();
    let expected = [
        serde_json::json!({ "number": 4, "end": 5.5, "lesson": "discard", "adopted": 0 }),
        serde_json::json!({ "number": 4, "mean_error": 0.5, "peak": 20.0, "lesson": "discard", "adopted": 0 }),
    ];
    assert_eq!(breaths, expected);
}

#[test]
fn the_state_of_the_device_is_written_with_each_poll_and_at_a_loss() {
    let poll = |mode| {
        let losses = LineCounters { corrupt: 2, ..LineCounters::default() };
        let present = alarms(&[Fault::Leak], &[Fault::Restarted], Level::Pid);
        [
            greeting(mode),
            in_force(Settings::default()),
            present,
            steered(Some("anna@icu"), false),
            News::Traffic(losses),
        ]
    };
    let news =
        poll(Mode::Standby).into_iter().chain([News::Lost("cable".into())]).chain(poll(Mode::Ventilating));
    let found = captured(news.map(|news| (0, news)));
    let states: Vec<_> = of("/device", &found)
        .into_iter()
        .map(|(_, state)| (state["connected"].as_bool().unwrap(), state["mode"].as_str().unwrap().to_owned()))
        .collect();
    assert_eq!(states, [(true, "standby".into()), (false, "standby".into()), (true, "ventilating".into())]);
    let (_, state) = of("/device", &found)[0];
    assert_eq!((&state["indicated_alarms"], &state["damaged_frames"]), (&"restarted leak".into(), &2.into()));
    assert_eq!((&state["pip"], &state["rate"]), (&20.0.into(), &20.0.into()));
}

#[test]
fn a_capture_that_is_killed_keeps_all_but_the_last_second() {
    let folder = tempfile::tempdir().unwrap();
    let mut capture = started(folder.path());
    for batch in 0..200 {
        capture.take(&telemetry(16 * batch, &[5.0; 16]), NOON + 16 * (batch + 1) * MS);
    }
    // What the operating system has when the program is killed.
    let killed = fs::read(folder.path().join("a.mcap")).unwrap();
    let (last, ..) = *messages(&killed).last().unwrap();
    assert!((2200 * MS..3200 * MS).contains(&(last - NOON)), "{} ms", (last - NOON) / MS);
}

#[test]
fn a_loss_puts_everything_on_disk() {
    let folder = tempfile::tempdir().unwrap();
    let mut capture = started(folder.path());
    capture.take(&telemetry(0, &[5.0; 16]), NOON);
    capture.take(&News::Lost("cable".into()), NOON);
    let killed = fs::read(folder.path().join("a.mcap")).unwrap();
    assert_eq!(messages(&killed).len(), 3 * 16 + 1);
}

#[test]
fn an_earlier_capture_is_never_overwritten() {
    let folder = tempfile::tempdir().unwrap();
    started(folder.path()).finish().unwrap();
    let again = Capture::create(&folder.path().join("a.mcap"), "COM3", &identity(Mode::Standby), NOON);
    assert!(matches!(again, Err(ExportError::Exists(_))));
}
