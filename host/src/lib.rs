//! The learning side of Eupnea.
#![forbid(unsafe_code)]

pub mod bench;
