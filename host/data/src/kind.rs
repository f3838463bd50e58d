//! What is in a file, by its first bytes or by its name.

use std::ffi::OsStr;
use std::fs::File;
use std::io::{self, ErrorKind, Read};
use std::path::Path;

/// Bytes at the start of a file that show its kind.
const START: u64 = 4096;

/// What is in a file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// A recording.
    Recording,
    /// JSON, also one value in each line.
    Json,
    /// An HTML report.
    Page,
    /// An SVG picture.
    Picture,
    /// A TOML description.
    Description,
    /// A controller or a simulator: safetensors.
    Tensors,
    /// A network in ONNX.
    Onnx,
    /// Messages in MCAP.
    Capture,
    /// A weights image.
    Image,
    /// A controller in C.
    Code,
    /// An FMU, a ZIP archive.
    Fmu,
    /// A table.
    Table,
    /// Something else.
    Other,
}

/// Start of a controller in C, which tells it from the files of a user.
pub const CODE_START: &str = "/* Learned controller ";

/// First file of an FMU, a ZIP archive, in which names follow a header of this length.
pub const FMU_FIRST: &str = "modelDescription.xml";
const ZIP_HEADER: usize = 30;

impl Kind {
    const ENDINGS: [(&str, Self); 13] = [
        ("parquet", Self::Recording),
        ("json", Self::Json),
        ("jsonl", Self::Json),
        ("html", Self::Page),
        ("svg", Self::Picture),
        ("toml", Self::Description),
        ("onnx", Self::Onnx),
        ("mcap", Self::Capture),
        ("bin", Self::Image),
        ("c", Self::Code),
        ("h", Self::Code),
        ("fmu", Self::Fmu),
        ("csv", Self::Table),
    ];

    /// The kind by the ending of a name.
    pub fn of_name(path: &Path) -> Self {
        let ending = path.extension().unwrap_or_default();
        let known = Self::ENDINGS.into_iter().find(|(known, _)| ending == OsStr::new(known));
        known.map_or(Self::Other, |(_, kind)| kind)
    }

    /// The kind of a file by its content; none if there is no file or it is empty.
    ///
    /// # Errors
    /// A file that cannot be read.
    pub fn of_file(path: &Path) -> io::Result<Option<Self>> {
        let mut start = Vec::new();
        match File::open(path) {
            Ok(file) => file.take(START).read_to_end(&mut start)?,
            Err(error) if error.kind() == ErrorKind::NotFound => return Ok(None),
            Err(error) => return Err(error),
        };
        Ok((!start.is_empty()).then(|| Self::of_start(&start)))
    }

    /// The kind by the first bytes.
    pub(crate) fn of_start(start: &[u8]) -> Self {
        let magic: [(&[u8], Self); 5] = [
            (b"PAR1", Self::Recording),
            (b"\x89MCAP", Self::Capture),
            (&shared::weights::MAGIC, Self::Image),
            (CODE_START.as_bytes(), Self::Code),
            // The first field of an ONNX model is its version, a small number.
            (b"\x08", Self::Onnx),
        ];
        if let Some((_, kind)) = magic.into_iter().find(|(magic, _)| start.starts_with(magic)) {
            return kind;
        }
        if start.starts_with(b"PK\x03\x04")
            && start.get(ZIP_HEADER..).is_some_and(|name| name.starts_with(FMU_FIRST.as_bytes()))
        {
            return Self::Fmu;
        }
        if start.get(8) == Some(&b'{') && start[6..8] == [0, 0] {
            return Self::Tensors;
        }
        // A character may be cut at the end.
        let whole = start.utf8_chunks().next().map_or("", |chunk| chunk.valid());
        if whole.len() + 4 > start.len() { Self::of_text(whole) } else { Self::Other }
    }

