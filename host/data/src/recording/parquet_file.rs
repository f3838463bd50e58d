//! Recordings as Parquet files, readable by pandas and polars, with the provenance in the metadata.
//!
//! Equal recordings give equal bytes: no time stamp, no library version. A checksum over the whole file is verified
//! before anything is decoded, because Parquet decoders trust the bytes: damage gives other numbers or a panic.

use std::fs::File;
use std::io::{ErrorKind, Read, Seek};
use std::path::Path;
use std::sync::Arc;

use arrow_array::types::{Float32Type, UInt8Type, UInt32Type};
use arrow_array::{
    Array, ArrayRef, ArrowPrimitiveType, Float32Array, PrimitiveArray, RecordBatch, UInt8Array, UInt32Array,
};
use arrow_schema::{ArrowError, Field, Schema};
use parquet::arrow::ArrowWriter;
use parquet::arrow::arrow_reader::ParquetRecordBatchReaderBuilder;
use parquet::arrow::arrow_writer::ArrowWriterOptions;
use parquet::basic::Compression;
use parquet::file::metadata::KeyValue;
use parquet::file::properties::{DEFAULT_MAX_ROW_GROUP_ROW_COUNT, WriterProperties};

use super::checksum;
use super::columns::{Extra, Values, ValuesMut};
use super::{DatasetError, Recording};
use crate::files::write_atomically;
use crate::provenance::{FORMAT, Provenance};

/// Key of the provenance in the file's metadata.
pub const PROVENANCE_KEY: &str = "eupnea";

/// First and last bytes of every Parquet file.
const MAGIC: &[u8; 4] = b"PAR1";

impl Recording {
    /// Writes the recording, replacing an older file in one step.
    ///
    /// # Errors
    /// If the recording is not valid, cannot be encoded or cannot be written.
    pub fn save(&self, path: impl AsRef<Path>) -> Result<(), DatasetError> {
        let path = path.as_ref();
        self.validate()?;
        let encode = |detail: String| DatasetError::Encode { path: path.to_owned(), detail };
        let provenance = serde_json::to_string(&self.provenance).map_err(|e| encode(e.to_string()))?;
        let bytes = encode_columns(self, provenance).map_err(|e| encode(e.to_string()))?;
        write_atomically(path, &bytes).map_err(|source| DatasetError::Write { path: path.to_owned(), source })
    }

    /// Reads a recording and checks it. Columns that this program does not know are left out.
    ///
    /// # Errors
    /// One that names the file and what is wrong with it: absent, not Parquet, torn, a column missing or of the wrong
    /// type, no provenance, another format, or content that [`Self::validate`] refuses.
    pub fn load(path: impl AsRef<Path>) -> Result<Self, DatasetError> {
        let path = path.as_ref();
        let torn = |detail: String| DatasetError::Torn { path: path.to_owned(), detail };
        let file = open(path)?;
        let builder = ParquetRecordBatchReaderBuilder::try_new(file).map_err(|e| torn(e.to_string()))?;

        let metadata = builder.metadata().file_metadata().key_value_metadata();
        let metadata = metadata.map_or(&[][..], Vec::as_slice);
        let text = value(metadata, PROVENANCE_KEY)
            .ok_or_else(|| DatasetError::NoProvenance { path: path.to_owned() })?;
        let provenance = read_provenance(path, text)?;
        let schema = builder.schema().clone();
        let extras: Vec<_> =
            Extra::ALL.into_iter().filter(|extra| schema.index_of(extra.name()).is_ok()).collect();
        let mut recording = Self::with_extras(provenance, &extras);
        // An empty file has no batch to check against.
        fill(&mut recording, &RecordBatch::new_empty(schema), path)?;
        for batch in builder.build().map_err(|e| torn(e.to_string()))? {
            fill(&mut recording, &batch.map_err(|e| torn(e.to_string()))?, path)?;
        }
        recording
            .validate()
            .map_err(|source| DatasetError::Invalid { path: path.to_owned(), source: Box::new(source) })?;
        Ok(recording)
    }
}

