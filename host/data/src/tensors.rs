//! Vectors of numbers with a description, as safetensors files that Python can open too.
//!
//! The description is JSON in the file's metadata, under a key that names the kind of file (`eupnea-simulator`).

use std::collections::HashMap;
use std::path::{Path, PathBuf};
use std::{fs, io};

use safetensors::tensor::{Dtype, SafeTensors, TensorView};
use serde::{Deserialize, Serialize};
use thiserror::Error;

use crate::files::write_atomically;
use crate::kind::Kind;

/// Why a file of vectors cannot be used.
#[derive(Debug, Error)]
#[expect(missing_docs, reason = "the message names every field")]
pub enum TensorError {
    /// The file system failed.
    #[error("cannot access {path}: {source}")]
    File { path: PathBuf, source: io::Error },
    /// The file is incomplete, or something else.
    #[error("{path} is not a valid {kind}: {reason}")]
    Format { path: PathBuf, kind: &'static str, reason: String },
}

impl TensorError {
    /// An error for a file that is not of the expected kind.
    pub fn format(path: &Path, kind: &'static str, reason: &impl ToString) -> Self {
        Self::Format { path: path.to_owned(), kind, reason: reason.to_string() }
    }

    fn file(path: &Path) -> impl FnOnce(io::Error) -> Self {
        let path = path.to_owned();
        move |source| Self::File { path, source }
    }
}

/// Prefix of the metadata's key, before the kind.
const KEY: &str = "eupnea-";

fn key(kind: &str) -> String {
    format!("{KEY}{kind}")
}

/// The kind of a file written by [`save`].
///
/// # Errors
/// The file cannot be read, is incomplete or comes from another program.
pub fn kind(path: &Path) -> Result<String, TensorError> {
    let bytes = fs::read(path).map_err(TensorError::file(path))?;
    let foreign = |reason: String| TensorError::format(path, "controller or simulator", &reason);
    let (_, header) =
        SafeTensors::read_metadata(&bytes).map_err(|error| foreign(unlike(&bytes, &error.to_string())))?;
    let mut keys = header.metadata().iter().flat_map(HashMap::keys);
    let kind = keys.find_map(|key| key.strip_prefix(KEY));
    kind.map(str::to_owned).ok_or_else(|| foreign("its metadata does not name its kind".to_owned()))
}

/// Writes named vectors and their description atomically.
///
/// # Errors
/// The file cannot be written.
pub fn save(
    path: &Path,
    kind: &'static str,
    description: &impl Serialize,
    vectors: &[(&str, &[f32])],
) -> Result<(), TensorError> {
    let json = serde_json::to_string(description).map_err(|e| TensorError::format(path, kind, &e))?;
    let bytes: Vec<(&str, Vec<u8>, usize)> = vectors
        .iter()
        .map(|(name, values)| (*name, values.iter().flat_map(|v| v.to_le_bytes()).collect(), values.len()))
        .collect();
    let views = bytes
        .iter()
        .map(|(name, bytes, len)| Ok((*name, TensorView::new(Dtype::F32, vec![*len], bytes)?)))
        .collect::<Result<Vec<_>, safetensors::SafeTensorError>>();
    let file = views
        .and_then(|views| safetensors::serialize(views, Some(HashMap::from([(key(kind), json)]))))
        .map_err(|e| TensorError::format(path, kind, &e))?;
    write_atomically(path, &file).map_err(TensorError::file(path))
}

/// Reads a file written by [`save`]: the description, and the vectors in the order of `names`.
///
/// # Errors
/// The file cannot be read, is incomplete, is of another kind, or contains a number that is not finite.
pub fn load<D: for<'de> Deserialize<'de>>(
    path: &Path,
    kind: &'static str,
    names: &[&str],
) -> Result<(D, Vec<Vec<f32>>), TensorError> {
    let bytes = fs::read(path).map_err(TensorError::file(path))?;
    parse(&bytes, kind, names).map_err(|reason| TensorError::format(path, kind, &reason))
}

/// Why a file without a readable header is none of this program's: what it is instead, if that can be told.
fn unlike(bytes: &[u8], reason: &str) -> String {
    match Kind::of_start(bytes) {
        _ if bytes.is_empty() => "it is empty".to_owned(),
        Kind::Tensors | Kind::Other => format!("it is damaged, incomplete or of another kind ({reason})"),
        kind => format!("it is {}", kind.name()),
    }
}

fn parse<D: for<'de> Deserialize<'de>>(
    bytes: &[u8],
    kind: &str,
    names: &[&str],
) -> Result<(D, Vec<Vec<f32>>), String> {
    let (_, header) = SafeTensors::read_metadata(bytes).map_err(|error| unlike(bytes, &error.to_string()))?;
    let json = header.metadata().as_ref().and_then(|metadata| metadata.get(&key(kind)));
    let json = json.ok_or_else(|| format!("it has no metadata key {}", key(kind)))?;
    let description = serde_json::from_str(json).map_err(|e| e.to_string())?;
    let tensors = SafeTensors::deserialize(bytes).map_err(|e| e.to_string())?;
    let vectors = names.iter().map(|name| vector(&tensors, name)).collect::<Result<_, _>>()?;
    Ok((description, vectors))
}

fn vector(tensors: &SafeTensors<'_>, name: &str) -> Result<Vec<f32>, String> {
    let view = tensors.tensor(name).map_err(|e| e.to_string())?;
    if view.dtype() != Dtype::F32 {
        return Err(format!("{name} does not contain 32-bit floats"));
    }
    let (words, _) = view.data().as_chunks::<4>();
    let values: Vec<f32> = words.iter().map(|word| f32::from_le_bytes(*word)).collect();
    match values.iter().position(|v| !v.is_finite()) {
        Some(index) => Err(format!("{name}[{index}] is not a finite number")),
        None => Ok(values),
    }
}
