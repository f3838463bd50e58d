//! The text of a table: unpacked, and in UTF-8 where the file says that it is not.

use std::fs::File;
use std::io::{self, ErrorKind, Read, Seek};
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use encoding_rs::{Encoding, UTF_16BE, UTF_16LE, WINDOWS_1252};
use encoding_rs_io::DecodeReaderBytesBuilder;
use flate2::read::MultiGzDecoder;

use crate::recording::DatasetError;

/// Counts the bytes that are read from a file.
struct Counted {
    file: File,
    bytes: Arc<AtomicU64>,
}

impl Read for Counted {
    fn read(&mut self, into: &mut [u8]) -> io::Result<usize> {
        let count = self.file.read(into)?;
        self.bytes.fetch_add(count as u64, Ordering::Relaxed);
        Ok(count)
    }
}

/// A file as text.
pub(in crate::import) struct Text {
    /// The text.
    pub reader: Box<dyn Read + Send>,
    /// Bytes read from the file.
    pub bytes: Arc<AtomicU64>,
}

impl Text {
    /// Opens a file, unless it is plainly no text.
    pub fn open(path: &Path) -> Result<Self, DatasetError> {
        let failed = |source: io::Error| match source.kind() {
            ErrorKind::NotFound => DatasetError::Missing(path.to_owned()),
            ErrorKind::IsADirectory => {
                DatasetError::NoTable { path: path.to_owned(), reason: "is a folder: name a table" }
            }
            _ => DatasetError::Read { path: path.to_owned(), source },
        };
        let mut file = File::open(path).map_err(failed)?;
        let start = start_of(&mut file).map_err(failed)?;
        let bytes = Arc::new(AtomicU64::new(0));
        file.rewind().map_err(failed)?;
        let raw = Counted { file, bytes: bytes.clone() };
        let reader: Box<dyn Read + Send> = if start.starts_with(&[0x1f, 0x8b]) {
            let mut first = MultiGzDecoder::new(File::open(path).map_err(failed)?);
            let within = start_of(&mut first).map_err(failed)?;
            refuse(path, &within)?;
            decoded(MultiGzDecoder::new(raw), &within)
        } else {
            refuse(path, &start)?;
            decoded(raw, &start)
        };
        Ok(Self { reader, bytes })
    }
}

/// The first bytes.
fn start_of(reader: &mut impl Read) -> io::Result<Vec<u8>> {
    let mut start = Vec::new();
    reader.take(64).read_to_end(&mut start)?;
    Ok(start)
}

/// Refuses what is plainly no text.
fn refuse(path: &Path, start: &[u8]) -> Result<(), DatasetError> {
    let reason = match start {
        [] => "is empty",
        [b'P', b'K', 3, 4, ..] => "is a spreadsheet or an archive: export it as CSV, or unpack it",
        [b'P', b'A', b'R', b'1', ..] => "is a Parquet file, not a table in text",
        _ => return Ok(()),
    };
    Err(DatasetError::NoTable { path: path.to_owned(), reason })
}

/// Text in UTF-8: decoded from UTF-16, which a mark or every second byte of the start tells; other text as it is.
fn decoded(reader: impl Read + Send + 'static, start: &[u8]) -> Box<dyn Read + Send> {
    let zeros = |odd: usize| start.len() > 4 && start.iter().skip(odd).step_by(2).all(|byte| *byte == 0);
    let unmarked: Option<&'static Encoding> = match (zeros(0), zeros(1)) {
        (true, false) => Some(UTF_16BE),
        (false, true) => Some(UTF_16LE),
        _ => None,
    };
    if unmarked.is_none() && Encoding::for_bom(start).is_none() {
        return Box::new(reader);
    }
    let mut builder = DecodeReaderBytesBuilder::new();
    Box::new(builder.encoding(unmarked).bom_override(true).strip_bom(true).build(reader))
}

/// The text of a cell that is no number, such as a name: in UTF-8, or else in the code page of Western Europe.
pub(in crate::import) fn name(cell: &[u8]) -> String {
    let text = match std::str::from_utf8(cell) {
        Ok(text) => text.to_owned(),
        Err(_) => WINDOWS_1252.decode_without_bom_handling(cell).0.into_owned(),
    };
    text.trim().to_owned()
}
