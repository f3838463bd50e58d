//! `cargo xtask qemu-test`: every test on the real image in QEMU.

use anyhow::{Context, Result};
use serde::Deserialize;
use xshell::{Shell, cmd};

use crate::firmware;

/// Where the golden test leaves what it found.
const GOLDEN: &str = "golden.json";
/// Names the folder of the images to the tests.
const IMAGES: &str = "EUPNEA_IMAGES";

/// What the golden test on the image found.
#[derive(Debug, Deserialize)]
pub struct Golden {
    /// Hash of all commands, on this computer.
    pub hash_host: String,
    /// The same on the image.
    pub hash_qemu: String,
    /// Mean work of a tick, instructions.
    pub tick_mean: u32,
    /// Longest work of a tick, instructions.
    pub tick_worst: u32,
}

/// Builds the images and runs the tests that need QEMU; arguments are filters of their names.
pub fn run(shell: &Shell, filters: &[String]) -> Result<()> {
    let images = firmware::build(shell)?;
    firmware::build_probe(shell)?;
    let folder = images.folder();
    // Of the same packages as all other tests, lest their dependencies be built again.
    let packages = ["--workspace", "--exclude", "firmware", "--features", "tests/board"];
    cmd!(shell, "cargo test {packages...} --test emulator --test qemu -- {filters...}")
        .env(IMAGES, folder)
        .quiet()
        .run()?;
    Ok(())
}

/// The golden test's findings; runs it unless they are newer than the image.
pub fn golden(shell: &Shell) -> Result<Golden> {
    let images = firmware::build(shell)?;
    let path = images.folder().join(GOLDEN);
    let written = |path: &std::path::Path| std::fs::metadata(path).and_then(|data| data.modified()).ok();
    if written(&path) < written(&images.hil) {
        run(shell, &["golden".to_owned()])?;
    }
    let text = shell.read_file(&path)?;
    serde_json::from_str(&text).with_context(|| format!("cannot read {}", path.display()))
}
