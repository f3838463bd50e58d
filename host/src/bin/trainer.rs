//! The `trainer` command line; everything is in `host::cli`.

fn main() -> std::process::ExitCode {
    host::cli::run()
}
