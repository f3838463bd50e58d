//! Why a description is refused.

use core::fmt::{Display, Write};
use core::ops::RangeInclusive;

use crate::step::STEP_US;
use crate::storage::{MOST_FAULTS, MOST_LEAK_CHANGES, MOST_NAME_BYTES, Text};

/// Path of a field, as in the TOML file.
pub type FieldPath = Text<64>;

/// Why a bench was refused.
#[derive(Debug, thiserror::Error)]
pub enum BenchError {
    /// A value is not finite or outside its range.
    #[error("{field} = {value} is outside {low} to {high}: set it within that range")]
    OutOfRange {
        /// Path of the field, as in the TOML file.
        field: FieldPath,
        /// The value found.
        value: f64,
        /// Lowest allowed value.
        low: f64,
        /// Highest allowed value.
        high: f64,
    },
    /// The changes of the leak are not in the order of their times.
    #[error(
        "circuit.leak_changes[{place}].at_s = {at_s} is not later than the change before it, at {before_s} s: \
         sort the changes by time"
    )]
    LeakOrder {
        /// Place of the change in the list; the first is 0.
        place: usize,
        /// Its time, s.
        at_s: f64,
        /// Time of the change before it, s.
        before_s: f64,
    },
    /// A fault ends before it begins, or recurs before it has ended.
    #[error("faults[{place}] {problem}")]
    FaultTimes {
        /// Place of the fault in the list; the first is 0.
        place: usize,
        /// What is wrong, and what to do.
        problem: &'static str,
    },
    /// More faults delay a reading than a chip has memory for.
    #[cfg(not(feature = "std"))]
    #[error("more than one fault delays a reading")]
    Delays,
    /// The bytes are no description, or one that does not fit.
    #[error(
        "the description cannot be read, or has more than {MOST_FAULTS} faults, {MOST_LEAK_CHANGES} changes of the leak or {MOST_NAME_BYTES} letters in its name"
    )]
    Unreadable,
    /// The control period is not a multiple of the bench's step.
    #[error("the control period must be a multiple of the bench's step of {STEP_US} us, not {period_us} us")]
    Period {
        /// Requested control period, microseconds.
        period_us: u32,
    },
    #[cfg(feature = "std")]
    /// There is no lung or preset of that name.
    #[error(
        "unknown lung \"{0}\": use R<cmH2O/(L/s)>C<mL/cmH2O> (such as R20C20), iso-01 to iso-21, either of them on \
         the machine for newborns as in neonate-R100C2, or for several lungs paper, iso, iso-matched or neonate-iso; or name a TOML file"
    )]
    UnknownName(String),
    #[cfg(feature = "std")]
    /// The file is not a bench description.
    #[error("the bench description is not valid: {0}")]
    Syntax(#[from] toml::de::Error),
    #[cfg(feature = "std")]
    /// The file cannot be read.
    #[error("cannot read the bench description {}: {source}; check the path", path.display())]
    File {
        /// The path tried.
        path: std::path::PathBuf,
        /// The system's error.
        source: std::io::Error,
    },
}

/// Refuses a value that is outside `range` or not a number.
pub(crate) fn check(field: impl Display, value: f64, range: RangeInclusive<f64>) -> Result<(), BenchError> {
    if range.contains(&value) {
        return Ok(());
    }
    let mut path = FieldPath::new();
    // A path that is too long is cut.
    _ = write!(path, "{field}");
    Err(BenchError::OutOfRange { field: path, value, low: *range.start(), high: *range.end() })
}
