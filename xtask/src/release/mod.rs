//! `cargo xtask release`: builds what users install, from a tagged revision, into `target/artifacts`.
//!
//! | part | files | module |
//! |---|---|---|
//! | `wheels` | Python packages with the programs, for x86-64 and arm64 | [`wheels`] |
//! | `archives` | static programs for any Linux, x86-64 and arm64 | [`archives`] |
//! | `packages` | Debian packages, amd64 and arm64 | [`debian`] |
//! | `windows` | programs for Windows, x86-64 | [`archives`] |
//! | `firmware` | images of all boards with weights, signed, and those for QEMU | [`boards`] |
//! | `lists` | parts of chip and host as `CycloneDX`, the demonstration, and checksums of all files | this one |
//!
//! The files name neither a folder of the machine nor a time but that of the revision, so that two builds can be compared.
//! [`check`] tries what was built, and [`emulated`] the firmware.

mod archives;
mod boards;
mod check;
mod debian;
mod emulated;
mod programs;
mod wheels;

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, ensure};
use clap::ValueEnum;
use firmware_file::sha256;
use xshell::{PushEnv, Shell, cmd};

use crate::firmware::cargo_folder;
use crate::papers::{results, sbom};
use boards::Key;
pub use wheels::{for_tests, try_programs};

/// Version of this release.
const VERSION: &str = env!("CARGO_PKG_VERSION");
/// List of the files' checksums, as `sha256sum --check` reads it, and its signature.
const SUMS: &str = "SHA256SUMS";
const SIGNATURE: &str = "SHA256SUMS.sig";

/// Arguments of `cargo xtask release`.
#[derive(clap::Args)]
#[command(after_help = "\
Examples:
  trainer keys --out release.key
  git tag -a v0.1.0 && cargo xtask release --key release.key
  cargo xtask release --trial --only wheels
  cargo xtask release --check")]
pub struct Arguments {
    /// Build only these parts [default: all]
    #[arg(long, value_name = "PART")]
    only: Vec<Part>,
    /// Private key that signs firmware and checksums, made by `trainer keys --out FILE`
    #[arg(long, value_name = "FILE", required_unless_present_any = ["trial", "check"])]
    key: Option<PathBuf>,
    /// Build from a revision without a tag or a changed tree; without --key, signed with the key of the tests
    #[arg(long)]
    trial: bool,
    /// Build nothing: install and start what is in target/artifacts, and compare the results of all machines
    #[arg(long, conflicts_with_all = ["key", "trial"])]
    check: bool,
}

/// What a release consists of.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum Part {
    Wheels,
    Archives,
    Packages,
    Windows,
    Firmware,
    Lists,
}

impl Part {
    fn build(self, release: &Release<'_>) -> Result<()> {
        match self {
            Self::Wheels => wheels::build(release),
            Self::Archives => archives::linux(release),
            Self::Packages => debian::build(release),
            Self::Windows => archives::windows(release),
            Self::Firmware => boards::build(release),
            Self::Lists => lists(release),
        }
    }
}

/// What all parts need.
struct Release<'a> {
    shell: &'a Shell,
    revision: String,
    /// Time of the revision, seconds since 1970.
    time_s: u64,
    key: Key,
    /// Where the files go.
    folder: PathBuf,
}

/// Builds the chosen parts, or checks those that are built.
pub fn run(shell: &Shell, arguments: &Arguments) -> Result<()> {
    let chosen = |part: Part| arguments.only.is_empty() || arguments.only.contains(&part);
    let folder = cargo_folder(shell).join("artifacts");
    if arguments.check {
        return check::run(shell, &folder, &chosen);
    }
    if !arguments.trial {
        may_release(shell)?;
    }
    let key = arguments.key.as_deref().map_or_else(|| Ok(Key::of_the_tests()), Key::load)?;
    shell.create_dir(&folder)?;
    let release = Release {
        shell,
        revision: results::revision(shell),
        time_s: cmd!(shell, "git log -1 --format=%ct").quiet().read()?.parse()?,
        key,
        folder,
    };
    let _variables = release.variables();
    for part in Part::value_variants().iter().filter(|part| chosen(**part)) {
        println!("release: {part:?}");
        part.build(&release).with_context(|| format!("cannot build the {part:?} of the release"))?;
    }
    checksums(&release)
}

