//! Output for people: reports with figures, a device in the terminal, a flight recorder on a page.
#![forbid(unsafe_code)]

pub mod blackbox;
pub mod monitor;
pub mod report;
