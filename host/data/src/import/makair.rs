//! Telemetry of the `MakAir` ventilator, versions 1 and 2: a message in each line, in base64, with a checksum.
//!
//! A message is two bytes, a letter for its kind, `:` and the version, the name of the firmware with its length before it, 12 bytes of the
//! device, and fields that a tab precedes: a line feed, the CRC-32 of all that lies between, and two bytes end it. Numbers are big-endian.
//! As described at <https://github.com/makers-for-life/makair-telemetry> (public domain).

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use crc::{CRC_32_ISO_HDLC, Crc};

use super::lines::Lines;
use super::map::{EndBy, QUANTITIES, Quantity, StartBy, TableLayout};
use super::rows::{RowSource, TableRow};
use crate::identity::TestRun;
use crate::recording::DatasetError;

/// What every message begins with.
const BEGIN: [u8; 2] = [0x03, 0x0c];
/// Length of a device's number.
const DEVICE: usize = 12;
/// Bytes after the fields: a line feed, the checksum, and the end.
const TAIL: usize = 7;
/// Position of a closed valve, degrees.
const CLOSED: f64 = 125.0;
/// Phase of an inspiration, without the sub-phase.
const INSPIRATION: u8 = 1;
/// Note of the recordings.
const COMMANDS: &str =
    "MakAir: u_in is the position of the blower's valve, u_out that of the patient valve, percent open";
const CHECKSUM: Crc<u32> = Crc::<u32>::new(&CRC_32_ISO_HDLC);
/// Name of lines that are no message.
const DAMAGED: &str = "damaged lines";

/// What records have, of which the first version knows no flow.
pub(super) fn layout(surveys: &[Survey]) -> TableLayout {
    let flows = surveys.iter().all(|survey| survey.version > 1);
    let has = |quantity| match quantity {
        Quantity::FlowIn | Quantity::FlowOut => flows,
        Quantity::Resistance | Quantity::Compliance | Quantity::UPsol => false,
        _ => true,
    };
    TableLayout {
        start: StartBy::Number,
        end: EndBy::Phase,
        ..TableLayout::of_format("MakAir", COMMANDS, has)
    }
}

/// Whether a line is a message.
pub(super) fn is_message(line: &[u8]) -> bool {
    decoded(line).is_some()
}

/// A message.
struct Message {
    bytes: Vec<u8>,
    /// Where its fields begin.
    fields: usize,
}

/// The message in a line, if its checksum is right.
fn decoded(line: &[u8]) -> Option<Message> {
    let bytes = STANDARD.decode(line).ok()?;
    let end = bytes.len().checked_sub(TAIL)?;
    let fields = 6 + usize::from(*bytes.get(5)?) + DEVICE;
    let sum = u32::from_be_bytes(bytes[end + 1..end + 5].try_into().ok()?);
    let sound = bytes.starts_with(&BEGIN) && fields <= end && CHECKSUM.checksum(&bytes[2..=end]) == sum;
    sound.then_some(Message { bytes, fields })
}

impl Message {
    fn kind(&self) -> char {
        char::from(self.bytes[2])
    }

    fn version(&self) -> u8 {
        self.bytes[4]
    }

    /// The big-endian number of so many bytes, which a tab precedes; `at` is where the tab is, after the device.
    fn number(&self, at: usize, bytes: usize) -> Option<u64> {
        let begin = self.fields + at;
        let field = self.bytes.get(begin..=begin + bytes)?;
        (field[0] == b'\t').then(|| field[1..].iter().fold(0, |number, byte| number << 8 | u64::from(*byte)))
    }

    /// A number of two bytes with its sign.
    fn signed(&self, at: usize) -> Option<f64> {
        Some(f64::from(self.number(at, 2)? as u16 as i16))
    }
}

/// The settings of the breath, cmH2O.
#[derive(Debug, Clone, Copy)]
struct Set {
    plateau: f64,
    peep: f64,
}

/// What a record begins with.
#[derive(Debug, Clone, Copy)]
pub(super) struct Survey {
    version: u8,
    /// The settings of the first breath, which come after it.
    set: Set,
}

