//! Writing a release file.

use std::collections::BTreeMap;
use std::io::{Cursor, Write as _};

use ed25519_compact::KeyPair;
use sha2::{Digest as _, Sha256};
use zip::write::SimpleFileOptions;
use zip::{CompressionMethod, DateTime, ZipWriter};

use crate::error::PackageError;
use crate::key::{hex, seal};
use crate::manifest::{Firmware, Manifest, Stamp};
use crate::{FILE_LIMIT, FILES_LIMIT, FORMAT, MANIFEST, SIGNATURE};

/// A release file with this firmware and its files, signed with `pair`: manifest and signature first, then the files by name.
///
/// # Errors
/// A part that is no whole file or overlaps another; too many or too large files, or one with the name of another entry.
pub fn write(
    firmware: &Firmware,
    files: &BTreeMap<String, Vec<u8>>,
    pair: &KeyPair,
) -> Result<Vec<u8>, PackageError> {
    check(files)?;
    let stamps = files.iter().map(|(name, content)| (name.clone(), stamp(content))).collect();
    let manifest = Manifest { format: FORMAT, firmware: firmware.clone(), files: stamps };
    manifest.check()?;
    let text = serde_json::to_string_pretty(&manifest)
        .map_err(|error| PackageError::ManifestFormat(error.to_string()))?;
    let signature = seal(text.as_bytes(), pair);
    let head = [(MANIFEST, text.as_bytes()), (SIGNATURE, signature.as_bytes())];
    let files = files.iter().map(|(name, content)| (name.as_str(), content.as_slice()));
    archive(head.into_iter().chain(files))
}

fn check(files: &BTreeMap<String, Vec<u8>>) -> Result<(), PackageError> {
    if files.len() > FILES_LIMIT {
        return Err(PackageError::TooLarge("the archive".into()));
    }
    for (name, content) in files {
        if name == MANIFEST || name == SIGNATURE {
            return Err(PackageError::Extra(name.clone()));
        }
        if content.len() as u64 > FILE_LIMIT {
            return Err(PackageError::TooLarge(name.clone()));
        }
    }
    Ok(())
}

/// Length and checksum of a file.
pub(crate) fn stamp(content: &[u8]) -> Stamp {
    Stamp { bytes: content.len() as u64, sha256: sha256(content) }
}

/// SHA-256 in hexadecimal.
pub fn sha256(content: &[u8]) -> String {
    hex(&Sha256::digest(content))
}

/// A ZIP archive that depends on its entries alone, not on time and machine.
fn archive<'a>(entries: impl Iterator<Item = (&'a str, &'a [u8])>) -> Result<Vec<u8>, PackageError> {
    let options = SimpleFileOptions::default()
        .compression_method(CompressionMethod::Deflated)
        .last_modified_time(DateTime::default())
        .unix_permissions(0o644);
    let mut zip = ZipWriter::new(Cursor::new(Vec::new()));
    for (name, content) in entries {
        let written = zip.start_file(name, options).is_ok() && zip.write_all(content).is_ok();
        written.then_some(()).ok_or_else(|| PackageError::Extra(name.into()))?;
    }
    Ok(zip.finish().map_err(|_| PackageError::NotZip)?.into_inner())
}
