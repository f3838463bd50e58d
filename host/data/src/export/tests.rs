//! Exported files, read back by the library of the format or by the import.

use std::collections::BTreeMap;
use std::fs;
use std::io::{self, Cursor, Seek, SeekFrom, Write};

use ::mcap::records::Record;
use ::mcap::sans_io::linear_reader::{LinearReadEvent, LinearReader, LinearReaderOptions};
use ::mcap::{MessageStream, Summary, parse_record};
use proptest::prelude::*;
use serde_json::Value;

use super::mcap::{BreathPosition, CHUNK_BYTES, Flow, McapWriter, Message, ORIGIN, Pressure, Valves};
use super::pirds::Layout;
use super::*;
use crate::import::import_pirds;
use crate::provenance::Provenance;
use crate::recording::{EXPIRATION, Extra, FALL, INSPIRATION, Row};
use progress::Progress;

/// Ticks of the phases of a breath.
const PHASES: [(u8, u32); 3] = [(INSPIRATION, 100), (FALL, 50), (EXPIRATION, 150)];

fn provenance(period_us: u32) -> Provenance {
    Provenance {
        seed: 7,
        plant: "R20C20".to_owned(),
        weights_id: "0000beef".to_owned(),
        settings: serde_json::json!({ "pip": [15, 25], "rate": 20 }),
        notes: vec!["a note".to_owned()],
        ..Provenance::new(period_us, "test")
    }
}

/// Breaths with PEEP 5 and these PIPs, whose pressure and flows have all digits of a float.
fn breaths(pips: &[f32], period_us: u32, extras: &[Extra]) -> Recording {
    let mut recording = Recording::with_extras(provenance(period_us), extras);
    for (breath, &pip) in (0..).zip(pips) {
        let ticks = PHASES.iter().flat_map(|&(phase, ticks)| (0..ticks).map(move |tick| (phase, tick)));
        for (tick, (phase, since)) in (0..).zip(ticks) {
            let target = match phase {
                INSPIRATION => pip,
                FALL => pip + (5.0 - pip) * since as f32 / 50.0,
                _ => 5.0,
            };
            let wave = (tick as f32 * 0.07).sin();
            recording.push(Row {
                breath,
                tick,
                phase,
                target,
                pressure: target + wave / 3.0,
                u_in: 30.0 + wave,
                u_out: if phase == INSPIRATION { 0.0 } else { 100.0 },
                explore: -wave,
                pip,
                peep: 5.0,
                pressure_true: Some(target + wave / 7.0),
                flow_in: Some(if phase == INSPIRATION { 0.5 + wave / 9.0 } else { 0.0 }),
                flow_out: Some(if phase == INSPIRATION { 0.0 } else { 0.3 + wave / 9.0 }),
                ..Row::default()
            });
        }
    }
    recording
}

const ALL: [Extra; 3] = [Extra::PressureTrue, Extra::FlowIn, Extra::FlowOut];

/// The file of a recording, as bytes.
fn mcap_of(recording: &Recording) -> Vec<u8> {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.mcap");
    mcap::save(recording, &path).unwrap();
    fs::read(path).unwrap()
}

/// Messages of a file by time and topic; an error if any part is damaged.
fn messages(bytes: &[u8]) -> Result<BTreeMap<(u64, String), Value>, String> {
    let stream = MessageStream::new(bytes).map_err(|error| error.to_string())?;
    stream
        .map(|message| {
            let message = message.map_err(|error| error.to_string())?;
            let value = serde_json::from_slice(&message.data).map_err(|error| error.to_string())?;
            Ok(((message.log_time, message.channel.topic.clone()), value))
        })
        .collect()
}

/// Contents of the messages up to the first damage, by a reader that verifies checksums and refuses endless records.
fn checked(bytes: &[u8]) -> Vec<Vec<u8>> {
    let options =
        LinearReaderOptions::default().with_prevalidate_chunk_crcs(true).with_record_length_limit(1 << 24);
    let (mut reader, mut rest, mut found) = (LinearReader::new_with_options(options), bytes, Vec::new());
    while let Some(Ok(event)) = reader.next_event() {
        match event {
            LinearReadEvent::ReadRequest(wanted) => {
                let length = wanted.min(rest.len());
                reader.insert(length).copy_from_slice(&rest[..length]);
                reader.notify_read(length);
                rest = &rest[length..];
            }
            LinearReadEvent::Record { opcode, data } => {
                if let Ok(Record::Message { data, .. }) = parse_record(opcode, data) {
                    found.push(data.into_owned());
                }
            }
        }
    }
    found
}