/// The rows of a record.
pub(super) struct MakairRows {
    lines: Lines,
    /// The latest settings.
    set: Set,
    inspires: Option<bool>,
    unused: BTreeMap<String, usize>,
}

impl MakairRows {
    pub(super) fn open(path: &Path, survey: &Survey) -> Result<Self, DatasetError> {
        let lines = Lines::open(path)?;
        Ok(Self { lines, set: survey.set, inspires: None, unused: BTreeMap::new() })
    }

    /// The row in a message about pressures and valves.
    fn row(&mut self, message: &Message) -> Option<TableRow> {
        let time = message.number(0, 8)? as f64 * 1e-6;
        let phase = message.number(15, 1)? as u8;
        // Version 1 adds the sub-phase.
        let inspires = phase >> 4 == INSPIRATION;
        let mut row = TableRow { fields: [0.0; QUANTITIES], next_breath: false, inspires, group: 0 };
        row.set(Quantity::Time, time);
        row.set(Quantity::Pressure, message.signed(12)? * 0.1);
        row.set(Quantity::Target, if inspires { self.set.plateau } else { self.set.peep });
        let open = |degrees: u64| 100.0 * (1.0 - (degrees as f64 / CLOSED).min(1.0));
        row.set(Quantity::UIn, open(message.number(17, 1)?));
        row.set(Quantity::UOut, open(message.number(19, 1)?));
        if message.version() > 1 {
            let per_second = |centilitres: f64| centilitres / (100.0 * 60.0);
            row.set(Quantity::FlowIn, per_second(message.signed(25)?));
            row.set(Quantity::FlowOut, per_second(message.signed(28)?));
        }
        row.next_breath = self.inspires.replace(inspires) == Some(false) && inspires;
        Some(row)
    }

    /// The next line that is a message; counts the others.
    fn message(&mut self) -> Result<Option<Message>, DatasetError> {
        while let Some(line) = self.lines.next()? {
            match decoded(line) {
                Some(message) => return Ok(Some(message)),
                None => *self.unused.entry(DAMAGED.to_owned()).or_default() += 1,
            }
        }
        Ok(None)
    }
}

/// Plateau and PEEP that a message about the state sets, if it is one: after the time, the number of the breath and the peak.
fn settings(message: &Message) -> Option<Set> {
    if message.kind() != 'S' {
        return None;
    }
    let [plateau, peep] = [message.number(16, 1)?, message.number(18, 1)?];
    Some(Set { plateau: plateau as f64, peep: peep as f64 })
}

/// Reads records up to their first settings.
///
/// # Errors
/// A file that cannot be read, or has no settings.
pub(super) fn survey(paths: &[PathBuf]) -> Result<Vec<Survey>, DatasetError> {
    let first = |path: &PathBuf| {
        let mut lines = Lines::open(path)?;
        while let Some(line) = lines.next()? {
            let found = decoded(line).and_then(|message| Some((message.version(), settings(&message)?)));
            if let Some((version, set)) = found {
                return Ok(Survey { version, set });
            }
        }
        let reason = "has no message of a MakAir that tells the settings of a breath";
        Err(DatasetError::NoTable { path: path.clone(), reason })
    };
    paths.iter().map(first).collect()
}

impl RowSource for MakairRows {
    fn next(&mut self, groups: &mut Vec<TestRun>) -> Result<Option<TableRow>, DatasetError> {
        let group = self.lines.group(groups);
        while let Some(message) = self.message()? {
            if let Some(set) = settings(&message) {
                self.set = set;
            }
            let kind = message.kind();
            let row = if kind == 'D' { self.row(&message) } else { None };
            if let Some(row) = row {
                return Ok(Some(TableRow { group, ..row }));
            }
            let name = match kind {
                'A' => "alarms",
                'B' => "starts of the program",
                'O' => "messages of standby",
                'S' => "settings",
                'T' => "alarms in force",
                _ => DAMAGED,
            };
            *self.unused.entry(name.to_owned()).or_default() += 1;
        }
        Ok(None)
    }

    fn position(&self) -> u64 {
        self.lines.position()
    }

    fn unused(&self) -> BTreeMap<String, usize> {
        self.unused.clone()
    }
}
