//! The key pair with which weights are signed, in a file.

use std::fs::{self, OpenOptions};
use std::io::{self, ErrorKind, Write};
use std::path::{Path, PathBuf};

use ed25519_compact::{KeyPair, Seed};
use shared::weights::IMAGE_BYTES;
use shared::weights::trust::{KEY_BYTES, KeyId, seal};
use thiserror::Error;

/// Beginning of the file with the private key; the seed follows in hexadecimal.
const LABEL: &str = "eupnea-weights-key:";
/// Extension that the file with the public key has in addition.
const PUBLIC: &str = "pub";

/// Why a key cannot be made or used.
#[derive(Debug, Error)]
pub enum KeyError {
    /// The file exists.
    #[error("{0} exists, and a key is never overwritten: choose another name")]
    Exists(PathBuf),
    /// A file cannot be read or written.
    #[error("cannot use {0}: {1}")]
    File(PathBuf, io::Error),
    /// The file contains no private key.
    #[error("{0} contains no private key: make one with `trainer keys --out FILE`")]
    Format(PathBuf),
}

/// A private key, with its public key.
#[derive(Clone, Debug)]
pub struct PrivateKey(KeyPair);

impl PrivateKey {
    /// Makes a random key pair and writes it: the private key, readable by its owner alone, to `path`, and the public key to
    /// the same name with `.pub`.
    ///
    /// # Errors
    /// [`KeyError::Exists`], [`KeyError::File`].
    pub fn create(path: &Path) -> Result<Self, KeyError> {
        let key = Self(KeyPair::generate());
        let public = public_file(path);
        if public.exists() {
            return Err(KeyError::Exists(public));
        }
        write(path, &format!("{LABEL}{}\n", hex(&*key.0.sk.seed())), true)?;
        write(&public, &format!("{}\n", key.public()), false)?;
        Ok(key)
    }

    /// Reads a private key that [`Self::create`] wrote.
    ///
    /// # Errors
    /// [`KeyError::File`], [`KeyError::Format`].
    pub fn load(path: &Path) -> Result<Self, KeyError> {
        let text = fs::read_to_string(path).map_err(|error| KeyError::File(path.to_owned(), error))?;
        let seed = text.trim().strip_prefix(LABEL).and_then(bytes);
        let seed = seed.ok_or_else(|| KeyError::Format(path.to_owned()))?;
        Ok(Self(KeyPair::from_seed(Seed::new(seed))))
    }

    /// The public key in hexadecimal, as the firmware's build takes it.
    pub fn public(&self) -> String {
        hex(&*self.0.pk)
    }

    /// The id by which devices and people name the key.
    pub fn id(&self) -> KeyId {
        KeyId(std::array::from_fn(|index| self.0.pk[index]))
    }

    /// Signs a weights image as this version, which must grow.
    pub fn sign(&self, image: &mut [u8; IMAGE_BYTES], version: u32) {
        seal(image, version, |signed| *self.0.sk.sign(signed, None));
    }
}

/// File of the public key beside a private one.
pub fn public_file(private: &Path) -> PathBuf {
    let mut name = private.as_os_str().to_owned();
    name.push(".");
    name.push(PUBLIC);
    name.into()
}

/// Writes a new file.
fn write(path: &Path, text: &str, secret: bool) -> Result<(), KeyError> {
    let mut options = OpenOptions::new();
    options.write(true).create_new(true);
    #[cfg(unix)]
    if secret {
        std::os::unix::fs::OpenOptionsExt::mode(&mut options, 0o600);
    }
    #[cfg(not(unix))]
    let _ = secret;
    let written = options.open(path).and_then(|mut file| file.write_all(text.as_bytes()));
    written.map_err(|error| match error.kind() {
        ErrorKind::AlreadyExists => KeyError::Exists(path.to_owned()),
        _ => KeyError::File(path.to_owned(), error),
    })
}

/// Bytes in hexadecimal.
pub fn hex(bytes: &[u8]) -> String {
    let digit = |half: u8| char::from_digit(half.into(), 16);
    bytes.iter().flat_map(|byte| [byte >> 4, byte & 15]).filter_map(digit).collect()
}

/// The bytes of a text in hexadecimal.
fn bytes(text: &str) -> Option<[u8; KEY_BYTES]> {
    let digits = text.as_bytes().as_chunks::<2>().0;
    let byte = |digits: &[u8; 2]| u8::from_str_radix(std::str::from_utf8(digits).ok()?, 16).ok();
    let bytes: Vec<u8> = digits.iter().map(byte).collect::<Option<_>>()?;
    (text.len() == 2 * KEY_BYTES).then_some(bytes)?.try_into().ok()
}

#[cfg(test)]
mod tests {
    use super::*;
    use shared::weights::trust::Trust;

    #[test]
    fn a_key_is_read_back_and_its_signature_is_the_one_that_a_device_trusts() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("weights.key");
        let key = PrivateKey::create(&path).unwrap();
        let again = PrivateKey::load(&path).unwrap();
        assert_eq!((key.public(), key.id()), (again.public(), again.id()));
        let public = fs::read_to_string(folder.path().join("weights.key.pub")).unwrap();
        assert_eq!(public.trim(), key.public());
        let trust = Trust::Key { key: bytes(public.trim()).unwrap(), plant: None };
        assert_eq!(trust.key(), Some(key.id()));
        let mut image = [7; IMAGE_BYTES];
        again.sign(&mut image, 3);
        assert_eq!(trust.verify(&image), Ok(()));
    }

    #[cfg(unix)]
    #[test]
    fn only_its_owner_reads_a_private_key() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("weights.key");
        PrivateKey::create(&path).unwrap();
        let mode = std::os::unix::fs::PermissionsExt::mode(&fs::metadata(&path).unwrap().permissions());
        assert_eq!(mode & 0o777, 0o600);
    }

    #[test]
    fn no_key_is_overwritten() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("weights.key");
        let key = PrivateKey::create(&path).unwrap();
        assert!(matches!(PrivateKey::create(&path), Err(KeyError::Exists(_))));
        fs::remove_file(public_file(&path)).unwrap();
        assert!(matches!(PrivateKey::create(&path), Err(KeyError::Exists(_))));
        assert_eq!(PrivateKey::load(&path).unwrap().public(), key.public());
        fs::remove_file(&path).unwrap();
        fs::write(public_file(&path), "x").unwrap();
        assert!(matches!(PrivateKey::create(&path), Err(KeyError::Exists(_))));
        assert!(!path.exists(), "no half of a pair");
    }

    #[test]
    fn what_is_no_key_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("key");
        assert!(matches!(PrivateKey::load(&path), Err(KeyError::File(..))));
        let zeros = "0".repeat(64);
        for text in ["", &zeros, &format!("{LABEL}{}", &zeros[1..]), &format!("{LABEL}x{}", &zeros[1..])] {
            fs::write(&path, text).unwrap();
            assert!(matches!(PrivateKey::load(&path), Err(KeyError::Format(_))), "{text}");
        }
    }
}