/// A number of a message as the float that it was.
fn float(messages: &BTreeMap<(u64, String), Value>, time: u64, topic: &str, field: &str) -> Option<u32> {
    let value = messages.get(&(time, topic.to_owned()))?.get(field)?.as_f64()?;
    Some((value as f32).to_bits())
}

#[test]
fn every_sample_of_a_recording_is_in_the_file_bit_for_bit() {
    let recording = breaths(&[15.0, 25.0, 35.0], 1000, &ALL);
    let found = messages(&mcap_of(&recording)).unwrap();
    assert_eq!(found.len(), 4 * recording.len());
    for (row, time_us) in times_us(&recording).into_iter().enumerate() {
        let (row, time) = (recording.row(row).unwrap(), 1000 * time_us);
        let expected = [
            ("/pressure", "measured", row.pressure),
            ("/pressure", "target", row.target),
            ("/pressure", "true", row.pressure_true.unwrap()),
            ("/valves", "u_in", row.u_in),
            ("/valves", "u_out", row.u_out),
            ("/valves", "explore", row.explore),
            ("/flow", "in", row.flow_in.unwrap()),
            ("/flow", "out", row.flow_out.unwrap()),
        ];
        for (topic, field, value) in expected {
            assert_eq!(float(&found, time, topic, field), Some(value.to_bits()), "{topic} {field} {time}");
        }
        let place = &found[&(time, "/breath".to_owned())];
        let [number, phase, tick] =
            ["number", "phase", "tick"].map(|field| place[field].as_u64().unwrap() as u32);
        assert_eq!((number, phase, tick), (row.breath, row.phase.into(), row.tick));
    }
}

#[test]
fn a_file_has_index_statistics_schemas_and_the_origin() {
    // Enough rows for several chunks.
    let recording = breaths(&[20.0; 30], 1000, &[]);
    let bytes = mcap_of(&recording);
    let summary = Summary::read(&bytes).unwrap().unwrap();
    let statistics = summary.stats.unwrap();
    assert_eq!(statistics.message_count, 3 * recording.len() as u64);
    assert_eq!((statistics.message_start_time, statistics.message_end_time), (0, (9000 - 1) * 1_000_000));
    assert!(summary.chunk_indexes.len() >= 2, "{} chunks", summary.chunk_indexes.len());
    assert!(summary.chunk_indexes.iter().all(|chunk| chunk.uncompressed_size < 2 * CHUNK_BYTES));
    let mut topics: Vec<_> = summary.channels.values().map(|channel| channel.topic.clone()).collect();
    topics.sort();
    assert_eq!(topics, ["/breath", "/pressure", "/valves"], "no flow and no channel of it");
    for channel in summary.channels.values() {
        let schema = channel.schema.as_ref().unwrap();
        assert_eq!((schema.encoding.as_str(), channel.message_encoding.as_str()), ("jsonschema", "json"));
        let schema: Value = serde_json::from_slice(&schema.data).unwrap();
        assert_eq!(schema["type"], "object");
    }
    let origin = ::mcap::read::metadata(&bytes, &summary.metadata_indexes[0]).unwrap();
    assert_eq!(origin.name, ORIGIN);
    let field = |name: &str| origin.metadata[name].as_str();
    assert_eq!((field("plant"), field("seed"), field("weights_id")), ("R20C20", "7", "0000beef"));
    assert_eq!(field("settings"), r#"{"pip":[15,25],"rate":20}"#);
}

#[test]
fn each_schema_describes_the_fields_of_its_messages() {
    fn check<M: Message>(message: &M) {
        let value = serde_json::to_value(message).unwrap();
        let fields = value.as_object().unwrap();
        assert!(
            fields.len() == M::FIELDS.len() && M::FIELDS.iter().all(|(name, ..)| fields.contains_key(*name))
        );
        for (name, kind, _) in M::FIELDS {
            let found = &fields[*name];
            assert!(if *kind == "string" { found.is_string() } else { found.is_number() }, "{name}");
        }
    }
    check(&Pressure { measured: 1.0, target: 2.0, truth: Some(3.0) });
    check(&Valves { u_in: 1.0, u_out: 2.0, explore: 3.0, learned: Some(4.0) });
    check(&Flow { inward: Some(1.0), outward: Some(2.0), patient: Some(3.0) });
    check(&BreathPosition::new(0, 1, 2));
}

#[test]
fn equal_recordings_give_equal_bytes_and_an_old_file_is_replaced() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("new/a.mcap");
    mcap::save(&breaths(&[20.0], 1000, &[]), &path).unwrap();
    let recording = breaths(&[15.0, 20.0], 1000, &ALL);
    mcap::save(&recording, &path).unwrap();
    assert_eq!(fs::read(&path).unwrap(), mcap_of(&recording));
    assert_eq!(fs::read_dir(path.parent().unwrap()).unwrap().count(), 1, "no temporary file");
    let empty = Recording::new(provenance(1000), false);
    assert!(matches!(mcap::save(&empty, &path), Err(ExportError::Empty)));
    assert!(matches!(pirds::save(&empty, Layout::Lines, &path), Err(ExportError::Empty)));
}

