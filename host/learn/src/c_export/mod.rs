//! Export of a learned controller as C: a C99 file and its header that need nothing else, for any chip.
//!
//! The templates repeat the core's arithmetic, operation by operation; their constants are the core's. [`standalone`] is what the file
//! computes, in Rust: it gives the results of the file's self-check, and tests compare both bit for bit. `docs/C_EXPORT.md` describes
//! the file for its users.

mod constants;
pub mod standalone;
mod text;
mod trials;

use data::kind::CODE_START;
use shared::weights::{ARCHITECTURE, Image, ImageId};
use thiserror::Error;

const CODE: &str = include_str!("template/controller.c");
const HEADER: &str = include_str!("template/controller.h");
/// Begins all names in the templates.
const NAMES: &str = "eupnea_";

// The templates compute the features, the memory and the network of this architecture.
const _: () = assert!(ARCHITECTURE == 3);

/// A controller in C.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Source {
    /// The file.
    pub code: String,
    /// Its header, of the same name.
    pub header: String,
}

/// Reason why a controller is not written as C.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
#[error(
    "the name of a C file begins the names of its functions, and {0:?} cannot: use letters, digits and underscores, a letter first"
)]
pub struct NameError(String);

/// Writes a controller as C. All its names begin with `name`, which is also that of the two files.
///
/// # Errors
/// A name with which none in C can begin.
pub fn source(image: &Image, name: &str) -> Result<Source, NameError> {
    let letters = |c: char| c.is_ascii_alphanumeric() || c == '_';
    if !name.chars().all(letters) || !name.starts_with(|c: char| c.is_ascii_alphabetic()) {
        return Err(NameError(name.to_owned()));
    }
    let mut parts = constants::parts(image);
    parts.extend([("about", about(image)), ("stem", name.to_owned())]);
    let filled = |template: &str| {
        let named = template.replace(NAMES, &format!("{name}_"));
        let named = named.replace(&NAMES.to_uppercase(), &format!("{}_", name.to_uppercase()));
        parts.iter().fold(named, |text, (key, value)| text.replace(&format!("@{key}@"), value))
    };
    Ok(Source { code: filled(CODE), header: filled(HEADER) })
}

/// What a reader must know of the files.
fn about(image: &Image) -> String {
    format!(
        "{CODE_START}{}, written by Eupnea {}. Do not edit: export it again.\n\
         \n   Research software: never on a patient. Of Eupnea's safeguards this has only the limits of the residual and of the valve,\n   \
         the pressure limit, and safe valves without a reading. It lacks all monitors and alarms, the PID and the backup\n   \
         ventilation to which a device falls, the second sensor, triggers, leak compensation and watchdog: docs/C_EXPORT.md. */",
        ImageId(image.id),
        env!("CARGO_PKG_VERSION"),
    )
}

#[cfg(test)]
mod tests;
