//! MCAP files, which Foxglove and `PlotJuggler` plot without a plug-in: JSON messages with a JSON schema for
//! each channel, in indexed chunks, with statistics and the origin as a metadata record.
//!
//! A number is written with the fewest digits that give back its bits.

use std::collections::BTreeMap;
use std::fs::{self, File};
use std::io::{BufWriter, ErrorKind, Seek, Write};
use std::path::{Path, PathBuf};

use ::mcap::records::{MessageHeader, Metadata};
use ::mcap::{Compression, WriteOptions, Writer};
use serde::Serialize;
use serde_json::{Value, json};

use super::{ExportError, times_us};
use crate::files::write_streamed;
use crate::provenance::Provenance;
use crate::recording::{PHASE_NAMES, Recording, Row};

/// Name of the metadata record with the origin.
pub const ORIGIN: &str = "eupnea";
/// Messages that are compressed and indexed together, bytes: a second or two of 1 kHz.
pub(super) const CHUNK_BYTES: u64 = 1 << 19;

/// A field of a message: name, type as in JSON schema, description with the unit.
pub type Field = (&'static str, &'static str, &'static str);

/// A kind of message, which has a channel of its own.
pub trait Message: Serialize {
    /// The channel, such as `/pressure`.
    const TOPIC: &'static str;
    /// Name of the schema.
    const SCHEMA: &'static str;
    /// The fields, as `Serialize` writes them. A field that is not known, or a number that is not finite, is left out of a message:
    /// JSON has no NaN, and a null would not be of the type in the schema.
    const FIELDS: &'static [Field];
}

/// Airway pressure of a tick, cmH2O.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Pressure {
    /// Measured; NaN if there is no reading.
    #[serde(skip_serializing_if = "is_unknown")]
    pub measured: f32,
    /// Target.
    #[serde(skip_serializing_if = "is_unknown")]
    pub target: f32,
    /// True pressure, where the plant reports it.
    #[serde(rename = "true", skip_serializing_if = "is_missing")]
    pub truth: Option<f32>,
}

impl Message for Pressure {
    const TOPIC: &'static str = "/pressure";
    const SCHEMA: &'static str = "eupnea.Pressure";
    const FIELDS: &'static [Field] = &[
        ("measured", "number", "measured airway pressure, cmH2O"),
        ("target", "number", "target pressure, cmH2O"),
        ("true", "number", "true airway pressure, cmH2O; only where the plant reports it"),
    ];
}

/// Valve commands of a tick, percent.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Valves {
    /// Inspiratory valve.
    #[serde(skip_serializing_if = "is_unknown")]
    pub u_in: f32,
    /// Expiratory valve, percent open.
    #[serde(skip_serializing_if = "is_unknown")]
    pub u_out: f32,
    /// Part of `u_in` that exploration added.
    #[serde(skip_serializing_if = "is_unknown")]
    pub explore: f32,
    /// Learned part of the controller's command before the safety filter, if it is known.
    #[serde(skip_serializing_if = "is_missing")]
    pub learned: Option<f32>,
}

impl Message for Valves {
    const TOPIC: &'static str = "/valves";
    const SCHEMA: &'static str = "eupnea.Valves";
    const FIELDS: &'static [Field] = &[
        ("u_in", "number", "command of the inspiratory valve as applied, percent"),
        ("u_out", "number", "expiratory valve, percent open"),
        ("explore", "number", "part of u_in that exploration added, percent"),
        ("learned", "number", "learned part of the controller's command before the safety filter, percent"),
    ];
}

/// Flows of a tick, L/s.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Flow {
    /// Into the circuit.
    #[serde(rename = "in", skip_serializing_if = "is_missing")]
    pub inward: Option<f32>,
    /// Out of the circuit.
    #[serde(rename = "out", skip_serializing_if = "is_missing")]
    pub outward: Option<f32>,
    /// Towards the patient, as the flow sensor of the device reads it.
    #[serde(skip_serializing_if = "is_missing")]
    pub patient: Option<f32>,
}

impl Message for Flow {
    const TOPIC: &'static str = "/flow";
    const SCHEMA: &'static str = "eupnea.Flow";
    const FIELDS: &'static [Field] = &[
        ("in", "number", "flow into the circuit, L/s"),
        ("out", "number", "flow out of the circuit, L/s"),
        ("patient", "number", "flow towards the patient as the flow sensor reads it, L/s"),
    ];
}

