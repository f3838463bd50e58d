//! Modes, alarms, controllers and reset causes as text.

use shared::link::messages::{DeviceIdentity, DeviceKind};

use device::keys::hex;

pub use monitoring::words::*;

/// The key with which a device's weights must be signed.
pub fn weights_key(identity: &DeviceIdentity) -> String {
    let none =
        if identity.device == DeviceKind::ThirdParty { "none" } else { "none: accepts unsigned weights" };
    identity.weights_key.map_or_else(|| none.to_owned(), |key| hex(&key.0))
}
