//! Recordings as Parquet files, readable by pandas and polars, with the provenance in the metadata.
//!
//! Equal recordings give equal bytes: no time stamp, no library version. A checksum over the whole file is verified
//! before decoding, because Parquet decoders trust the bytes: damage would give wrong numbers or a panic.

use std::fs::File;
use std::io::{ErrorKind, Read, Seek, Write};
use std::path::Path;
use std::sync::Arc;

use parquet::basic::{Compression, LogicalType, Repetition, Type as Physical};
use parquet::column::reader::{ColumnReader, ColumnReaderImpl};
use parquet::data_type::{DataType, FloatType, Int32Type};
use parquet::errors::ParquetError;
use parquet::file::metadata::KeyValue;
use parquet::file::properties::WriterProperties;
use parquet::file::reader::{FileReader, SerializedFileReader};
use parquet::file::writer::SerializedFileWriter;
use parquet::schema::types::{ColumnDescriptor, Type};

use super::checksum;
use super::columns::{Extra, Number, Values, ValuesMut};
use super::{DatasetError, Recording};
use crate::provenance::{FORMAT, Provenance};

/// Key of the provenance in the file's metadata.
pub const PROVENANCE_KEY: &str = "eupnea";

/// First and last bytes of every Parquet file.
const MAGIC: &[u8; 4] = b"PAR1";
/// Number of rows that are encoded and compressed together.
pub(super) const GROUP_ROWS: usize = 1 << 18;

impl Recording {
    /// Reads and checks a recording. Unknown columns are ignored.
    ///
    /// # Errors
    /// An error that names the file and the problem: missing, not Parquet, incomplete, a column missing or of the wrong
    /// type, no provenance, another format, or content that violates [`Self::validate`].
    pub fn load(path: impl AsRef<Path>) -> Result<Self, DatasetError> {
        let path = path.as_ref();
        let torn = |detail: String| DatasetError::Torn { path: path.to_owned(), detail };
        let file = open(path)?;
        let reader = SerializedFileReader::new(file).map_err(|e| torn(e.to_string()))?;
        let about = reader.metadata().file_metadata();
        let metadata = about.key_value_metadata().map_or(&[][..], Vec::as_slice);
        let text =
            value(metadata, PROVENANCE_KEY).ok_or_else(|| DatasetError::NoProvenance(path.to_owned()))?;
        let provenance = read_provenance(path, text)?;
        let found = about.schema_descr().columns();
        let index = |name: &str| found.iter().position(|column| column.name() == name);
        let extras: Vec<_> = Extra::ALL.into_iter().filter(|extra| index(extra.name()).is_some()).collect();
        let mut recording = Self::with_extras(provenance, &extras);
        for (column, values) in recording.columns_mut() {
            let place =
                index(column).ok_or_else(|| DatasetError::MissingColumn { path: path.to_owned(), column })?;
            check_type(&found[place], values.number(), column, path)?;
            let nulls = fill(&reader, place, values).map_err(|e| torn(e.to_string()))?;
            if nulls > 0 {
                return Err(DatasetError::Null { path: path.to_owned(), column, nulls });
            }
        }
        recording
            .validate()
            .map_err(|source| DatasetError::Invalid { path: path.to_owned(), source: Box::new(source) })?;
        Ok(recording)
    }
}

/// The metadata. The checksum is the last pair, so that no text within the provenance can be mistaken for it.
pub(super) fn metadata(provenance: String) -> Vec<KeyValue> {
    let pairs = [(PROVENANCE_KEY, provenance), (checksum::KEY, checksum::blank())];
    pairs.map(|(key, value)| KeyValue::new(key.to_owned(), value)).to_vec()
}

/// A writer of files with the columns of this recording.
pub(super) fn writer<W: Write + Send>(
    to: W,
    recording: &Recording,
) -> Result<SerializedFileWriter<W>, ParquetError> {
    let fields = recording.columns().into_iter().map(|(name, values)| {
        let (physical, logical) = types(values.number());
        let builder = Type::primitive_type_builder(name, physical).with_logical_type(logical);
        builder.with_repetition(Repetition::REQUIRED).build().map(Arc::new)
    });
    let fields = fields.collect::<Result<_, _>>()?;
    let schema = Type::group_type_builder("recording").with_fields(fields).build()?;
    let properties = WriterProperties::builder()
        .set_compression(Compression::SNAPPY)
        .set_created_by(PROVENANCE_KEY.to_owned())
        .build();
    SerializedFileWriter::new(to, Arc::new(schema), Arc::new(properties))
}

/// Writes all rows of a recording, in groups of [`GROUP_ROWS`].
pub(super) fn write_rows<W: Write + Send>(
    writer: &mut SerializedFileWriter<W>,
    recording: &Recording,
) -> Result<(), ParquetError> {
    for start in (0..recording.len()).step_by(GROUP_ROWS) {
        let rows = start..(start + GROUP_ROWS).min(recording.len());
        let mut group = writer.next_row_group()?;
        for (_, values) in recording.columns() {
            let Some(mut column) = group.next_column()? else { break };
            match values {
                Values::U8(values) => {
                    let values: Vec<i32> = values[rows.clone()].iter().map(|value| (*value).into()).collect();
                    column.typed::<Int32Type>().write_batch(&values, None, None)?;
                }
                Values::U32(values) => {
                    let values: Vec<i32> = values[rows.clone()].iter().map(|value| *value as i32).collect();
                    column.typed::<Int32Type>().write_batch(&values, None, None)?;
                }
                Values::F32(values) => {
                    column.typed::<FloatType>().write_batch(&values[rows.clone()], None, None)?;
                }
            }
            column.close()?;
        }
        group.close()?;
    }
    Ok(())
}

