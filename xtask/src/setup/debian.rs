//! The core library for the chip, built from Debian's package `rust-src` of the toolchain's own release.
//!
//! Everything is fetched by apt from the mirror that the machine already uses, with Debian's own signatures, into
//! `target/`; apt's own state is not touched. Debian leaves most vendored crates out of the package, so instead of the
//! standard library's workspace a small one of core, alloc and `compiler_builtins` is built.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};
use xshell::{Shell, cmd};

use crate::CHIP_TARGET;

/// Debian's own keys.
pub(super) const KEYRING: &str = "/usr/share/keyrings/debian-archive-keyring.gpg";
/// Suites that carry recent releases of Rust.
const SUITES: [&str; 3] = ["trixie-backports", "forky", "sid"];
/// Libraries that a program without std links.
const LIBRARIES: [&str; 3] = ["core", "alloc", "compiler_builtins"];

/// As the distributors of Rust build these libraries.
const WORKSPACE: &str = r#"[workspace]
resolver = "1"
members = ["alloc"]

[profile.release]
codegen-units = 1
debug = 1

[profile.release.package.compiler_builtins]
codegen-units = 10000
"#;

/// Builds the libraries and puts them into the toolchain.
pub fn install(shell: &Shell) -> Result<()> {
    let toolchain = Toolchain::active(shell)?;
    let work = shell.current_dir().join("target/chip-sysroot").join(&toolchain.release);
    let library = work.join(format!("usr/src/rustc-{}", toolchain.release)).join("library");
    // Written last, so that an interrupted run starts over.
    let complete = work.join("fetched");
    if !shell.path_exists(&complete) {
        shell.remove_path(&work)?;
        fetch(shell, &toolchain, &work)?;
        reduce(shell, &library)?;
        shell.write_file(&complete, "")?;
    }
    let target = work.join("target");
    let built = build(shell, &toolchain, &library, &target)?;
    copy_libraries(shell, &built, &toolchain.target_libraries())?;
    // Half a gigabyte that nobody needs again.
    shell.remove_path(target)?;
    Ok(())
}

/// The toolchain that the libraries are for.
#[derive(Debug, PartialEq, Eq)]
struct Toolchain {
    release: String,
    commit: String,
    sysroot: PathBuf,
}

impl Toolchain {
    fn active(shell: &Shell) -> Result<Self> {
        let version = cmd!(shell, "rustc -vV").quiet().read()?;
        let sysroot = cmd!(shell, "rustc --print sysroot").quiet().read()?;
        Ok(Self {
            release: field(&version, "release")?.to_owned(),
            commit: field(&version, "commit-hash")?.to_owned(),
            sysroot: sysroot.into(),
        })
    }

    fn target_libraries(&self) -> PathBuf {
        self.sysroot.join("lib/rustlib").join(CHIP_TARGET).join("lib")
    }
}

/// A field of `rustc -vV`.
fn field<'a>(version: &'a str, name: &str) -> Result<&'a str> {
    let value = version.lines().find_map(|line| line.strip_prefix(name)?.strip_prefix(": "));
    value.with_context(|| format!("rustc -vV does not tell its {name}"))
}

