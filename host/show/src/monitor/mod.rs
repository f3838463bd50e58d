//! A device that is watched: the session with it, its news as lines and as an MCAP file.
//!
//! Lines and capture neither talk to a device nor read a clock: they take [`News`]. The same news always give the same
//! text, so it can be tested.

pub mod capture;
pub mod plain;
pub mod session;
pub mod words;

#[cfg(test)]
mod tests;

pub use monitoring::News;