/// The columns of a recording as one batch.
pub(super) fn batch(recording: &Recording) -> Result<RecordBatch, ArrowError> {
    let columns = recording.columns().into_iter().map(|(name, values)| {
        let array: ArrayRef = match values {
            Values::U8(values) => Arc::new(UInt8Array::from(values.to_vec())),
            Values::U32(values) => Arc::new(UInt32Array::from(values.to_vec())),
            Values::F32(values) => Arc::new(Float32Array::from(values.to_vec())),
        };
        (Field::new(name, array.data_type().clone(), false), array)
    });
    let (fields, arrays): (Vec<_>, Vec<_>) = columns.unzip();
    RecordBatch::try_new(Arc::new(Schema::new(fields)), arrays)
}

/// What stands in the metadata. The checksum is the last pair, so that no text within the provenance can be taken for it.
pub(super) fn metadata(provenance: String) -> Vec<KeyValue> {
    let pairs = [(PROVENANCE_KEY, provenance), (checksum::KEY, checksum::blank())];
    pairs.map(|(key, value)| KeyValue::new(key.to_owned(), value)).to_vec()
}

/// How files are written, with so many rows compressed together.
pub(super) fn options(metadata: Option<Vec<KeyValue>>, rows: usize) -> ArrowWriterOptions {
    let properties = WriterProperties::builder()
        .set_compression(Compression::SNAPPY)
        .set_created_by(PROVENANCE_KEY.to_owned())
        .set_key_value_metadata(metadata)
        .set_max_row_group_row_count(Some(rows))
        .build();
    // The Parquet types say all there is to say; a second schema would only tie the bytes to the arrow version.
    ArrowWriterOptions::new().with_properties(properties).with_skip_arrow_metadata(true)
}

fn encode_columns(recording: &Recording, provenance: String) -> Result<Vec<u8>, ArrowError> {
    let batch = batch(recording)?;
    let options = options(Some(metadata(provenance)), DEFAULT_MAX_ROW_GROUP_ROW_COUNT);
    let mut writer = ArrowWriter::try_new_with_options(Vec::new(), batch.schema(), options)?;
    writer.write(&batch)?;
    Ok(checksum::seal(writer.into_inner()?))
}

/// Opens the file, tells the common mistakes apart, which a Parquet decoder would report alike, and verifies the bytes.
fn open(path: &Path) -> Result<File, DatasetError> {
    let read = |source: std::io::Error| match source.kind() {
        ErrorKind::NotFound => DatasetError::Missing { path: path.to_owned() },
        _ => DatasetError::Read { path: path.to_owned(), source },
    };
    let torn = |detail: String| DatasetError::Torn { path: path.to_owned(), detail };
    let mut file = File::open(path).map_err(read)?;
    let mut bytes = Vec::new();
    file.read_to_end(&mut bytes).map_err(read)?;
    if bytes.len() >= MAGIC.len() && !bytes.starts_with(MAGIC) {
        return Err(DatasetError::NotParquet { path: path.to_owned() });
    }
    // Twelve bytes are the two magics and the footer's length.
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

/// Appends the rows of one batch to the columns of the recording.
fn fill(recording: &mut Recording, batch: &RecordBatch, path: &Path) -> Result<(), DatasetError> {
    for (name, values) in recording.columns_mut() {
        let Some(array) = batch.column_by_name(name) else {
            return Err(DatasetError::MissingColumn { path: path.to_owned(), column: name });
        };
        match values {
            ValuesMut::U8(values) => {
                values.extend_from_slice(primitive::<UInt8Type>(array, name, path)?.values());
            }
            ValuesMut::U32(values) => {
                values.extend_from_slice(primitive::<UInt32Type>(array, name, path)?.values());
            }
            ValuesMut::F32(values) => {
                values.extend_from_slice(primitive::<Float32Type>(array, name, path)?.values());
            }
        }
    }
    Ok(())
}

fn primitive<'a, T: ArrowPrimitiveType>(
    array: &'a ArrayRef,
    column: &'static str,
    path: &Path,
) -> Result<&'a PrimitiveArray<T>, DatasetError> {
    if array.null_count() > 0 {
        return Err(DatasetError::Null { path: path.to_owned(), column, nulls: array.null_count() });
    }
    array.as_any().downcast_ref().ok_or_else(|| DatasetError::WrongType {
        path: path.to_owned(),
        column,
        expected: T::DATA_TYPE.to_string(),
        found: array.data_type().to_string(),
    })
}