/// Downloads and unpacks the library's source.
fn fetch(shell: &Shell, toolchain: &Toolchain, work: &Path) -> Result<()> {
    let mirror = configured_mirror(shell)?;
    let apt = work.join("apt");
    let (lists, cache, sources) = (apt.join("lists"), apt.join("cache"), apt.join("sources.list"));
    for folder in [lists.join("partial"), cache.join("archives/partial")] {
        shell.create_dir(folder)?;
    }
    shell.write_file(&sources, source_list(&mirror))?;
    let options: Vec<String> = [
        format!("Dir::State::Lists={}", lists.display()),
        format!("Dir::Etc::SourceList={}", sources.display()),
        "Dir::Etc::SourceParts=/dev/null".into(),
        format!("Dir::Cache={}", cache.display()),
        "APT::Sandbox::User=root".into(),
        "Acquire::Languages=none".into(),
        "Acquire::IndexTargets::deb::DEP-11::DefaultEnabled=false".into(),
    ]
    .into_iter()
    .flat_map(|option| ["-o".into(), option])
    .collect();
    let options = &options;

    cmd!(shell, "apt-get {options...} update -qq").quiet().run()?;
    let versions = cmd!(shell, "apt-cache {options...} madison rust-src").quiet().read()?;
    let version = packaged(&versions, &toolchain.release)?;
    {
        let _folder = shell.push_dir(work);
        cmd!(shell, "apt-get {options...} download -qq rust-src={version}").quiet().run()?;
    }
    let packages = shell.read_dir(work)?;
    let package = packages.iter().find(|path| path.extension().is_some_and(|extension| extension == "deb"));
    let package = package.context("apt-get downloaded no package")?;
    cmd!(shell, "dpkg-deb --extract {package} {work}").quiet().run()?;
    shell.remove_path(package)?;
    shell.remove_path(apt)?;
    Ok(())
}

/// The mirror of the machine's own apt configuration.
pub(super) fn configured_mirror(shell: &Shell) -> Result<String> {
    let mut files = shell.read_dir("/etc/apt/sources.list.d").unwrap_or_default();
    files.push("/etc/apt/sources.list".into());
    let mut texts = files.iter().filter_map(|file| shell.read_file(file).ok());
    texts.find_map(|text| mirror(&text).map(str::to_owned)).with_context(|| {
        format!("apt knows no mirror of Debian; on another system run: rustup target add {CHIP_TARGET}")
    })
}

/// The first address of a Debian archive in an apt source file.
fn mirror(sources: &str) -> Option<&str> {
    let lines = sources.lines().filter(|line| !line.trim_start().starts_with('#'));
    lines
        .flat_map(str::split_whitespace)
        .find(|word| word.starts_with("http") && word.trim_end_matches('/').ends_with("/debian"))
}

fn source_list(mirror: &str) -> String {
    let line = |suite| format!("deb [signed-by={KEYRING}] {mirror} {suite} main\n");
    SUITES.map(line).concat()
}

/// The version of the package that holds `release`, from apt-cache's list of all versions.
fn packaged<'a>(versions: &'a str, release: &str) -> Result<&'a str> {
    let version = versions
        .lines()
        .filter_map(|line| line.split('|').nth(1).map(str::trim))
        .find(|version| version.strip_prefix(release).is_some_and(|rest| rest.starts_with('+')));
    match version {
        Some(version) => Ok(version),
        None => bail!("Debian has no source of Rust {release}; run: rustup target add {CHIP_TARGET}"),
    }
}

/// Reduces the standard library's workspace to what builds without network.
fn reduce(shell: &Shell, library: &Path) -> Result<()> {
    shell.write_file(library.join("Cargo.toml"), WORKSPACE)?;
    shell.remove_path(library.join("Cargo.lock"))?;
    let builtins = library.join("compiler-builtins/compiler-builtins/Cargo.toml");
    let manifest = shell.read_file(&builtins)?;
    shell.write_file(&builtins, without_c_compiler(&manifest))?;
    Ok(())
}

