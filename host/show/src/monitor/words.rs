//! Modes, alarms, controllers and reset causes as text.

use shared::link::messages::DeviceIdentity;

use device::keys::hex;

pub use monitoring::words::*;

/// The key with which a device's weights must be signed.
pub fn weights_key(identity: &DeviceIdentity) -> String {
    identity.weights_key.map_or_else(|| "none: accepts unsigned weights".to_owned(), |key| hex(&key.0))
}
