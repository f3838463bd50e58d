//! PIRDS files of other programs: their sensors, breaths without marks, and flaws.

use std::fmt::Write;
use std::fs;
use std::io::Write as _;
use std::sync::atomic::AtomicBool;

use flate2::Compression;
use flate2::write::GzEncoder;
use proptest::prelude::*;

use super::*;
use crate::import::NO_SET_POINT;
use crate::recording::Recording;

/// Imports a text; returns the result and the recording.
fn imported(text: &str) -> Result<(ImportSummary, Recording), DatasetError> {
    let folder = tempfile::tempdir().unwrap();
    let [events, out] = ["monitor.json", "a.parquet"].map(|name| folder.path().join(name));
    fs::write(&events, text).unwrap();
    let summary = import_pirds(&[events], &out, &Progress::silent())?;
    Ok((summary, Recording::load(&out).unwrap()))
}

fn refusal(text: &str) -> String {
    imported(text).unwrap_err().to_string()
}

fn event(kind: char, location: char, ms: u32, value: f64) -> String {
    format!(
        r#"{{ "event": "M", "type": "{kind}", "ms": {ms}, "loc": "{location}", "num": "0", "val": {} }}"#,
        value.round()
    )
}

/// Pressure (cmH2O) and flow (L/s) of a breath of 3 s, of which 1 s is the inspiration, at this time in ms.
fn breath(ms: u32, pip: f64) -> (f64, f64) {
    let t = f64::from(ms % 3000) * 1e-3;
    if t < 1.0 {
        (5.0 + (pip - 5.0) * (1.0 - (-t / 0.05).exp()), 0.8 * (-t / 0.3).exp())
    } else {
        (5.0 + (pip - 5.0) * (-(t - 1.0) / 0.2).exp(), -0.8 * (-(t - 1.0) / 0.3).exp())
    }
}

/// A minute of events each 20 ms; PIP alternates between 15 and 30 cmH2O.
fn monitored(pressure: impl Fn(u32, f64) -> String, flows: bool) -> String {
    let mut text = "[\n".to_owned();
    for ms in (10..60_000).step_by(20) {
        let (p, q) = breath(ms, if (ms / 3000) % 2 == 0 { 15.0 } else { 30.0 });
        writeln!(text, "{},", pressure(ms, p)).unwrap();
        if flows {
            writeln!(text, "{},", event('F', 'A', ms, 60_000.0 * q)).unwrap();
        }
    }
    text + "]\n"
}

fn gauge(ms: u32, pressure: f64) -> String {
    event('D', 'A', ms, 10.0 * pressure)
}

#[test]
fn a_survey_stops_when_asked_and_leaves_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let [events, out] = ["monitor.json", "a.parquet"].map(|name| folder.path().join(name));
    // A survey that goes on finds the line that is not an event.
    fs::write(&events, monitored(gauge, true) + "no event\n").unwrap();
    let asked = AtomicBool::new(true);
    let stopped = import_pirds(std::slice::from_ref(&events), &out, &Progress::quiet(&asked));
    assert!(matches!(stopped, Err(DatasetError::Stopped)), "{stopped:?}");
    assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1);
}

#[test]
fn breaths_without_marks_are_found_by_the_flow_or_else_by_the_pressure() {
    for (flows, late) in [(true, 0), (false, 5)] {
        let (summary, recording) = imported(&monitored(gauge, flows)).unwrap();
        assert_eq!((summary.period_us, summary.breaths, summary.complete_breaths), (20_000, 19, 19));
        assert_eq!(recording.flow_in.is_some() && recording.flow_out.is_some(), flows);
        for (inspiration, pip) in recording.inspirations().into_iter().zip([30.0, 15.0].into_iter().cycle()) {
            assert!((50..=50 + late).contains(&inspiration.len()), "{inspiration:?}");
            let plateau = recording.pressure[inspiration.start + 45];
            assert!((plateau - pip).abs() < 0.06, "{plateau}");
        }
        assert!(recording.provenance.notes.iter().any(|note| note == NO_COMMANDS));
        assert!(recording.provenance.notes.iter().any(|note| note == NO_SET_POINT));
    }
}