/// The position of a tick in the sequence of breaths.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct BreathPosition {
    /// Number of the breath.
    pub number: u32,
    /// Phase: 0 inspiration, 1 fall, 2 expiration.
    pub phase: u8,
    /// Name of the phase.
    pub phase_name: &'static str,
    /// Control ticks since the start of the breath.
    pub tick: u32,
}

impl BreathPosition {
    /// The position of a tick, with the phase numbered as in a recording.
    pub fn new(number: u32, phase: u8, tick: u32) -> Self {
        Self { number, phase, phase_name: PHASE_NAMES.get(usize::from(phase)).unwrap_or(&""), tick }
    }
}

impl Message for BreathPosition {
    const TOPIC: &'static str = "/breath";
    const SCHEMA: &'static str = "eupnea.Breath";
    const FIELDS: &'static [Field] = &[
        ("number", "integer", "number of the breath"),
        ("phase", "integer", "0 inspiration, 1 fall, 2 expiration"),
        ("phase_name", "string", "name of the phase"),
        ("tick", "integer", "control ticks since the start of the breath"),
    ];
}

/// Whether a number is left out of a message because it is not finite.
pub fn is_unknown(value: &f32) -> bool {
    !value.is_finite()
}

/// Whether a number is left out of a message because it is missing or not finite.
pub fn is_missing(value: &Option<f32>) -> bool {
    value.as_ref().is_none_or(is_unknown)
}

/// Number of the messages of each topic.
pub type Counts = BTreeMap<&'static str, u64>;

/// An MCAP file that is being written. A dropped writer finishes the file, but reports no error.
#[expect(missing_debug_implementations, reason = "the library's writer has none")]
pub struct McapWriter<W: Write + Seek> {
    path: PathBuf,
    writer: Writer<W>,
    channels: BTreeMap<&'static str, u16>,
    counts: Counts,
    /// The message that is being written.
    text: Vec<u8>,
}

impl McapWriter<BufWriter<File>> {
    /// Starts a new file for messages that arrive over hours. Missing parent folders are created.
    ///
    /// # Errors
    /// A file of that name exists, or it cannot be created.
    pub fn capture(path: &Path) -> Result<Self, ExportError> {
        let folder = path.parent().map_or(Ok(()), fs::create_dir_all);
        let file = folder.and_then(|()| File::create_new(path)).map_err(|source| match source.kind() {
            ErrorKind::AlreadyExists => ExportError::Exists(path.to_owned()),
            _ => ExportError::Write { path: path.to_owned(), source },
        })?;
        Self::new(path, BufWriter::new(file))
    }
}

impl<W: Write + Seek> McapWriter<W> {
    /// Starts a file; `path` is its name in errors.
    ///
    /// # Errors
    /// `to` cannot be written.
    pub fn new(path: &Path, to: W) -> Result<Self, ExportError> {
        let options = WriteOptions::new()
            .chunk_size(Some(CHUNK_BYTES))
            // A chunk reaches the file when it is whole: a killed program leaves no header without a length.
            .disable_seeking(true)
            .compression(Some(Compression::Lz4))
            .library(format!("eupnea {}", env!("CARGO_PKG_VERSION")));
        let writer = options.create(to).map_err(|error| encode(path, &error))?;
        let path = path.to_owned();
        Ok(Self { path, writer, channels: BTreeMap::new(), counts: Counts::new(), text: Vec::new() })
    }

    /// Writes the metadata record [`ORIGIN`]: a text for each field of a JSON object.
    ///
    /// # Errors
    /// The file cannot be written.
    pub fn origin(&mut self, origin: &Value) -> Result<(), ExportError> {
        let text = |value: &Value| value.as_str().map_or_else(|| value.to_string(), str::to_owned);
        let fields = origin.as_object().into_iter().flatten();
        let metadata = fields.map(|(name, value)| (name.clone(), text(value))).collect();
        let record = Metadata { name: ORIGIN.to_owned(), metadata };
        self.writer.write_metadata(&record).map_err(|error| encode(&self.path, &error))
    }

