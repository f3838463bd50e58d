//! The link between host and device. `docs/DEVICE_LINK.md` describes it byte by byte for other languages.
//!
//! A message is an enum ([`messages`]) in postcard's encoding, followed by the CRC-32 of those bytes (little
//! endian), framed with COBS between two zero bytes ([`frame`]). The leading zero byte ends any line noise before the
//! frame.
//!
//! The device answers each request of the host once, with the request's sequence number and the value that is now in
//! force. It also sends events: batches of [`telemetry`], breath summaries, alarms. After connecting, the host first
//! reads ([`messages::Request::Identify`]) and never changes settings by itself. A host that changes anything first acquires
//! the device's lease ([`crate::device::lease`]); meanwhile every other host only reads.
//!
//! [`plant_link`] is a separate link, for a plant in place of sensor and valves.

pub mod frame;
pub mod host_name;
pub mod messages;
pub mod plant_link;
pub mod refusal;
pub mod self_test;
pub mod telemetry;

/// Version of the protocol; it changes whenever the bytes of an existing message change.
pub const PROTOCOL: u16 = 4;
