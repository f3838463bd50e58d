//! `trainer monitor`: what an operator sees of a device that runs, and what a key asks of it.
//!
//! | file | holds |
//! |---|---|
//! | [`view`] | what is known of the device, from its events and answers; keys to requests |
//! | [`window`] | the last seconds of telemetry, for the charts |
//! | [`words`] | modes, faults and controllers as text |
//! | [`draw`] | a view on a terminal of any size |
//! | [`plain`] | what happens, as lines for a file or a pipe |
//! | [`session`] | the thread that talks to the device |
//! | [`terminal`] | pictures and keys |
//!
//! A view never talks to a device and knows no clock: it takes in [`news::News`] and gives requests. So it shows the
//! same for the same news, and each picture can be tested.

pub mod draw;
pub mod news;
pub mod plain;
pub mod session;
pub mod terminal;
pub mod view;
pub mod window;
pub mod words;

#[cfg(test)]
mod tests;
