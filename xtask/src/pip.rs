//! Virtual environments of Python in `target/`, and what pip installs into them.

use std::path::{Path, PathBuf};

use anyhow::Result;
use xshell::{Shell, cmd};

use crate::python;

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

/// Installs a wheel with its dependencies of an extra, in place of an earlier one of the same version.
pub fn install(shell: &Shell, python: &Path, wheel: &Path, extra: &str) -> Result<()> {
    let mut package = wheel.as_os_str().to_owned();
    package.push(extra);
    cmd!(shell, "{python} -m pip install --quiet {package}").quiet().run()?;
    cmd!(shell, "{python} -m pip install --quiet --force-reinstall --no-deps {wheel}").quiet().run()?;
    Ok(())
}
