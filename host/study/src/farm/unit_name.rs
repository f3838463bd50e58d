//! Names of units.

use std::fmt;
use std::str::FromStr;

use serde::{Deserialize, Serialize};

/// Name of a unit: letters, digits, `-` and `_`.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
pub struct UnitName(String);

impl UnitName {
    /// The name of the unit with this number.
    pub fn numbered(number: u32) -> Self {
        Self(number.to_string())
    }

    /// Whether the folders of both names are one, as on file systems that ignore case.
    pub(super) fn same_folder(&self, other: &Self) -> bool {
        self.0.eq_ignore_ascii_case(&other.0)
    }

    /// The name.
    pub fn as_str(&self) -> &str {
        &self.0
    }
}

impl FromStr for UnitName {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let allowed = |letter: char| letter.is_ascii_alphanumeric() || "-_".contains(letter);
        if !text.is_empty() && text.chars().all(allowed) {
            Ok(Self(text.to_owned()))
        } else {
            Err(format!("the name {text} cannot be that of a folder: use letters, digits, - and _"))
        }
    }
}

impl fmt::Display for UnitName {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}
