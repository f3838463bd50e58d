//! Output for people: reports with figures, a watched device in lines, a flight recorder on a page.
#![forbid(unsafe_code)]

pub mod blackbox;
pub mod monitor;
pub mod report;
