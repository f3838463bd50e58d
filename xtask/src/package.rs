//! `cargo xtask package`: installs the Python package with pip, then lints and tests it and runs its notebook. `cargo xtask wheel`
//! builds it for other machines.

use std::path::PathBuf;

use anyhow::Result;
use xshell::{Shell, cmd};

use crate::python;

/// Folder of the package.
const PACKAGE: &str = "python";
/// Oldest C library that the wheel runs with: glibc 2.28. Maturin fails if the wheel needs a newer one.
const PORTABLE: &str = "manylinux_2_28";
/// Folder of the wheel.
const WHEELS: &str = "target/wheels";

/// Arguments with which the package is built for its tests: in the profile of the host's tests, whose crates are there already. The
/// profile of a user's package needs minutes more.
const QUICK: (&str, &str) = ("MATURIN_PEP517_ARGS", "--profile dev");

/// Installs the package into a virtual environment of its own and checks it.
pub fn run(shell: &Shell) -> Result<()> {
    let python = environment(shell, "package")?;
    println!("package: building and installing it for {}", python.display());
    cmd!(shell, "{python} -m pip install --quiet ./{PACKAGE}[test]").env(QUICK.0, QUICK.1).quiet().run()?;
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

/// Builds a wheel that runs on any Linux since glibc 2.28. Zig links it against the symbols of that library.
pub fn wheel(shell: &Shell) -> Result<()> {
    let python = environment(shell, "wheel")?;
    cmd!(shell, "{python} -m pip install --quiet maturin ziglang").quiet().run()?;
    let options = ["--zig", "--compatibility", PORTABLE, "--out", WHEELS];
    // Maturin finds Zig as a package of the first Python in PATH.
    let programs = python.with_file_name("");
    let path = std::env::var_os("PATH").unwrap_or_default();
    let paths = std::env::join_paths(std::iter::once(programs).chain(std::env::split_paths(&path)))?;
    let _path = shell.push_env("PATH", paths);
    cmd!(shell, "{python} -m maturin build --manifest-path {PACKAGE}/Cargo.toml {options...}")
        .quiet()
        .run()?;
    Ok(())
}

/// The interpreter of a virtual environment in `target/`, which is created where it is missing.
fn environment(shell: &Shell, name: &str) -> Result<PathBuf> {
    python::ensure(shell)?;
    let environment = shell.current_dir().join("target/python").join(name);
    let python = environment.join("bin/python");
    if !python.exists() {
        cmd!(shell, "python3 -m venv {environment}").quiet().run()?;
    }
    Ok(python)
}
