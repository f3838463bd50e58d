//! The causes for which a device starts.

use serde::{Deserialize, Serialize};

/// Cause of a device's start. The order of the variants is part of the link's protocol and of the flight recorder's log:
/// append only.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum ResetCause {
    /// The supply was switched on.
    PowerOn,
    /// The supply voltage dipped.
    BrownOut,
    /// The reset pin.
    Pin,
    /// The program restarted itself, on request or after a failure.
    Software,
    /// The watchdog expired: a control tick did not end.
    Watchdog,
    /// None of the above.
    Other,
}
