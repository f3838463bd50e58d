//! Event files of `TensorBoard`: for each run a folder with one file, in which figures, curves and options are events.
//!
//! A file is a sequence of records: length (u64), its checksum, an `Event` in protobuf, its checksum. Numbers are little-endian. The
//! messages are those of `tensorflow/core/util/event.proto` and `framework/summary.proto`, with the fields that are used here.

use std::fmt::Write;
use std::fs;
use std::path::Path;

use crc::{CRC_32_ISCSI, Crc};
use prost::{Message, Oneof};

use super::{Run, RunsError, known_s, title, write};

/// Version of the format, in the first event.
const VERSION: &str = "brain.Event:2";
/// End of the name of an event file that this program has written.
const OURS: &str = ".eupnea";
/// Tag of the text with the options.
const OPTIONS: &str = "options";
/// Number of the data type string.
const STRING: i32 = 7;

#[derive(Clone, PartialEq, Message)]
struct Event {
    /// Seconds since 1970.
    #[prost(double, tag = "1")]
    wall_time: f64,
    #[prost(int64, tag = "2")]
    step: i64,
    #[prost(oneof = "What", tags = "3, 5")]
    what: Option<What>,
}

#[derive(Clone, PartialEq, Oneof)]
enum What {
    #[prost(string, tag = "3")]
    FileVersion(String),
    #[prost(message, tag = "5")]
    Summary(Summary),
}

#[derive(Clone, PartialEq, Message)]
struct Summary {
    #[prost(message, repeated, tag = "1")]
    values: Vec<Value>,
}

#[derive(Clone, PartialEq, Message)]
struct Value {
    #[prost(string, tag = "1")]
    tag: String,
    #[prost(message, optional, tag = "9")]
    metadata: Option<Metadata>,
    #[prost(oneof = "Content", tags = "2, 8")]
    content: Option<Content>,
}

#[derive(Clone, PartialEq, Oneof)]
enum Content {
    #[prost(float, tag = "2")]
    Number(f32),
    #[prost(message, tag = "8")]
    Tensor(Tensor),
}

#[derive(Clone, PartialEq, Message)]
struct Metadata {
    #[prost(message, optional, tag = "1")]
    plugin: Option<Plugin>,
}

#[derive(Clone, PartialEq, Message)]
struct Plugin {
    #[prost(string, tag = "1")]
    name: String,
}

#[derive(Clone, PartialEq, Message)]
struct Tensor {
    #[prost(int32, tag = "1")]
    data_type: i32,
    #[prost(bytes = "vec", repeated, tag = "8")]
    strings: Vec<Vec<u8>>,
}

/// Writes an event file for each run. A run that was exported before is replaced.
///
/// # Errors
/// A file that cannot be written.
pub fn export(runs: &[Run], folder: &Path) -> Result<(), RunsError> {
    for run in runs {
        let folder = folder.join(title(run));
        remove_earlier(&folder)?;
        let file = format!("events.out.tfevents.{}.{}{OURS}", run.record.began_s, run.record.host);
        write(&folder.join(file), &events(run))?;
    }
    Ok(())
}

/// Removes earlier exports: the viewer would show their events as those of this run.
fn remove_earlier(folder: &Path) -> Result<(), RunsError> {
    let Ok(entries) = fs::read_dir(folder) else { return Ok(()) };
    for entry in entries.flatten().filter(|entry| entry.file_name().to_string_lossy().ends_with(OURS)) {
        let path = entry.path();
        fs::remove_file(&path).map_err(|source| RunsError::Write { path, source })?;
    }
    Ok(())
}

/// The bytes of a run's event file.
fn events(run: &Run) -> Vec<u8> {
    let wall_time = known_s(run) as f64;
    let mut file = Vec::new();
    let mut put = |step: u64, what: What| {
        let event = Event { wall_time, step: step as i64, what: Some(what) };
        frame(&event.encode_to_vec(), &mut file);
    };
    put(0, What::FileVersion(VERSION.to_owned()));
    put(
        0,
        summary(
            OPTIONS,
            Some("text"),
            Content::Tensor(Tensor { data_type: STRING, strings: vec![options(run).into_bytes()] }),
        ),
    );
    let number = |name: &str, value: f64| summary(name, None, Content::Number(value as f32));
    for (name, value) in &run.record.results.figures {
        put(0, number(name, *value));
    }
    for (name, curve) in &run.record.results.curves {
        for (step, value) in curve.points() {
            put(step, number(name, value));
        }
    }
    file
}

fn summary(tag: &str, plugin: Option<&str>, content: Content) -> What {
    let plugin = plugin.map(|name| Plugin { name: name.to_owned() });
    let metadata = plugin.map(|plugin| Metadata { plugin: Some(plugin) });
    What::Summary(Summary { values: vec![Value { tag: tag.to_owned(), metadata, content: Some(content) }] })
}

/// The options and the origin as a table in Markdown, which the viewer shows.
fn options(run: &Run) -> String {
    let record = &run.record;
    let mut text = "| option | value |\n|---|---|\n".to_owned();
    let origin = [
        ("command", format!("trainer {}", record.command.join(" "))),
        ("revision", record.revision.clone()),
        ("machine", run.place()),
    ];
    let options = record.options.iter().map(|(name, value)| (name.as_str(), value.clone()));
    for (name, value) in origin.into_iter().chain(options) {
        let _ = writeln!(text, "| {name} | {} |", value.replace('|', "\\|"));
    }
    text
}

/// Appends a record.
fn frame(bytes: &[u8], file: &mut Vec<u8>) {
    let length = (bytes.len() as u64).to_le_bytes();
    file.extend(length);
    file.extend(masked_sum(&length).to_le_bytes());
    file.extend(bytes);
    file.extend(masked_sum(bytes).to_le_bytes());
}

/// CRC-32C, masked because the sum of bytes that contain their own sum is a constant.
fn masked_sum(bytes: &[u8]) -> u32 {
    const SUM: Crc<u32> = Crc::<u32>::new(&CRC_32_ISCSI);
    SUM.checksum(bytes).rotate_right(15).wrapping_add(0xa282_ead8)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_record_has_the_bytes_that_tensorflow_writes() {
        let event = Event { wall_time: 1.0, step: 0, what: Some(What::FileVersion(VERSION.to_owned())) };
        let mut file = Vec::new();
        frame(&event.encode_to_vec(), &mut file);
        // Written by the RecordWriter of tensorboard 2.21.
        let expected = b"\x18\0\0\0\0\0\0\0\xa3\x7fK\"\t\0\0\0\0\0\0\xf0?\x1a\rbrain.Event:2\x86\xbfWz";
        assert_eq!(file, expected);
    }
}