/// Opens the file, distinguishes common mistakes that a Parquet decoder would report alike, and verifies the bytes.
fn open(path: &Path) -> Result<File, DatasetError> {
    let read = |source: std::io::Error| match source.kind() {
        ErrorKind::NotFound => DatasetError::Missing(path.to_owned()),
        _ => DatasetError::Read { path: path.to_owned(), source },
    };
    let torn = |detail: String| DatasetError::Torn { path: path.to_owned(), detail };
    let mut file = File::open(path).map_err(read)?;
    let mut bytes = Vec::new();
    file.read_to_end(&mut bytes).map_err(read)?;
    if bytes.len() >= MAGIC.len() && !bytes.starts_with(MAGIC) {
        return Err(DatasetError::NotParquet(path.to_owned()));
    }
    // The two magics and the footer's length take twelve bytes.
    if bytes.len() < 12 || !bytes.ends_with(MAGIC) {
        return Err(torn(format!("it ends after {} bytes", bytes.len())));
    }
    if !checksum::matches(&mut bytes) {
        return Err(torn(format!(
            "its checksum does not match; a program that rewrites it must drop the metadata key {}",
            checksum::KEY
        )));
    }
    file.rewind().map_err(read)?;
    Ok(file)
}

fn value<'a>(metadata: &'a [KeyValue], key: &str) -> Option<&'a str> {
    metadata.iter().find(|pair| pair.key == key)?.value.as_deref()
}

fn read_provenance(path: &Path, text: &str) -> Result<Provenance, DatasetError> {
    let provenance: Provenance = serde_json::from_str(text)
        .map_err(|source| DatasetError::BadProvenance { path: path.to_owned(), source })?;
    if provenance.format != FORMAT {
        let found = provenance.format;
        return Err(DatasetError::Format { path: path.to_owned(), found, expected: FORMAT });
    }
    Ok(provenance)
}

/// Parquet types of a column's numbers.
fn types(number: Number) -> (Physical, Option<LogicalType>) {
    match number {
        Number::U8 => (Physical::INT32, Some(LogicalType::integer(8, false))),
        Number::U32 => (Physical::INT32, Some(LogicalType::integer(32, false))),
        Number::F32 => (Physical::FLOAT, None),
    }
}

/// Refuses a column whose numbers are not of type `expected`.
fn check_type(
    found: &ColumnDescriptor,
    expected: Number,
    column: &'static str,
    path: &Path,
) -> Result<(), DatasetError> {
    let found = (found.physical_type(), found.logical_type_ref().cloned());
    if found == types(expected) {
        return Ok(());
    }
    let known = [Number::U8, Number::U32, Number::F32].into_iter().find(|number| types(*number) == found);
    Err(DatasetError::WrongType {
        path: path.to_owned(),
        column,
        expected: expected.to_string(),
        found: known.map_or_else(|| found.0.to_string(), |number| number.to_string()),
    })
}

/// Appends a column of the file, whose type has been checked; returns the number of empty cells.
fn fill(
    reader: &SerializedFileReader<File>,
    place: usize,
    mut values: ValuesMut<'_>,
) -> Result<usize, ParquetError> {
    let mut nulls = 0;
    for group in 0..reader.num_row_groups() {
        let group = reader.get_row_group(group)?;
        let rows = usize::try_from(group.metadata().num_rows()).unwrap_or_default();
        nulls += match (&mut values, group.get_column_reader(place)?) {
            (ValuesMut::U8(values), ColumnReader::Int32ColumnReader(column)) => {
                read(column, rows, |value| values.push(value as u8))?
            }
            (ValuesMut::U32(values), ColumnReader::Int32ColumnReader(column)) => {
                read(column, rows, |value| values.push(value as u32))?
            }
            (ValuesMut::F32(values), ColumnReader::FloatColumnReader(column)) => {
                read(column, rows, |value| values.push(value))?
            }
            _ => return Err(ParquetError::General("a column changes its type".to_owned())),
        };
    }
    Ok(nulls)
}

/// Passes on each value of a group's column; returns the number of empty cells.
fn read<T: DataType>(
    mut column: ColumnReaderImpl<T>,
    rows: usize,
    each: impl FnMut(T::T),
) -> Result<usize, ParquetError> {
    let (mut values, mut levels, mut done) = (Vec::with_capacity(rows), Vec::new(), 0);
    while done < rows {
        match column.read_records(rows - done, Some(&mut levels), None, &mut values)? {
            (0, ..) => return Err(ParquetError::General(format!("only {done} of {rows} rows are present"))),
            (records, ..) => done += records,
        }
    }
    let nulls = rows.saturating_sub(values.len());
    values.into_iter().for_each(each);
    Ok(nulls)
}