    /// Writes a message of this time, ns from any origin.
    ///
    /// # Errors
    /// The file cannot be written.
    pub fn write<M: Message>(&mut self, time_ns: u64, message: &M) -> Result<(), ExportError> {
        let channel_id = self.channel::<M>()?;
        let count = self.counts.entry(M::TOPIC).or_default();
        // The standard's sequence numbers wrap.
        let sequence = *count as u32;
        *count += 1;
        self.text.clear();
        serde_json::to_writer(&mut self.text, message).map_err(|error| encode(&self.path, &error))?;
        let header = MessageHeader { channel_id, sequence, log_time: time_ns, publish_time: time_ns };
        self.writer.write_to_known_channel(&header, &self.text).map_err(|error| encode(&self.path, &error))
    }

    /// The channel of a kind of message, which its first message opens.
    fn channel<M: Message>(&mut self) -> Result<u16, ExportError> {
        if let Some(id) = self.channels.get(M::TOPIC) {
            return Ok(*id);
        }
        let schema = schema::<M>().to_string();
        let id = self
            .writer
            .add_schema(M::SCHEMA, "jsonschema", schema.as_bytes())
            .and_then(|id| self.writer.add_channel(id, M::TOPIC, "json", &BTreeMap::new()))
            .map_err(|error| encode(&self.path, &error))?;
        self.channels.insert(M::TOPIC, id);
        Ok(id)
    }

    /// Passes everything so far to the operating system as a whole chunk. If the program is killed later, a
    /// reader finds it all.
    ///
    /// # Errors
    /// The file cannot be written.
    pub fn flush(&mut self) -> Result<(), ExportError> {
        self.writer.flush().map_err(|error| encode(&self.path, &error))
    }

    /// Writes index and statistics; returns the destination and the number of messages.
    ///
    /// # Errors
    /// The file cannot be written.
    pub fn finish(mut self) -> Result<(W, Counts), ExportError> {
        self.writer.finish().map_err(|error| encode(&self.path, &error))?;
        Ok((self.writer.into_inner(), self.counts))
    }
}

/// The JSON schema of a kind of message.
fn schema<M: Message>() -> Value {
    let property = |(name, kind, description): &Field| {
        ((*name).to_owned(), json!({ "type": kind, "description": description }))
    };
    let properties: serde_json::Map<_, _> = M::FIELDS.iter().map(property).collect();
    json!({ "title": M::SCHEMA, "type": "object", "properties": properties })
}

fn encode(path: &Path, error: &dyn std::fmt::Display) -> ExportError {
    ExportError::Encode { path: path.to_owned(), detail: error.to_string() }
}

/// Writes a recording, atomically replacing an existing file; returns the number of messages of each topic.
/// Equal recordings give equal bytes: times count from the first breath's start.
///
/// # Errors
/// A recording without a row, or a file that cannot be written.
pub fn save(recording: &Recording, path: &Path) -> Result<Counts, ExportError> {
    if recording.is_empty() {
        return Err(ExportError::Empty);
    }
    let mut counts = Counts::new();
    let written = |to: &mut BufWriter<File>| {
        counts = write(recording, path, to)?;
        Ok(())
    };
    write_streamed(path, written, |source| ExportError::Write { path: path.to_owned(), source })?;
    Ok(counts)
}

fn write<W: Write + Seek>(recording: &Recording, path: &Path, to: W) -> Result<Counts, ExportError> {
    let mut writer = McapWriter::new(path, to)?;
    writer.origin(&origin(&recording.provenance))?;
    let rows = (0..recording.len()).filter_map(|row| recording.row(row));
    for (row, time_us) in rows.zip(times_us(recording)) {
        write_row(&mut writer, time_us * 1000, &row)?;
    }
    Ok(writer.finish()?.1)
}

fn write_row<W: Write + Seek>(
    writer: &mut McapWriter<W>,
    time_ns: u64,
    row: &Row,
) -> Result<(), ExportError> {
    let Row { u_in, u_out, explore, .. } = *row;
    let pressure = Pressure { measured: row.pressure, target: row.target, truth: row.pressure_true };
    writer.write(time_ns, &pressure)?;
    writer.write(time_ns, &Valves { u_in, u_out, explore, learned: None })?;
    if row.flow_in.is_some() || row.flow_out.is_some() {
        writer.write(time_ns, &Flow { inward: row.flow_in, outward: row.flow_out, patient: None })?;
    }
    writer.write(time_ns, &BreathPosition::new(row.breath, row.phase, row.tick))
}

/// The origin of a recording; JSON cannot fail to hold it.
fn origin(provenance: &Provenance) -> Value {
    serde_json::to_value(provenance).unwrap_or_default()
}
