//! Tests of the replays.

use super::*;
use data::provenance::Provenance;
use data::recording::EXPIRATION;
use data::recording::Row;

/// A recording of breaths of 40 ticks of 1 ms, of which some ticks are missing.
fn table(breaths: u32, missing: &[(u32, u32)]) -> Recording {
    let mut recording = Recording::new(Provenance::new(1000, "test"), false);
    for (breath, tick) in (0..breaths).flat_map(|breath| (0..40).map(move |tick| (breath, tick))) {
        if !missing.contains(&(breath, tick)) {
            let phase = if tick < 20 { 0 } else { EXPIRATION };
            let pressure = (breath * 40 + tick) as f32;
            let u_out = if tick < 20 { 0.0 } else { 100.0 };
            recording.push(Row { breath, tick, phase, pressure, u_out, ..Row::default() });
        }
    }
    recording
}

/// Samples that a source gives within a time, with their ticks.
fn run(source: &mut dyn Source, time: Duration) -> Ticks {
    let (until, mut found) = (Instant::now() + time, Ticks::new());
    while Instant::now() < until {
        if let Some(News::Event(Event::Telemetry(batch))) = source.next(Duration::from_millis(5)) {
            found.extend((batch.first_tick..).zip(batch.samples.iter().map(PackedSample::unpack)));
        }
    }
    found
}

#[test]
fn a_recording_is_replayed_in_its_own_time_and_again() {
    let mut watch = recording("test", &table(2, &[])).unwrap();
    assert_eq!((watch.kind, watch.period_us), (Kind::Recording, 1000));
    let found = run(&mut *watch.source, Duration::from_millis(1300));
    let first: Vec<u64> = found.iter().take(80).map(|(tick, _)| *tick).collect();
    assert_eq!(first, (0..80).collect::<Vec<_>>());
    assert!(
        found.iter().take(80).all(|(tick, sample)| sample.pressure.to_bits() == (*tick as f32).to_bits())
    );
    // The next round starts a second after the last tick, and has its beginning again.
    assert_eq!((found[80].0, found[80].1.pressure.to_bits()), (1079, 0.0_f32.to_bits()));
    assert!(found.last().unwrap().0 <= 1310, "not faster than it was recorded");
}

#[test]
fn missing_ticks_stay_missing() {
    let mut watch = recording("test", &table(2, &[(0, 10), (0, 11), (1, 0)])).unwrap();
    let found = run(&mut *watch.source, Duration::from_millis(300));
    let ticks: Vec<u64> = found.iter().map(|(tick, _)| *tick).collect();
    assert_eq!(ticks, (0..80).filter(|tick| ![10, 11, 40].contains(tick)).collect::<Vec<_>>());
}

#[test]
fn a_replay_ventilates_and_cannot_be_steered() {
    let mut watch = recording("test", &table(1, &[])).unwrap();
    let news = watch.source.next(Duration::ZERO).unwrap();
    assert!(matches!(news, News::Answer { result: Ok(Response::Mode(Mode::Ventilating)), .. }));
    assert_eq!(watch.source.ask(Request::Stop), Err(Unable::Replay));
}

#[test]
fn a_flight_recorder_is_shown_from_its_file() {
    let entry = |breath: u8, phase: &str| {
        format!(
            r#"{{"pressure":20.5,"target":20.0,"u_in":30.0,"u_out":false,"phase":{phase},"explored":false,"activity":"Ventilating","breath":{breath}}}"#
        )
    };
    let inspires = "\"Inspiration\"";
    let entries =
        [entry(15, inspires), "null".into(), entry(15, inspires), entry(0, inspires), entry(0, "null")]
            .join(",");
    let text = format!(
        r#"{{"port":"x","fast":{{"step_s":0.001,"entries":[{entries}]}},"slow":{{"step_s":0.02,"entries":[]}}}}"#
    );
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("box.json");
    std::fs::write(&path, text).unwrap();
    let mut watches = blackbox(&path).unwrap();
    assert_eq!(watches.len(), 1, "the slow part is empty");
    assert!(watches[0].name.ends_with("box.json, last seconds"));
    let found = run(&mut *watches[0].source, Duration::from_millis(100));
    let places: Vec<_> = found.iter().map(|(tick, sample)| (*tick, sample.breath, sample.tick)).collect();
    assert_eq!(places, [(0, 0, 1), (2, 0, 1), (3, 1, 0)]);
    std::fs::write(&path, "{}").unwrap();
    assert!(matches!(blackbox(&path), Err(ReplayError::Blackbox { .. })));
    assert!(matches!(blackbox(folder.path()), Err(ReplayError::Read { .. })));
}

#[test]
fn an_empty_recording_is_refused() {
    let refused = recording("a file", &table(0, &[])).err().unwrap().to_string();
    assert_eq!(refused, "a file contains no ticks of a ventilation");
}
