//! `cargo xtask web`: checks the bedside page and tests it in Chromium, on a fake server and on the real one, which shows a simulated
//! device and the real image in QEMU. With `--demo`, it builds the page without a server.

use std::ffi::OsString;
use std::iter;
use std::path::Path;

use anyhow::{Result, bail};
use xshell::{Shell, cmd};

use crate::firmware;
use crate::npm::{self, PAGE};
use crate::trainer::Trainer;
use crate::web_demo;

/// Test files that run at the same time: most of their time they wait for breaths and flashes.
const AT_ONCE: usize = 3;
/// Where the set-up puts node and npm if the machine's are too old.
const NODE: &str = "target/node/bin";

/// Arguments of `cargo xtask web`.
#[derive(clap::Args)]
pub struct Arguments {
    /// Only take the pictures of the documents again: docs/figures/bedside-*.png; needs pngquant
    #[arg(long)]
    screenshots: bool,
    /// Only compile the demonstration to WebAssembly, build its page into docs/demo, and test both
    #[arg(long, conflicts_with_all = ["screenshots", "filters"])]
    demo: bool,
    /// Run only the browser tests whose names contain one of these texts, which are regular expressions
    filters: Vec<String>,
}

/// Checks and tests the page, or takes its pictures.
pub fn run(shell: &Shell, arguments: &Arguments) -> Result<()> {
    let _path = shell.push_env("PATH", path(shell)?);
    let mut needed = vec!["node", "npm"];
    needed.extend(arguments.screenshots.then_some("pngquant"));
    find(shell, &needed)?;
    if arguments.demo {
        return web_demo::run(shell);
    }
    let trainer = Trainer::build(shell)?;
    let images = firmware::build_unsigned(shell)?;
    let root = shell.current_dir();
    let _folder = shell.push_dir(PAGE);
    npm::install(shell)?;
    if arguments.screenshots {
        return Ok(cmd!(shell, "node dev/screenshots.mjs")
            .env("TRAINER", trainer.program())
            .quiet()
            .run()?);
    }
    if arguments.filters.is_empty() {
        cmd!(shell, "npm run --silent check").quiet().run()?;
        cmd!(shell, "npm test --silent").quiet().run()?;
        cmd!(shell, "node build.mjs --check").quiet().run()?;
        let _root = shell.push_dir(&root);
        web_demo::check(shell)?;
    }
    browse(shell, trainer.program(), images.folder(), &arguments.filters)
}

/// The folders of programs: first the one of a node that the set-up has installed.
fn path(shell: &Shell) -> Result<OsString> {
    let machine = std::env::var_os("PATH").unwrap_or_default();
    let own = shell.current_dir().join(NODE);
    Ok(std::env::join_paths(iter::once(own).chain(std::env::split_paths(&machine)))?)
}

/// Fails unless these programs are present.
fn find(shell: &Shell, programs: &[&str]) -> Result<()> {
    for program in programs {
        let probe = cmd!(shell, "{program} --version").quiet().ignore_stdout().ignore_stderr();
        if probe.run().is_err() {
            bail!("{program} is missing: {}", remedy(program));
        }
    }
    Ok(())
}

/// How to install a program.
fn remedy(program: &str) -> &'static str {
    match program {
        "pngquant" => "install it, on Debian with: apt-get install pngquant",
        _ => "run cargo xtask setup, which installs node and npm, or install node 20 or newer with npm",
    }
}

/// Runs the browser tests. None may be left out, as they are elsewhere if a program is missing.
fn browse(shell: &Shell, trainer: &Path, images: &Path, filters: &[String]) -> Result<()> {
    let mut files = shell.read_dir("test")?;
    files.retain(|file| file.to_string_lossy().ends_with(".browser.mjs"));
    let only = filters.iter().map(|filter| format!("--test-name-pattern={filter}"));
    let at_once = AT_ONCE.to_string();
    cmd!(shell, "node --test --test-reporter=spec --test-concurrency={at_once} {only...} {files...}")
        .env("TRAINER", trainer)
        .env("IMAGES", images)
        .env("SKIP_NOTHING", "1")
        .quiet()
        .run()?;
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_missing_program_is_named_with_its_remedy() {
        let shell = Shell::new().unwrap();
        let missing = find(&shell, &["cargo", "eupnea-has-no-such-program"]).unwrap_err().to_string();
        assert_eq!(
            missing,
            "eupnea-has-no-such-program is missing: run cargo xtask setup, which installs node and npm, or install \
             node 20 or newer with npm"
        );
        find(&shell, &["cargo"]).unwrap();
    }
}
