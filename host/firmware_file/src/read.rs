//! Reading a release file: nothing of it is used before its signature and checksums are verified.

use std::collections::BTreeMap;
use std::io::{Cursor, Read as _};

use serde::Deserialize;
use zip::ZipArchive;
use zip::result::ZipError;

use crate::error::PackageError;
use crate::key::{ReleaseKey, unseal};
use crate::manifest::{Manifest, Part};
use crate::write::stamp;
use crate::{FILE_LIMIT, FILES_LIMIT, FORMAT, MANIFEST, MANIFEST_LIMIT, SIGNATURE};

type Archive<'a> = ZipArchive<Cursor<&'a [u8]>>;

/// A verified release file.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Package {
    /// What it says about itself.
    pub manifest: Manifest,
    /// Its files, by name.
    pub files: BTreeMap<String, Vec<u8>>,
}

impl Package {
    /// The parts with their bytes.
    pub fn parts(&self) -> impl Iterator<Item = (&Part, &[u8])> {
        self.manifest
            .firmware
            .parts
            .iter()
            .filter_map(|part| Some((part, self.files.get(&part.file)?.as_slice())))
    }
}

/// Verifies a release file against the key that must have signed it.
///
/// # Errors
/// [`PackageError`], with what to do.
pub fn read(bytes: &[u8], trusted: &ReleaseKey) -> Result<Package, PackageError> {
    let mut archive = Archive::new(Cursor::new(bytes)).map_err(|_| PackageError::NotZip)?;
    let manifest = manifest(&mut archive, trusted)?;
    let known = |name: &&str| manifest.files.contains_key(*name) || [MANIFEST, SIGNATURE].contains(name);
    if let Some(name) = archive.file_names().find(|name| !known(name)) {
        return Err(PackageError::Extra(name.into()));
    }
    if manifest.files.len() > FILES_LIMIT {
        return Err(PackageError::TooLarge("the archive".into()));
    }
    let mut files = BTreeMap::new();
    for (name, signed) in &manifest.files {
        let content = entry(&mut archive, name, FILE_LIMIT)?;
        let content = content.ok_or_else(|| PackageError::Missing(name.clone()))?;
        if stamp(&content) != *signed {
            return Err(PackageError::Damaged(name.clone()));
        }
        files.insert(name.clone(), content);
    }
    Ok(Package { manifest, files })
}

/// The field of a manifest that stays in all formats.
#[derive(Deserialize)]
struct Format {
    format: u32,
}

/// The manifest, once its signature is verified.
fn manifest(archive: &mut Archive<'_>, trusted: &ReleaseKey) -> Result<Manifest, PackageError> {
    let text = entry(archive, MANIFEST, MANIFEST_LIMIT)?.ok_or(PackageError::NoManifest)?;
    let seal = entry(archive, SIGNATURE, MANIFEST_LIMIT)?.ok_or(PackageError::Unsigned)?;
    let (by, signature) = unseal(&seal).ok_or_else(|| PackageError::Damaged(SIGNATURE.into()))?;
    if by != *trusted {
        return Err(PackageError::OtherKey { by, trusted: *trusted });
    }
    if !trusted.signed(&text, &signature) {
        return Err(PackageError::ManifestDamaged);
    }
    let wrong = |error: serde_json::Error| PackageError::ManifestFormat(error.to_string());
    // The number first: a later format may have other fields.
    let Format { format } = serde_json::from_slice(&text).map_err(wrong)?;
    if format > FORMAT {
        return Err(PackageError::Newer(format));
    }
    let manifest: Manifest = serde_json::from_slice(&text).map_err(wrong)?;
    manifest.check()?;
    Ok(manifest)
}

/// An entry of at most `limit` bytes, whatever length it claims; none if there is none.
fn entry(archive: &mut Archive<'_>, name: &str, limit: u64) -> Result<Option<Vec<u8>>, PackageError> {
    let file = match archive.by_name(name) {
        Ok(file) => file,
        Err(ZipError::FileNotFound) => return Ok(None),
        Err(_) => return Err(PackageError::Damaged(name.into())),
    };
    let mut content = Vec::new();
    file.take(limit + 1).read_to_end(&mut content).map_err(|_| PackageError::Damaged(name.into()))?;
    if content.len() as u64 > limit {
        return Err(PackageError::TooLarge(name.into()));
    }
    Ok(Some(content))
}
