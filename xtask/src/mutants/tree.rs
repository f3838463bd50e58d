//! A copy of the source tree in which mutants are built.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};
use serde::Deserialize;
use xshell::{Shell, cmd};

/// Where the copy and its builds are.
const TREE: &str = "target/mutants/tree";
const BUILDS: &str = "target/mutants/builds";

/// The copy.
pub struct Tree<'a> {
    shell: &'a Shell,
    path: PathBuf,
}

/// What a build serves, and so what it is to save.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Serves {
    /// Many mutants: time in which they run.
    Many,
    /// A single one: time in which it is built.
    One,
}

/// What a build ends with.
pub enum Built {
    /// The program with the unit tests of `shared`.
    Program(PathBuf),
    /// Files, relative to the tree, and lines of what does not compile.
    Errors(Vec<(String, usize)>),
}

/// A message of cargo, in as far as it matters here.
#[derive(Deserialize)]
struct Message {
    executable: Option<PathBuf>,
    message: Option<Diagnostic>,
}

#[derive(Deserialize)]
struct Diagnostic {
    level: String,
    spans: Vec<DiagnosticSpan>,
}

#[derive(Deserialize)]
struct DiagnosticSpan {
    file_name: String,
    line_start: usize,
    is_primary: bool,
}

impl<'a> Tree<'a> {
    /// Copies all files of the project that git does not ignore.
    pub fn copy(shell: &'a Shell) -> Result<Self> {
        let path = shell.current_dir().join(TREE);
        shell.remove_path(&path)?;
        let files = cmd!(shell, "git ls-files --cached --others --exclude-standard").quiet().read()?;
        for file in files.lines().filter(|file| shell.path_exists(file)) {
            let to = path.join(file);
            shell.create_dir(to.parent().context("a file is in a folder")?)?;
            std::fs::copy(shell.current_dir().join(file), &to).with_context(|| file.to_owned())?;
        }
        Ok(Self { shell, path })
    }

    /// Replaces a file, by its path from the root.
    pub fn write(&self, file: &str, text: &str) -> Result<()> {
        Ok(self.shell.write_file(self.path.join(file), text)?)
    }

    /// The folder in which the tests run.
    pub fn folder(&self) -> PathBuf {
        self.path.join("shared")
    }

    /// Builds the unit tests of `shared`.
    pub fn build(&self, serves: Serves) -> Result<Built> {
        let shell = self.shell;
        let _folder = shell.push_dir(&self.path);
        let level = if serves == Serves::Many { "1" } else { "0" };
        let builds = Path::new("../../..").join(BUILDS);
        let lines = cmd!(
            shell,
            "cargo test --package shared --lib --no-run --profile mutants --message-format json --target-dir {builds}"
        )
        .env("CARGO_PROFILE_MUTANTS_OPT_LEVEL", level)
        .quiet()
        .ignore_stderr()
        .ignore_status()
        .read()?;
        let mut errors = Vec::new();
        for line in lines.lines() {
            let Ok(Message { executable, message }) = serde_json::from_str(line) else { continue };
            if let Some(program) = executable {
                return Ok(Built::Program(program));
            }
            let spans = message.filter(|message| message.level == "error").into_iter().flat_map(|m| m.spans);
            errors.extend(spans.filter(|span| span.is_primary).map(|span| (span.file_name, span.line_start)));
        }
        if errors.is_empty() {
            bail!("the tests of shared do not compile; run: cargo test --package shared --lib");
        }
        Ok(Built::Errors(errors))
    }
}
