//! The file of an FMU: a ZIP archive.

use std::env::consts::{ARCH, DLL_SUFFIX, OS};
use std::io::{Cursor, Write};

use data::kind::FMU_FIRST;
use thiserror::Error;
use zip::ZipWriter;
use zip::result::ZipError;
use zip::write::SimpleFileOptions;

use crate::description::{LIBRARY, description};
use crate::resources::{BENCH, CONTROLLER, Resources};

/// Why an FMU cannot be written.
#[derive(Debug, Error)]
pub enum ArchiveError {
    /// FMI 2.0 has no name for this kind of machine.
    #[error(
        "FMI 2.0 has no name for a library of {OS} on {ARCH}: write the FMU on Linux, macOS or Windows with an x86 processor"
    )]
    Platform,
    /// The archive cannot be made.
    #[error(transparent)]
    Zip(#[from] ZipError),
    /// A file does not fit into it.
    #[error(transparent)]
    Io(#[from] std::io::Error),
}

/// The folder for libraries of this machine.
fn platform() -> Option<&'static str> {
    match (OS, ARCH) {
        ("linux", "x86_64") => Some("linux64"),
        ("windows", "x86_64") => Some("win64"),
        ("macos", _) => Some("darwin64"),
        _ => None,
    }
}

/// The FMU with these resources and the library for this machine.
///
/// # Errors
/// A machine that FMI 2.0 does not know.
pub fn archive(resources: &Resources, library: &[u8]) -> Result<Vec<u8>, ArchiveError> {
    let platform = platform().ok_or(ArchiveError::Platform)?;
    let description = description(resources);
    let mut zip = ZipWriter::new(Cursor::new(Vec::new()));
    for (name, content) in [
        (FMU_FIRST.to_owned(), description.as_bytes()),
        (format!("resources/{BENCH}"), resources.bench_text.as_bytes()),
        (format!("resources/{CONTROLLER}"), &resources.image_bytes),
        (format!("binaries/{platform}/{LIBRARY}{DLL_SUFFIX}"), library),
    ] {
        zip.start_file(name, SimpleFileOptions::default())?;
        zip.write_all(content)?;
    }
    Ok(zip.finish()?.into_inner())
}
