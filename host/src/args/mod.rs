//! Arguments that commands share, with what they choose: a bench, a plant, a device, a controller, settings, column maps, addresses, shards.

pub mod bench;
pub mod controller;
pub mod gains;
pub mod key;
pub mod listen;
pub mod map;
pub mod plant;
pub mod port;
pub mod preset;
pub mod settings;
pub mod shards;
pub mod source;
pub mod waveforms;