#[test]
fn encodings_compression_and_the_log_of_a_logger_do_not_matter() {
    let text = monitored(gauge, true);
    let (expected, _) = imported(&text).unwrap();
    let folder = tempfile::tempdir().unwrap();
    let [events, out] = ["monitor.json", "a.parquet"].map(|name| folder.path().join(name));
    let mut packed = GzEncoder::new(Vec::new(), Compression::default());
    packed.write_all(text.as_bytes()).unwrap();
    let utf16 = std::iter::once(0xfeff).chain(text.encode_utf16()).flat_map(u16::to_le_bytes);
    let mut log = String::new();
    for ms in (10..60_000).step_by(20) {
        let (p, q) = breath(ms, if (ms / 3000) % 2 == 0 { 15.0 } else { 30.0 });
        writeln!(log, "1593299588:M:D:A:0:{ms}:{}", (10.0 * p).round()).unwrap();
        writeln!(log, "1593299588:M:F:A:0:{ms}:{}", (60_000.0 * q).round()).unwrap();
    }
    for content in
        [format!("\u{feff}{text}").into_bytes(), utf16.collect(), packed.finish().unwrap(), log.into_bytes()]
    {
        fs::write(&events, content).unwrap();
        let summary = import_pirds(std::slice::from_ref(&events), &out, &Progress::silent()).unwrap();
        assert_eq!(summary, expected);
    }
}

#[test]
fn an_event_that_is_there_twice_counts_once() {
    let (expected, once) = imported(&monitored(gauge, true)).unwrap();
    // Each event at once, and each pair of them.
    let lines: Vec<String> = monitored(gauge, true).lines().skip(1).map(str::to_owned).collect();
    let events = &lines[..lines.len() - 1];
    let each: Vec<_> = events.iter().flat_map(|event| [event.as_str(); 2]).collect();
    let pairs: Vec<_> = events.chunks(2).flat_map(|pair| [pair.concat(), pair.concat()]).collect();
    for text in [each.join("\n"), pairs.join("\n")] {
        let (summary, twice) = imported(&text).unwrap();
        assert_eq!(summary.disorder.repeated, expected.rows);
        assert_eq!((summary.kept, summary.rows), (expected.kept, 2 * expected.rows), "{summary}");
        assert_eq!((twice.pressure, twice.flow_in), (once.pressure.clone(), once.flow_in.clone()));
    }
}

#[test]
fn peep_is_where_the_pressure_rested_before_a_breath_however_late_its_start_is_found() {
    for flows in [true, false] {
        let (_, recording) = imported(&monitored(gauge, flows)).unwrap();
        let breaths = recording.breaths();
        for rows in &breaths[1..] {
            assert!((recording.peep[rows.start] - 5.0).abs() < 0.1, "{}", recording.peep[rows.start]);
        }
    }
}

#[test]
fn an_absolute_pressure_is_used_if_the_ambient_one_is_known() {
    let absolute = |ms, pressure| event('P', 'A', ms, 10.0 * (1_002.2 + pressure));
    let both = |ms, pressure| format!("{},{}", absolute(ms, pressure), event('P', 'B', ms, 10_022.0));
    let (summary, recording) = imported(&monitored(both, false)).unwrap();
    assert!(summary.pressure.high < 31.0, "the first reading too, before any of the ambient pressure");
    let (_, expected) = imported(&monitored(gauge, false)).unwrap();
    assert_eq!(recording.pressure, expected.pressure);
    assert!(refusal(&monitored(absolute, true)).contains("ambient"));
    // Some ventilators call a relative pressure P.
    let relative = |ms, pressure| event('P', 'A', ms, 10.0 * pressure);
    assert_eq!(imported(&monitored(relative, false)).unwrap().1.pressure, expected.pressure);
}

