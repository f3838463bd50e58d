//! The `lab` binary; all code is in the library.
#![forbid(unsafe_code)]

fn main() -> std::process::ExitCode {
    host::command::main::<lab::cli::Cli>()
}