#[test]
fn a_reading_that_is_missing_is_left_out_of_its_message() {
    let mut writer = McapWriter::new("a.mcap".as_ref(), Cursor::new(Vec::new())).unwrap();
    writer.write(5, &Pressure { measured: f32::NAN, target: 2.0, truth: None }).unwrap();
    let (file, counts) = writer.finish().unwrap();
    assert_eq!(counts, [("/pressure", 1)].into());
    let found = messages(&file.into_inner()).unwrap();
    assert_eq!(found[&(5, "/pressure".to_owned())], serde_json::json!({ "target": 2.0 }));
}

#[test]
fn a_capture_keeps_what_was_flushed_before_the_program_was_killed_and_overwrites_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.mcap");
    let mut writer = McapWriter::capture(&path).unwrap();
    for time in 0..3 {
        writer.write(time, &BreathPosition::new(0, 0, time as u32)).unwrap();
    }
    writer.flush().unwrap();
    writer.write(3, &BreathPosition::new(0, 0, 3)).unwrap();
    let killed = fs::read(&path).unwrap();
    drop(writer);
    let whole = messages(&fs::read(&path).unwrap()).unwrap();
    assert_eq!(whole.len(), 4, "a writer that is dropped finishes its file");
    let options = ::mcap::read::Options::IgnoreEndMagic.into();
    let found = MessageStream::new_with_options(&killed, options).unwrap();
    assert_eq!(found.filter_map(Result::ok).count(), 3);
    assert!(matches!(McapWriter::capture(&path), Err(ExportError::Exists(_))));
}

/// A disk with room for so many bytes.
struct Disk(Cursor<Vec<u8>>, usize);

impl Write for Disk {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        if self.0.position() as usize + bytes.len() > self.1 {
            return Err(io::ErrorKind::StorageFull.into());
        }
        self.0.write(bytes)
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

impl Seek for Disk {
    fn seek(&mut self, to: SeekFrom) -> io::Result<u64> {
        self.0.seek(to)
    }
}

#[test]
fn a_full_disk_is_an_error_wherever_it_happens() {
    let write_all = |room: usize| {
        let mut writer = McapWriter::new("a.mcap".as_ref(), Disk(Cursor::new(Vec::new()), room))?;
        for tick in 0..500 {
            writer.write(tick, &BreathPosition::new(0, 0, tick as u32))?;
            if tick % 50 == 0 {
                writer.flush()?;
            }
        }
        writer.finish()
    };
    let whole = write_all(usize::MAX).unwrap().0.0.into_inner().len();
    for room in (0..whole).step_by(61) {
        assert!(matches!(write_all(room), Err(ExportError::Encode { .. })), "{room}");
    }
}

#[test]
fn a_killed_program_leaves_the_start_of_the_file_that_it_would_have_finished() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.mcap");
    let mut writer = McapWriter::capture(&path).unwrap();
    let mut killed = Vec::new();
    // More than a chunk, and then more than the operating system is given at a time.
    for tick in 0..12_000 {
        writer.write(tick, &BreathPosition::new(0, 0, tick as u32)).unwrap();
        if tick % 1000 == 999 {
            killed.push(fs::read(&path).unwrap());
        }
    }
    writer.finish().unwrap();
    let whole = fs::read(&path).unwrap();
    assert!(killed.iter().all(|killed| whole.starts_with(killed)) && !killed[11].is_empty());
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    #[test]
    fn a_reader_that_checks_never_takes_a_damaged_sample_for_a_whole_one(
        place: prop::sample::Index, bit in 0..8_u8, cut: prop::sample::Index,
    ) {
        let whole = mcap_of(&breaths(&[20.0], 1000, &ALL));
        let samples = checked(&whole);
        prop_assert_eq!(samples.len(), 4 * 300);
        let mut bytes = whole;
        let at = place.index(bytes.len());
        bytes[at] ^= 1 << bit;
        for damaged in [&bytes[..], &bytes[..cut.index(bytes.len())]] {
            prop_assert!(samples.starts_with(&checked(damaged)));
        }
    }

