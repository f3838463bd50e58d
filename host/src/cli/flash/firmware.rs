//! Firmware of a release or of an own build, loaded through a debug probe.

use std::ffi::OsStr;
use std::fs;
use std::io::ErrorKind;
use std::path::Path;
use std::process::Command;

use anyhow::{Context as _, bail};
use firmware_file::{Package, ReleaseKey, chip_of, read};

use crate::command::Context;

/// The board if none is named.
const MAIN: &str = "stm32f405";
/// What remains to be done.
pub const LOADED: &str = "loaded and verified; press the board's reset button, or switch it off and on";

/// Reads and verifies the file of a release for a board.
pub fn open(file: &Path, trust: Option<ReleaseKey>, board: &str) -> anyhow::Result<Package> {
    let name = file.display();
    let bytes = fs::read(file).with_context(|| format!("cannot read {name}"))?;
    let package = read(&bytes, &key(trust)?).map_err(|error| anyhow::anyhow!("{name}: {error}"))?;
    let firmware = &package.manifest.firmware;
    if firmware.board != board {
        bail!(
            "{name} is for the board {} ({}), not for {board}: take the file of your board",
            firmware.board,
            firmware.image
        );
    }
    Ok(package)
}

/// The key that must have signed a release.
fn key(trust: Option<ReleaseKey>) -> anyhow::Result<ReleaseKey> {
    match trust {
        Some(key) => Ok(key),
        None => ReleaseKey::built_in().context("EUPNEA_RELEASE_KEY, with which this program was built")?.context(
            "this program was built without a release key: name the public key of the release with --trust, 64 hexadecimal digits",
        ),
    }
}

/// Loads the parts of a verified release.
pub fn load(package: &Package) -> anyhow::Result<()> {
    let folder = tempfile::tempdir().context("cannot make a temporary folder")?;
    for (part, bytes) in package.parts() {
        let file = folder.path().join("part.bin");
        fs::write(&file, bytes).with_context(|| format!("cannot write {}", file.display()))?;
        let address = format!("{:#x}", part.address);
        let format = ["--binary-format", "bin", "--base-address", &address];
        download(&package.manifest.firmware.chip, &format, &file)?;
    }
    Ok(())
}

/// Loads an image of an own build.
pub fn load_own(image: &Path, board: Option<&str>, context: &Context<'_>) -> anyhow::Result<()> {
    if !image.exists() {
        bail!("{} does not exist; build it with: cargo xtask firmware", image.display());
    }
    let board = board.unwrap_or(MAIN);
    let chip = chip_of(board).with_context(|| {
        format!("no board is named {board}: see docs/HARDWARE.md, or call probe-rs yourself")
    })?;
    download(chip, &[], image)?;
    context.line(LOADED);
    Ok(())
}

/// Calls probe-rs: as a library, it would bring about a hundred crates into every build of this program.
fn download(chip: &str, format: &[&str], file: &Path) -> anyhow::Result<()> {
    let fixed = ["download", "--verify", "--chip", chip];
    let arguments = fixed.iter().chain(format).map(OsStr::new).chain([file.as_os_str()]);
    let status = match Command::new("probe-rs").args(arguments).status() {
        Ok(status) => status,
        Err(error) if error.kind() == ErrorKind::NotFound => bail!(
            "probe-rs is not installed: take it from https://probe.rs, or load a release by USB with --dfu if the board has it"
        ),
        Err(error) => return Err(error).context("cannot run probe-rs"),
    };
    if !status.success() {
        bail!("probe-rs failed (see above): check that the probe is plugged in and the board powered");
    }
    Ok(())
}