/// Fails unless the tree is exactly what a tag of this version names.
fn may_release(shell: &Shell) -> Result<()> {
    let changes = cmd!(shell, "git status --porcelain").quiet().read()?;
    ensure!(
        changes.is_empty(),
        "the tree has changes, which no tag names: commit them, or build a trial with --trial\n{changes}"
    );
    let tags = cmd!(shell, "git tag --points-at HEAD").quiet().read()?;
    ensure!(
        tags.lines().any(|tag| tag.strip_prefix('v') == Some(VERSION)),
        "this revision has no tag v{VERSION}: set it with `git tag -a v{VERSION}`, or build a trial with --trial"
    );
    Ok(())
}

impl Release<'_> {
    /// Variables of all builds.
    fn variables(&self) -> Vec<PushEnv<'_>> {
        let mut variables = vec![
            self.shell.push_env("SOURCE_DATE_EPOCH", self.time_s.to_string()),
            self.shell.push_env("EUPNEA_GIT_REVISION", &self.revision),
            self.shell.push_env("CARGO_INCREMENTAL", "0"),
        ];
        if self.key.is_secret() {
            variables.push(self.shell.push_env("EUPNEA_RELEASE_KEY", self.key.public()));
        }
        variables
    }

    /// An empty folder for the files of an artefact.
    fn staging(&self, name: &str) -> Result<PathBuf> {
        let folder = cargo_folder(self.shell).join("staging").join(name);
        self.shell.remove_path(&folder)?;
        self.shell.create_dir(&folder)?;
        Ok(folder)
    }
}

/// The parts of chip and host for machines, and the demonstration.
fn lists(release: &Release<'_>) -> Result<()> {
    for (file, list) in sbom::lists(release.shell, &release.revision, release.time_s)? {
        release.shell.write_file(release.folder.join(file), list)?;
    }
    let demo = release.folder.join(format!("eupnea-{VERSION}-web-demo.zip"));
    archives::zip(&demo, &files_of(release.shell, Path::new("docs/demo"))?, release.time_s)
}

/// The files of a folder, without its subfolders, by name.
fn files_of(shell: &Shell, folder: &Path) -> Result<BTreeMap<String, PathBuf>> {
    let paths = shell.read_dir(folder)?.into_iter().filter(|path| path.is_file());
    let name = |path: &Path| Some(path.file_name()?.to_str()?.to_owned());
    Ok(paths.filter_map(|path| Some((name(&path)?, path))).collect())
}

/// Writes the checksums of all files, and signs them.
fn checksums(release: &Release<'_>) -> Result<()> {
    let mut files = files_of(release.shell, &release.folder)?;
    files.retain(|name, _| name != SUMS && name != SIGNATURE);
    let sum = |(name, path): (&String, &PathBuf)| {
        Ok(format!("{}  {name}\n", sha256(&release.shell.read_binary_file(path)?)))
    };
    let sums = files.iter().map(sum).collect::<Result<String>>()?;
    print!("{sums}");
    release.shell.write_file(release.folder.join(SIGNATURE), release.key.sign(sums.as_bytes()))?;
    release.shell.write_file(release.folder.join(SUMS), sums)?;
    println!("release: {} files in {}", files.len(), release.folder.display());
    Ok(())
}

#[cfg(all(test, unix))]
mod tests {
    use super::*;

    /// A repository with one commit.
    fn repository() -> (tempfile::TempDir, Shell) {
        let (folder, shell) = (tempfile::tempdir().unwrap(), Shell::new().unwrap());
        shell.change_dir(folder.path());
        shell.write_file("file", "one").unwrap();
        for line in [
            "init --quiet",
            "config user.name Anna",
            "config user.email anna@example.org",
            "add file",
            "commit --quiet --message One",
        ] {
            git(&shell, line);
        }
        (folder, shell)
    }

    fn git(shell: &Shell, line: &str) {
        let words = line.split(' ');
        cmd!(shell, "git {words...}").quiet().run().unwrap();
    }

    #[test]
    fn only_an_unchanged_tree_with_the_tag_of_its_version_is_released() {
        let (_folder, shell) = repository();
        assert!(may_release(&shell).unwrap_err().to_string().contains("has no tag"));
        git(&shell, "tag v99.0.0");
        assert!(may_release(&shell).unwrap_err().to_string().contains("has no tag"));
        git(&shell, &format!("tag v{VERSION}"));
        may_release(&shell).unwrap();
        for (file, content) in [("new", ""), ("file", "two")] {
            shell.write_file(file, content).unwrap();
            let error = may_release(&shell).unwrap_err().to_string();
            assert!(
                error.contains("has changes") && error.contains(file) && error.contains("--trial"),
                "{error}"
            );
            git(&shell, "stash --quiet --include-untracked");
        }
    }
}
