//! `cargo xtask package`: builds the wheel that users install, installs it with pip and tries its programs, then lints and tests the
//! package and runs its notebook.

use anyhow::Result;
use xshell::{Shell, cmd};

use crate::pip::{environment, install};
use crate::release;

/// Installs the package into a virtual environment of its own and checks it.
pub fn run(shell: &Shell) -> Result<()> {
    let python = environment(shell, "package")?;
    println!("package: building and installing it for {}", python.display());
    let wheel = release::for_tests(shell, &python)?;
    install(shell, &python, &wheel, "[test]")?;
    release::try_programs(shell, &python)?;
    // In the package's folder, `import eupnea` would find the sources, which have no native half.
    let _folder = shell.push_dir("python/tests");
    for tool in ["ruff check ..", "ruff format --check ..", "pytest"] {
        let words: Vec<_> = tool.split(' ').collect();
        cmd!(shell, "{python} -m {words...}").quiet().run()?;
    }
    cmd!(shell, "{python} -m mypy --config-file ../pyproject.toml -p eupnea").quiet().run()?;
    cmd!(shell, "{python} notebook.py").quiet().run()?;
    Ok(())
}
