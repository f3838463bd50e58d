//! The cause of a device's start.

use serde::{Deserialize, Serialize};

/// Cause of a device's start. The order of the variants is part of the link's protocol and of the flight recorder's log: append
/// only.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum ResetCause {
    /// The supply was switched on.
    PowerOn,
    /// The supply dipped.
    BrownOut,
    /// The reset pin.
    Pin,
    /// The program, by request or after a failure.
    Software,
    /// The watchdog: a control tick did not end.
    Watchdog,
    /// None of the above.
    Other,
}
