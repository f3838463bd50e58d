//! The demonstration of the bedside page without a server: nine lungs, each with a PID and beside it with the shipped learned
//! controller, run in the browser. `cargo xtask web --demo` compiles it to WebAssembly.
//!
//! A [`patient`] is a simulated chip, [`virtual_chip`], with the host's end of its link. The [`demo`] runs all of them at the pace of
//! the page's clock, and speaks the server's stream with the page. In their place the page shows a real [`board`] whose port it has
//! opened, and it can [`flash`] one. [`exports`] is what the page calls.
#![deny(unsafe_code)]

pub mod board;
pub mod demo;
pub mod exports;
pub mod flash;
mod line;
pub mod page;
pub mod patient;
