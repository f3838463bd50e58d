//! The link between host and device.
//!
//! A message is an enum ([`messages`]) in postcard's encoding, followed by a CRC-32 of those bytes (little
//! endian), framed with COBS between two zero bytes ([`frame`]). Zero bytes on both sides cost one byte and save
//! the frame that follows line noise.
//!
//! The host asks, the device answers each request once, with the request's sequence number and the value that
//! is now in force. In between the device sends events: batches of [`telemetry`], breath summaries, alarms.
//! After a connection the host reads first ([`messages::Request::Identify`]) and pushes nothing unasked.
//!
//! [`plant_link`] is a second, separate link for hardware in the loop.

pub mod frame;
pub mod messages;
pub mod plant_link;
pub mod refusal;
pub mod telemetry;

/// Version of the protocol: changes whenever the bytes of an existing message change.
pub const PROTOCOL: u16 = 2;
