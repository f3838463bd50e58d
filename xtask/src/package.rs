//! `cargo xtask package`: builds the wheel that users install, installs it with pip and tries its programs, then lints and tests the
//! package and runs its notebook.

use std::path::{Path, PathBuf};

use anyhow::Result;
use xshell::{Shell, cmd};

use crate::{python, release};

/// Folder of the package.
pub const PACKAGE: &str = "python";
/// Installs the package into a virtual environment of its own and checks it.
pub fn run(shell: &Shell) -> Result<()> {
    let python = environment(shell, "package")?;
    println!("package: building and installing it for {}", python.display());
    let wheel = release::for_tests(shell, &python)?;
    install(shell, &python, &wheel, "[test]")?;
    release::try_programs(shell, &python)?;
    // In the package's folder, `import eupnea` would find the sources, which have no native half.
    let _folder = shell.push_dir(format!("{PACKAGE}/tests"));
    for tool in ["ruff check ..", "ruff format --check ..", "pytest"] {
        let words: Vec<_> = tool.split(' ').collect();
        cmd!(shell, "{python} -m {words...}").quiet().run()?;
    }
    cmd!(shell, "{python} -m mypy --config-file ../pyproject.toml -p eupnea").quiet().run()?;
    cmd!(shell, "{python} notebook.py").quiet().run()?;
    Ok(())
}

/// Installs a wheel with its dependencies of an extra, in place of an earlier one of the same version.
pub fn install(shell: &Shell, python: &Path, wheel: &Path, extra: &str) -> Result<()> {
    let mut package = wheel.as_os_str().to_owned();
    package.push(extra);
    cmd!(shell, "{python} -m pip install --quiet {package}").quiet().run()?;
    cmd!(shell, "{python} -m pip install --quiet --force-reinstall --no-deps {wheel}").quiet().run()?;
    Ok(())
}

/// The interpreter of a virtual environment in `target/`, which is created where it is missing.
pub fn environment(shell: &Shell, name: &str) -> Result<PathBuf> {
    python::ensure(shell)?;
    let environment = shell.current_dir().join("target/python").join(name);
    let python = environment.join("bin/python");
    if !python.exists() {
        cmd!(shell, "python3 -m venv {environment}").quiet().run()?;
    }
    Ok(python)
}