    fn of_text(text: &str) -> Self {
        let text = text.trim_start_matches('\u{feff}').trim_start();
        let first =
            text.lines().find(|line| !line.starts_with('#') && !line.trim().is_empty()).unwrap_or_default();
        let begins =
            |word: &str| text.get(..word.len()).is_some_and(|start| start.eq_ignore_ascii_case(word));
        let is_header =
            first.starts_with("[[") || (first.starts_with('[') && first.trim_end().ends_with(']'));
        let is_heading = is_header && first.contains(|letter: char| letter.is_ascii_lowercase());
        match first.chars().next() {
            _ if begins("<!doctype html") || begins("<html") => Self::Page,
            _ if begins("<svg") || begins("<?xml") => Self::Picture,
            _ if is_heading && !first.contains(['"', '{']) => Self::Description,
            Some('{' | '[') => Self::Json,
            _ if first.split_once('=').is_some_and(|(key, _)| is_key(key.trim())) => Self::Description,
            _ if first.contains([',', ';', '\t']) => Self::Table,
            _ => Self::Other,
        }
    }

    /// The kind in words.
    pub fn name(self) -> &'static str {
        match self {
            Self::Recording => "a recording",
            Self::Json => "JSON",
            Self::Page => "an HTML report",
            Self::Picture => "an SVG picture",
            Self::Description => "a TOML file",
            Self::Tensors => "a controller or simulator",
            Self::Onnx => "an ONNX model",
            Self::Capture => "an MCAP file",
            Self::Image => "a weights image",
            Self::Code => "a controller in C",
            Self::Fmu => "an FMU",
            Self::Table => "a table",
            Self::Other => "a file of another kind",
        }
    }
}

/// Whether text can be a key of TOML.
fn is_key(text: &str) -> bool {
    !text.is_empty() && text.bytes().all(|letter| letter.is_ascii_alphanumeric() || b"_-.".contains(&letter))
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::fs;

    #[test]
    fn the_first_bytes_tell_the_kind() {
        let fmu = [&b"PK\x03\x04"[..], &[0; ZIP_HEADER - 4], FMU_FIRST.as_bytes()].concat();
        let tensors = [&64_u64.to_le_bytes()[..], b"{\"__metadata__\":{}}"].concat();
        for (start, kind) in [
            (&b"PAR1\x15\x04"[..], Kind::Recording),
            (b"{\"seed\": 1}", Kind::Json),
            (b"[\n  {\"v\": 1}\n]", Kind::Json),
            (b"[1, 2]", Kind::Json),
            (b"<!DOCTYPE html><html>", Kind::Page),
            (b"<svg width=\"3\">", Kind::Picture),
            (b"# a bench\n\n[lung]\nresistance = 5", Kind::Description),
            (b"[[faults]]\n", Kind::Description),
            (b"name = \"a\"\n", Kind::Description),
            (&tensors, Kind::Tensors),
            (b"\x08\x08\x12\x06eupnea", Kind::Onnx),
            (b"\x89MCAP0\r\n", Kind::Capture),
            (&shared::weights::MAGIC, Kind::Image),
            (b"/* Learned controller 0a1b2c3d, written", Kind::Code),
            (b"/* Learned by hand */\nint main;", Kind::Other),
            (&fmu, Kind::Fmu),
            (&fmu[..ZIP_HEADER], Kind::Other),
            (b"\xef\xbb\xbft_s,p,u\n0,5,0\n", Kind::Table),
            (b"time;pressure\n0,1;5,0\n", Kind::Table),
            (b"Dear reader\n", Kind::Other),
            (b"\xff\xfe\x00", Kind::Other),
        ] {
            assert_eq!(Kind::of_start(start), kind, "{}", String::from_utf8_lossy(start));
        }
    }

    #[test]
    fn an_empty_file_is_of_no_kind_and_the_name_says_what_it_will_be() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.csv");
        assert_eq!(Kind::of_file(&path).unwrap(), None);
        fs::write(&path, "").unwrap();
        assert_eq!((Kind::of_file(&path).unwrap(), Kind::of_name(&path)), (None, Kind::Table));
        fs::write(&path, format!("time,pressure\n{}", "0.001,5.2\n".repeat(2000))).unwrap();
        assert_eq!(Kind::of_file(&path).unwrap(), Some(Kind::Table));
    }
}
