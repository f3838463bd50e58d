//! The `trainer` command line: arguments and printing; what a command computes is in the crates below.
#![forbid(unsafe_code)]

pub mod cli;
