//! The `trainer` command line; everything is in `host::cli`.

fn main() -> std::process::ExitCode {
    match host::cli::run() {
        Ok(()) => std::process::ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("error: {error:#}");
            std::process::ExitCode::FAILURE
        }
    }
}
