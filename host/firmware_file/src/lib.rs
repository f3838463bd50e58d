//! The release file of a board's firmware: a signed ZIP archive `eupnea-VERSION-BOARD.zip`.
//!
//! | entry | content |
//! |---|---|
//! | `manifest.json` | the [`Manifest`]: what the firmware is, where its parts go, length and SHA-256 of every other file |
//! | `manifest.sig` | two lines in hexadecimal: public key, and its ed25519 signature over the bytes of `manifest.json` |
//! | any other | the files: program (`.elf`, `.hex`, `.bin`, `.dfu`), weights |
//!
//! The signature covers the manifest and the manifest every file, so trust in the key covers the whole archive. [`write()`]
//! gives the same bytes for the same input, and [`read()`] refuses whatever is damaged, unsigned or signed by another key.
#![forbid(unsafe_code)]

pub mod dfuse;
mod error;
mod key;
mod manifest;
mod read;
mod write;

#[cfg(test)]
mod tests;

pub use ed25519_compact::{KeyPair, Seed};
pub use error::PackageError;
pub use key::{KeyError, ReleaseKey, seal, signer};
pub use manifest::{Content, Firmware, Manifest, Part, Stamp, chip_of};
pub use read::{Package, read};
pub use write::{sha256, write};

/// Version of the release file's format.
pub const FORMAT: u32 = 1;
/// Entry with the manifest.
pub const MANIFEST: &str = "manifest.json";
/// Entry with the manifest's signature.
pub const SIGNATURE: &str = "manifest.sig";

/// Most bytes of manifest or signature.
const MANIFEST_LIMIT: u64 = 64 << 10;
/// Most bytes of a file: an image with debug information has a few million. A larger one is meant to exhaust the reader's memory.
const FILE_LIMIT: u64 = 32 << 20;
/// Most files in an archive.
const FILES_LIMIT: usize = 32;
