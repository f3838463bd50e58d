//! The `trainer` command line as its users meet it: the real program, its output, its files, its exit codes.

mod bad_input;
#[cfg(unix)]
mod blackbox;
mod help;
mod interrupted;
mod pipeline;
mod plant;
mod recordings;
mod support;
