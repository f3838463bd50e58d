//! The `lab` command line: arguments and printing. The crates below and the host's do the computation.
//!
//! [`cli`] has the commands, [`args`] the arguments that only the laboratory has; frame and other arguments are the host's.
#![forbid(unsafe_code)]

pub mod args;
pub mod cli;
