//! The bedside page: watches devices and shows them in browsers, live.
#![forbid(unsafe_code)]

pub mod alarms;
pub mod figures;
pub mod guard;
pub mod stream;
