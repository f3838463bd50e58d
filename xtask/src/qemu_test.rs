//! `cargo xtask qemu-test`: runs every test of the real image in QEMU, and those of the C export with all compilers.

use std::path::Path;

use anyhow::{Context, Result};
use serde::Deserialize;
use xshell::{Shell, cmd};

use crate::firmware;

/// File with the results of the golden test.
const GOLDEN: &str = "golden.json";
/// The golden test.
const GOLDEN_TEST: &str = "golden_trace_of_learned_weights";
/// Environment variable that gives the tests the folder of the images.
const IMAGES: &str = "EUPNEA_IMAGES";

/// Results of the golden test on the image.
#[derive(Debug, Deserialize)]
pub struct Golden {
    /// Hash of all commands on this computer.
    pub hash_host: String,
    /// Hash of all commands on the image.
    pub hash_qemu: String,
    /// Mean work of a tick, instructions.
    pub tick_mean: u32,
    /// Longest work of a tick, instructions.
    pub tick_worst: u32,
}

/// Builds the images and runs the tests that need QEMU; `filters` select them by name.
pub fn run(shell: &Shell, filters: &[String]) -> Result<()> {
    let images = firmware::build_unsigned(shell)?;
    firmware::build_signed(shell)?;
    firmware::build_probe(shell)?;
    test(shell, images.folder(), &["c_export", "emulator", "qemu"], filters)
}

/// Runs tests, with the images of a folder.
fn test(shell: &Shell, images: &Path, programs: &[&str], filters: &[String]) -> Result<()> {
    // The same packages as for all other tests, so that their dependencies are not built again.
    let packages = ["--workspace", "--exclude", "firmware", "--features", "tests/board"];
    let programs = programs.iter().flat_map(|program| ["--test", program]);
    cmd!(shell, "cargo test {packages...} {programs...} -- {filters...}")
        .env(IMAGES, images)
        .quiet()
        .run()?;
    Ok(())
}

/// Results of the golden test; runs it if the image is newer than they are.
pub fn golden(shell: &Shell) -> Result<Golden> {
    let images = firmware::build_unsigned(shell)?;
    let path = images.folder().join(GOLDEN);
    let written = |path: &Path| std::fs::metadata(path).and_then(|data| data.modified()).ok();
    if written(&path) < written(&images.hil) {
        test(shell, images.folder(), &["qemu"], &[GOLDEN_TEST.to_owned()])?;
    }
    let text = shell.read_file(&path)?;
    serde_json::from_str(&text).with_context(|| format!("cannot read {}", path.display()))
}
