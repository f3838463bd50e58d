//! The public key of a release, and its signatures.

use std::fmt;
use std::str::FromStr;

use ed25519_compact::{KeyPair, PublicKey, Signature};
use thiserror::Error;

/// The public key that signs a release: 64 hexadecimal digits.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ReleaseKey([u8; PublicKey::BYTES]);

/// A text is no public key.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
#[error("a release key has {} hexadecimal digits", 2 * PublicKey::BYTES)]
pub struct KeyError;

impl ReleaseKey {
    /// The key of the project's releases, if the program was built with it in the variable `EUPNEA_RELEASE_KEY`.
    ///
    /// # Errors
    /// A variable that has no key.
    pub fn built_in() -> Result<Option<Self>, KeyError> {
        option_env!("EUPNEA_RELEASE_KEY").filter(|key| !key.is_empty()).map(str::parse).transpose()
    }

    /// The public half of a key pair.
    pub fn of(pair: &KeyPair) -> Self {
        Self(*pair.pk)
    }

    /// Whether `signature` is this key's over `bytes`.
    pub(crate) fn signed(&self, bytes: &[u8], signature: &Signature) -> bool {
        PublicKey::new(self.0).verify(bytes, signature).is_ok()
    }
}

impl fmt::Display for ReleaseKey {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&hex(&self.0))
    }
}

impl FromStr for ReleaseKey {
    type Err = KeyError;

    fn from_str(text: &str) -> Result<Self, KeyError> {
        unhex(text.trim()).map(Self).ok_or(KeyError)
    }
}

/// Public key and its signature over a text, a line each.
pub fn seal(text: &[u8], pair: &KeyPair) -> String {
    let signature = pair.sk.sign(text, None);
    format!("{}\n{}\n", ReleaseKey::of(pair), hex(&*signature))
}

/// The key that signed a text with [`seal`]; none if the signature is of another text.
pub fn signer(text: &[u8], signature: &[u8]) -> Option<ReleaseKey> {
    let (key, signature) = unseal(signature)?;
    key.signed(text, &signature).then_some(key)
}

/// Key and signature of [`seal`].
pub(crate) fn unseal(text: &[u8]) -> Option<(ReleaseKey, Signature)> {
    let (key, signature) = std::str::from_utf8(text).ok()?.strip_suffix('\n')?.split_once('\n')?;
    Some((ReleaseKey(unhex(key)?), Signature::new(unhex(signature)?)))
}

/// Bytes in hexadecimal.
pub(crate) fn hex(bytes: &[u8]) -> String {
    let digit = |half: u8| char::from_digit(half.into(), 16);
    bytes.iter().flat_map(|byte| [byte >> 4, byte & 15]).filter_map(digit).collect()
}

/// Exactly `N` bytes of a text in hexadecimal.
fn unhex<const N: usize>(text: &str) -> Option<[u8; N]> {
    let digit = |digit: u8| char::from(digit).to_digit(16);
    let byte = |pair: &[u8; 2]| Some((digit(pair[0])? << 4 | digit(pair[1])?) as u8);
    let (pairs, rest) = text.as_bytes().as_chunks::<2>();
    let bytes: Vec<u8> = pairs.iter().map(byte).collect::<Option<_>>()?;
    rest.is_empty().then_some(bytes)?.try_into().ok()
}