    #[test]
    fn pirds_gives_back_every_reading_within_half_a_unit(
        pips in prop::collection::vec(10_f32..35.0, 1..4), period_ms in 1..20_u32, lines: bool, flows: bool,
    ) {
        let original = breaths(&pips, 1000 * period_ms, if flows { &ALL } else { &[] });
        let back = through_pirds(&original, if lines { Layout::Lines } else { Layout::Array });
        prop_assert_eq!(back.provenance.period_us, original.provenance.period_us);
        prop_assert_eq!((&back.breath, &back.tick), (&original.breath, &original.tick));
        prop_assert_eq!(back.inspirations(), original.inspirations());
        prop_assert_eq!(back.flow_in.is_some(), flows);
        for row in 0..back.len() {
            let (back, original) = (back.row(row).unwrap(), original.row(row).unwrap());
            prop_assert!((back.pressure - original.pressure).abs() <= 0.05 + 1e-5);
            let close = |back: f32, original: f32, bound: f32| (back - original).abs() <= bound;
            prop_assert!(close(back.target, original.target, 0.01), "{} {}", back.target, original.target);
            prop_assert!(close(back.pip, original.pip, 0.006) && close(back.peep, original.peep, 0.006));
            if let (Some(inward), Some(outward)) = (back.flow_in, back.flow_out) {
                let net = original.flow_in.unwrap() - original.flow_out.unwrap();
                prop_assert!((inward - outward - net).abs() <= 0.5 / 60_000.0 + 1e-6);
            }
        }
    }
}

/// Exports a recording as PIRDS and imports the file.
fn through_pirds(recording: &Recording, layout: Layout) -> Recording {
    let folder = tempfile::tempdir().unwrap();
    let [events, back] = ["events", "back.parquet"].map(|name| folder.path().join(name));
    pirds::save(recording, layout, &events).unwrap();
    let summary = import_pirds(&[events], &back, &Progress::silent()).unwrap();
    assert!(summary.unused.is_empty() && summary.rows == recording.len(), "{summary:?}");
    Recording::load(&back).unwrap()
}

#[test]
fn events_are_written_as_the_standard_shows_them() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.jsonl");
    let written = pirds::save(&breaths(&[25.0], 1000, &ALL), Layout::Lines, &path).unwrap();
    assert_eq!((written.readings, written.messages), (600, 3));
    let text = fs::read_to_string(&path).unwrap();
    let first: Vec<_> = text.lines().take(3).collect();
    let message = "eupnea breath 0 inspiration from 25 to 25 cmH2O in 0 ms";
    assert_eq!(
        first,
        [
            format!(r#"{{"event":"E","type":"M","ms":0,"b_size":{},"buff":"{message}"}}"#, message.len()),
            r#"{"event":"M","type":"D","loc":"A","num":0,"ms":0,"val":250}"#.to_owned(),
            r#"{"event":"M","type":"F","loc":"A","num":0,"ms":0,"val":30000}"#.to_owned(),
        ]
    );
    pirds::save(&breaths(&[25.0], 1000, &ALL), Layout::Array, &path).unwrap();
    let array: Vec<Value> = serde_json::from_str(&fs::read_to_string(&path).unwrap()).unwrap();
    assert_eq!(array.len(), 603);
}

#[test]
fn pirds_refuses_what_it_cannot_hold() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.json");
    let fast = breaths(&[25.0], 250, &[]);
    assert!(matches!(pirds::save(&fast, Layout::Array, &path), Err(ExportError::Period(250))));
    let mut huge = breaths(&[25.0], 1000, &[]);
    huge.pressure[3] = 1e12;
    let refused = pirds::save(&huge, Layout::Array, &path);
    assert!(matches!(refused, Err(ExportError::Range { column: "pressure", row: 3, .. })));
    assert!(!path.exists(), "nothing was written");
}

#[test]
fn a_lost_tick_leaves_its_time_free() {
    let mut recording = Recording::new(provenance(1000), false);
    for (breath, tick) in [(0, 0), (0, 3), (1, 0), (1, 1)] {
        recording.push(Row { breath, tick, ..Row::default() });
    }
    assert_eq!(times_us(&recording), [0, 3000, 4000, 5000]);
}
