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
/// Highest speed of the blower in the firmware's unit; version 1 counts in tens of it, version 2 in hundreds.
const HIGHEST_SPEED: f64 = 1800.0;
/// Centilitres per minute in a litre per second.
const CENTILITRES_PER_MINUTE: f64 = 6000.0;
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

/// What a message about pressures and valves tells. Recordings have all of it but the speed of the blower.
#[derive(Debug, Clone, Copy)]
pub struct Telemetry {
    /// Time of the device, s.
    pub time_s: f64,
    /// Whether it is an inspiration.
    pub inspires: bool,
    /// Pressure, cmH2O.
    pub pressure: f64,
    /// Commanded position of the blower's valve, percent open.
    pub u_in: f64,
    /// Commanded position of the patient valve, percent open.
    pub u_out: f64,
    /// Commanded speed of the blower, as a share of the highest.
    pub speed: f64,
    /// Flows to and from the patient, L/s; the first version knows none.
    pub flows: Option<[f64; 2]>,
}

impl Telemetry {
    fn of(message: &Message) -> Option<Self> {
        let open = |degrees: u64| 100.0 * (1.0 - (degrees as f64 / CLOSED).min(1.0));
        // Version 1 adds the sub-phase.
        let phase = message.number(15, 1)? as u8;
        let flowing = message.version() > 1;
        let per_second = |at| Some(message.signed(at)? / CENTILITRES_PER_MINUTE);
        Some(Self {
            time_s: message.number(0, 8)? as f64 * 1e-6,
            inspires: phase >> 4 == INSPIRATION,
            pressure: message.signed(12)? * 0.1,
            u_in: open(message.number(17, 1)?),
            u_out: open(message.number(19, 1)?),
            speed: message.number(21, 1)? as f64 * if flowing { 100.0 } else { 10.0 } / HIGHEST_SPEED,
            flows: if flowing { Some([per_second(25)?, per_second(28)?]) } else { None },
        })
    }
}

/// All that the record at `path` tells about pressures, valves and blower, for tests that replay its commands.
///
/// # Errors
/// A file that cannot be read.
pub fn telemetry(path: &Path) -> Result<Vec<Telemetry>, DatasetError> {
    let mut lines = Lines::open(path)?;
    let mut all = Vec::new();
    while let Some(line) = lines.next()? {
        let message = decoded(line).filter(|message| message.kind() == 'D');
        all.extend(message.as_ref().and_then(Telemetry::of));
    }
    Ok(all)
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
        let told = Telemetry::of(message)?;
        let inspires = told.inspires;
        let mut row = TableRow { fields: [0.0; QUANTITIES], next_breath: false, inspires, group: 0 };
        row.set(Quantity::Time, told.time_s);
        row.set(Quantity::Pressure, told.pressure);
        row.set(Quantity::Target, if inspires { self.set.plateau } else { self.set.peep });
        row.set(Quantity::UIn, told.u_in);
        row.set(Quantity::UOut, told.u_out);
        if let Some([inward, outward]) = told.flows {
            row.set(Quantity::FlowIn, inward);
            row.set(Quantity::FlowOut, outward);
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