#[test]
fn events_that_no_row_uses_are_counted_by_name() {
    let mut text = monitored(gauge, true);
    for event in [
        r#"{ "event": "M", "type": "T", "loc": "B", "num": 2, "ms": 35, "val": 250 }"#,
        r#"{ "event": "M", "type": "T", "loc": "B", "num": 2, "ms": 36, "val": 250, "pid": "a person" }"#,
        r#"{ "event": "E", "type": "M", "ms": 5, "b_size": 22, "buff": "FLOW OUT OF RANGE HIGH" }"#,
        r#"{ "event": "E", "type": "C", "ms": 10443, "buff": "Sun Jul 26 22:19:10 2020" }"#,
        r#"{ "event": "A", "type": "X", "loc": "A", "num": 0, "ms": 9, "val": 250 }"#,
        r#"{ "event": "Z" }"#,
    ] {
        writeln!(text, "{event}").unwrap();
    }
    let (summary, recording) = imported(&text).unwrap();
    let expected =
        [("TB2", 2), ("messages", 1), ("meta event C", 1), ("assertion X", 1), ("unknown event Z", 1)];
    assert_eq!(summary.unused, expected.map(|(name, count)| (name.to_owned(), count)).into());
    assert!(summary.to_string().contains("TB2 (2)"), "{summary}");
    let provenance = serde_json::to_string(&recording.provenance).unwrap();
    assert!(!provenance.contains("a person"), "no name of a patient is kept");
}

#[test]
fn a_file_of_countless_kinds_of_events_has_a_short_account() {
    let mut text = monitored(gauge, true);
    for kind in 0..300 {
        writeln!(text, r#"{{ "event": "{kind}" }}"#).unwrap();
    }
    let (summary, _) = imported(&text).unwrap();
    assert!(summary.unused.len() <= 65 && summary.unused.values().sum::<usize>() == 300, "{summary}");
}

#[test]
fn a_bad_line_is_refused_with_its_number_and_what_to_do() {
    let good = gauge(0, 5.0);
    for (bad, hint) in [
        ("{\"event\": \"M\"", "ends within"),
        ("{\"event\": M}", "correct the event's JSON"),
        ("{}", "`event`"),
        ("1591668735:M:P:A:0:263923", "remove it"),
        ("no event", "not the start of an event"),
        (&good.replace("50", "50.5"), "`val` must be a whole number"),
        (&good.replace("50", "5000000000"), "`val`"),
        (&good.replace("\"D\"", "\"Diff\""), "one letter"),
        (&good.replace("\"num\"", "\"number\""), "`num`"),
    ] {
        let refusal = refusal(&format!("{good}\n{good}\n{bad}"));
        assert!(refusal.contains("line 3") && refusal.contains(hint), "{refusal}");
    }
    assert!(refusal(&format!("[\n{good}")).contains("`]`"));
}

#[test]
fn a_file_that_makes_no_recording_is_refused_with_the_reason() {
    assert!(refusal("").contains("is empty") && refusal("[]").contains("no airway pressure"));
    assert!(refusal(&event('F', 'A', 0, 1.0)).contains("no airway pressure"));
    assert!(refusal(&format!("{}{}", gauge(7, 5.0), gauge(7, 5.0))).contains("does not increase"));
    let still: String = (0..500).map(|n| gauge(20 * n, 5.0)).collect();
    assert!(refusal(&still).contains("no breath"));
}

proptest! {
    #[test]
    fn no_file_makes_an_import_panic(bytes in prop::collection::vec(any::<u8>(), 0..300)) {
        let folder = tempfile::tempdir().unwrap();
        let [events, out] = ["events", "a.parquet"].map(|name| folder.path().join(name));
        fs::write(&events, &bytes).unwrap();
        let _ = import_pirds(&[events], &out, &Progress::silent());
    }

    #[test]
    fn no_events_make_an_import_panic(
        events in prop::collection::vec(
            (
                "[MEA]", "[PDFTM]", "[AIEB]", any::<i32>(),
                prop_oneof![any::<i64>(), 0..5000_i64], 0..400_u16, any::<bool>(),
            ),
            0..80,
        ),
    ) {
        let mut all = String::new();
        for (event, kind, location, value, ms, number, mark) in &events {
            let text = if *mark { "eupnea breath 1 fall from 3 to 5 cmH2O in 9 ms" } else { "" };
            let sensor = format!(r#""type":"{kind}","loc":"{location}","num":{}"#, number % 257);
            writeln!(all, r#"{{"event":"{event}",{sensor},"ms":{ms},"val":{value},"buff":"{text}"}}"#).unwrap();
        }
        let _ = imported(&all);
    }
}
