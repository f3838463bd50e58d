//! Why a release file is refused, and what to do.

use thiserror::Error;

use crate::key::ReleaseKey;
use crate::{FORMAT, MANIFEST};

/// Why a release file cannot be used.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum PackageError {
    /// No ZIP archive, or a truncated one.
    #[error("it is no ZIP archive, or not all of it: download the release file again")]
    NotZip,
    /// An archive of something else.
    #[error(
        "it has no {MANIFEST}, so it is no firmware of Eupnea: take eupnea-VERSION-BOARD.zip of a release"
    )]
    NoManifest,
    /// There is no signature.
    #[error(
        "it is not signed: take the file of a release, or build the firmware yourself and flash its .elf"
    )]
    Unsigned,
    /// Another key signed it.
    #[error(
        "it is signed by the key {by}, but {trusted} is trusted: take the file from the owner of that key, or trust the other key if you know its owner"
    )]
    OtherKey {
        /// Who signed it.
        by: ReleaseKey,
        /// Who should have.
        trusted: ReleaseKey,
    },
    /// The signature does not fit the manifest.
    #[error("{MANIFEST} was changed after it was signed: download the release file again")]
    ManifestDamaged,
    /// The signed manifest is none.
    #[error("{MANIFEST} cannot be understood ({0}): report this to the maker of the release")]
    ManifestFormat(String),
    /// A later format.
    #[error("it has format {0}, and this program knows formats up to {FORMAT}: update this program")]
    Newer(u32),
    /// A file differs from what was signed.
    #[error("{0} is damaged: download the release file again")]
    Damaged(String),
    /// A file is not there.
    #[error("{0} is missing: download the release file again")]
    Missing(String),
    /// A file that the manifest does not list.
    #[error("{0} is not part of the release: download the release file again")]
    Extra(String),
    /// More than any firmware has.
    #[error("{0} is larger than any firmware: download the release file again")]
    TooLarge(String),
    /// A part that cannot be in flash as stated.
    #[error(
        "{0} is empty, overlaps another part in flash or has another length than stated: report this to the maker of the release"
    )]
    Part(String),
}
