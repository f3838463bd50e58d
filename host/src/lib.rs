//! The `trainer` command line: arguments and printing. The crates below do the computation.
//!
//! [`command`] is the frame, for any list of commands; [`args`] has arguments that several commands share; [`cli`] has the commands.
#![forbid(unsafe_code)]

#[macro_use]
pub mod command;
pub mod args;
pub mod cli;
