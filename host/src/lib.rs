//! The `trainer` command line: arguments and printing. The crates below do the computation.
#![forbid(unsafe_code)]

pub mod cli;
