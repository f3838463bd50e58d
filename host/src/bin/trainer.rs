//! The `trainer` binary; all code is in `host::cli`.
#![forbid(unsafe_code)]

fn main() -> std::process::ExitCode {
    host::cli::run()
}
