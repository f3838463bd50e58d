//! Everything that host and chip have in common.
#![no_std]
#![forbid(unsafe_code)]
