//! `trainer monitor`: shows an operator the state of a running device, and turns keys into requests.
//!
//! A view neither talks to a device nor reads a clock: it takes [`News`] and returns requests. The same news always
//! give the same picture, so pictures can be tested.

pub mod capture;
pub mod draw;
pub mod plain;
pub mod session;
pub mod terminal;
pub mod view;
pub mod window;
pub mod words;

#[cfg(test)]
mod tests;

pub use monitoring::News;