/// The manifest without its optional dependency on a C compiler, which Debian's package lacks.
fn without_c_compiler(manifest: &str) -> String {
    let kept = manifest.lines().filter(|line| !line.starts_with("cc = {"));
    let edited = kept
        .map(|line| if line == r#"c = ["dep:cc"]"# { "c = []\n".to_owned() } else { format!("{line}\n") });
    edited.collect()
}

/// Builds the libraries; gives the folder that holds them.
fn build(shell: &Shell, toolchain: &Toolchain, library: &Path, target: &Path) -> Result<PathBuf> {
    let manifest = library.join("alloc/Cargo.toml");
    // Paths as in the released libraries, so that debuggers find the source.
    let rustflags = format!(
        "-Zforce-unstable-if-unmarked -Cembed-bitcode=yes --remap-path-prefix={}=/rustc/{}/library",
        library.display(),
        toolchain.commit
    );
    let mut cargo = cmd!(
        shell,
        "cargo build --quiet --offline --release --features compiler-builtins-mem
            --manifest-path {manifest} --target {CHIP_TARGET} --target-dir {target}"
    );
    for variable in ["CARGO_BUILD_TARGET", "CARGO_ENCODED_RUSTFLAGS", "RUSTC_WRAPPER"] {
        cargo = cargo.env_remove(variable);
    }
    cargo
        // Only the standard library may use unstable features, and this is the standard library.
        .env("RUSTC_BOOTSTRAP", "1")
        .env("__CARGO_DEFAULT_LIB_METADATA", "stablealloc")
        .env("CARGO_PROFILE_RELEASE_LTO", "off")
        .env("RUSTFLAGS", rustflags)
        .quiet()
        .run()?;
    Ok(target.join(CHIP_TARGET).join("release/deps"))
}

/// Replaces the toolchain's libraries of the chip by those just built.
fn copy_libraries(shell: &Shell, built: &Path, folder: &Path) -> Result<()> {
    shell.create_dir(folder)?;
    for old in shell.read_dir(folder)?.iter().filter(|path| is_library(path)) {
        shell.remove_path(old)?;
    }
    for new in shell.read_dir(built)?.iter().filter(|path| is_library(path)) {
        shell.copy_file(new, folder)?;
    }
    Ok(())
}

/// Whether a file is one of [`LIBRARIES`] as rustc names them.
fn is_library(path: &Path) -> bool {
    let name = path.file_name().and_then(|name| name.to_str());
    let stem = name.and_then(|name| name.strip_prefix("lib")?.strip_suffix(".rlib"));
    stem.and_then(|stem| stem.split_once('-')).is_some_and(|(library, _)| LIBRARIES.contains(&library))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_mirror_is_taken_from_either_form_of_apts_files() {
        let modern =
            "Types: deb\n# http://old.example/debian\nURIs: http://mirror.example/debian\nSuites: stable\n";
        assert_eq!(mirror(modern), Some("http://mirror.example/debian"));
        let classic = "deb [arch=amd64] https://mirror.example/debian/ stable main\n";
        assert_eq!(mirror(classic), Some("https://mirror.example/debian/"));
    }

    #[test]
    fn archives_of_security_fixes_and_of_others_are_no_mirror() {
        let others =
            "URIs: http://mirror.example/debian-security\ndeb https://tool.example/apt stable main\n";
        assert_eq!(mirror(others), None);
    }

    #[test]
    fn the_package_must_hold_the_toolchains_own_release() {
        let versions = "  rust-src | 1.96.0+dfsg1-1 | mirror sid/main\n  rust-src | 1.95.0+dfsg1-2 | mirror forky/main\n";
        assert_eq!(packaged(versions, "1.95.0").unwrap(), "1.95.0+dfsg1-2");
        let missing = packaged(versions, "1.9").unwrap_err().to_string();
        assert!(missing.contains("rustup target add"), "{missing}");
    }

    #[test]
    fn the_c_compiler_leaves_the_manifest() {
        let manifest =
            "[build-dependencies]\ncc = { optional = true }\n[features]\nc = [\"dep:cc\"]\nmem = []\n";
        assert_eq!(without_c_compiler(manifest), "[build-dependencies]\n[features]\nc = []\nmem = []\n");
    }

    #[test]
    fn only_the_libraries_themselves_are_copied() {
        let names =
            ["libcore-1a.rlib", "libcompiler_builtins-2b.rlib", "libcore-1a.rmeta", "liballoc.d", "x.rlib"];
        let kept: Vec<_> = names.into_iter().filter(|name| is_library(Path::new(name))).collect();
        assert_eq!(kept, ["libcore-1a.rlib", "libcompiler_builtins-2b.rlib"]);
    }

    #[test]
    fn a_field_of_the_version_is_found_by_its_whole_name() {
        let version = "rustc 1.95.0\ncommit-hash: abc\nrelease: 1.95.0\n";
        assert_eq!(field(version, "release").unwrap(), "1.95.0");
        assert!(field(version, "commit").is_err());
    }
}
