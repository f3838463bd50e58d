//! The programs of a release for another machine: built by cargo, linked by Zig, which has the C libraries of all targets. Both come
//! from the Python registry.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use xshell::{PushEnv, Shell, cmd};

use crate::firmware::cargo_folder;
use crate::pip::environment;
use crate::web_demo::remapped;

/// Profile of a release's programs.
pub const PROFILE: &str = "dist";
/// The oldest glibc that programs for a distribution's C library run with.
const GLIBC: &str = "2.28";
/// Tools of the build.
const TOOLS: [&str; 4] = ["cargo-zigbuild", "maturin>=1.9,<2", "wheel", "ziglang"];

/// A kind of machine, as compilers name it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Target {
    /// Linux with glibc on this processor.
    Glibc(Processor),
    /// Any Linux on this processor, with the C library in the program.
    Static(Processor),
    /// Windows on x86-64.
    Windows,
}

/// A processor.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Processor {
    X86,
    Arm,
}

impl Processor {
    pub const ALL: [Self; 2] = [Self::X86, Self::Arm];

    /// Its name to compilers and in files.
    pub const fn name(self) -> &'static str {
        match self {
            Self::X86 => "x86_64",
            Self::Arm => "aarch64",
        }
    }

    /// Its name to Debian.
    pub const fn debian(self) -> &'static str {
        match self {
            Self::X86 => "amd64",
            Self::Arm => "arm64",
        }
    }
}

impl Target {
    /// Its name to the compiler.
    pub fn triple(self) -> String {
        match self {
            Self::Glibc(processor) => format!("{}-unknown-linux-gnu", processor.name()),
            Self::Static(processor) => format!("{}-unknown-linux-musl", processor.name()),
            Self::Windows => "x86_64-pc-windows-gnu".to_owned(),
        }
    }

    /// Its name to Zig, with the oldest version of the C library.
    fn linked(self) -> String {
        let version = if matches!(self, Self::Glibc(_)) { format!(".{GLIBC}") } else { String::new() };
        self.triple() + &version
    }

    /// Names of the programs, and last of the library inside an FMU, as a compiler writes them for this target. A static program
    /// cannot be a library.
    pub const fn files(self) -> &'static [&'static str] {
        match self {
            Self::Glibc(_) => &["trainer", "lab", "libeupnea_fmu.so"],
            Self::Static(_) => &["trainer", "lab"],
            Self::Windows => &["trainer.exe", "lab.exe", "eupnea_fmu.dll"],
        }
    }
}

/// Builds the programs; returns the paths of [`Target::files`].
pub fn build(shell: &Shell, target: Target) -> Result<Vec<PathBuf>> {
    let (triple, linked) = (target.triple(), target.linked());
    let _tools = tools(shell)?;
    let packages: &[&str] = match target {
        Target::Static(_) => &["-p", "host", "-p", "lab", "--bins"],
        _ => &["-p", "host", "-p", "lab", "-p", "fmu_library", "--bins", "--lib"],
    };
    cmd!(shell, "bash .ci/setup/target {triple}").quiet().run()?;
    cmd!(shell, "cargo zigbuild --profile {PROFILE} --target {linked} {packages...}")
        .env("RUSTFLAGS", remapped(shell)?)
        .quiet()
        .run()
        .with_context(|| format!("cannot build the programs for {triple}"))?;
    let folder = cargo_folder(shell).join(triple).join(PROFILE);
    Ok(target.files().iter().map(|file| folder.join(file)).collect())
}

/// Cross-compiles the package's native half for a target; returns the wheel.
pub fn wheel(shell: &Shell, target: Target, folder: &Path) -> Result<PathBuf> {
    let triple = target.triple();
    let _tools = tools(shell)?;
    let compatibility = format!("manylinux_{}", GLIBC.replace('.', "_"));
    let options = ["--zig", "--compatibility", &compatibility, "--target", &triple, "--profile", PROFILE];
    cmd!(shell, "maturin build --manifest-path python/Cargo.toml {options...} --out {folder}")
        .env("RUSTFLAGS", remapped(shell)?)
        .quiet()
        .run()?;
    only_file(shell, folder)
}

/// Puts the tools first in `PATH`; installs them if they are missing.
pub fn tools(shell: &Shell) -> Result<PushEnv<'_>> {
    let python = environment(shell, "release")?;
    let programs = python.with_file_name("");
    if !programs.join("cargo-zigbuild").exists() || !programs.join("wheel").exists() {
        cmd!(shell, "{python} -m pip install --quiet {TOOLS...}").quiet().run()?;
    }
    let path = std::env::var_os("PATH").unwrap_or_default();
    let paths = std::env::join_paths(std::iter::once(programs).chain(std::env::split_paths(&path)))?;
    Ok(shell.push_env("PATH", paths))
}

/// The file of a folder that contains only one.
pub fn only_file(shell: &Shell, folder: &Path) -> Result<PathBuf> {
    let files = shell.read_dir(folder)?;
    files.into_iter().next().with_context(|| format!("no file in {}", folder.display()))
}
