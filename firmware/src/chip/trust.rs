//! Whose weights this firmware runs, and for which plant; `build.rs` writes both.

use shared::weights::PLANT_BYTES;
use shared::weights::trust::{KEY_BYTES, Trust};

const KEY: Option<[u8; KEY_BYTES]> = include!(concat!(env!("OUT_DIR"), "/weights_key.rs"));
const PLANT: Option<[u8; PLANT_BYTES]> = include!(concat!(env!("OUT_DIR"), "/weights_plant.rs"));

/// The owner of the key, or everybody in a development build.
pub const TRUST: Trust = match KEY {
    Some(key) => Trust::Key { key, plant: PLANT },
    None => Trust::Development,
};
