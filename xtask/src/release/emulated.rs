//! The release's firmware in QEMU: it starts, and runs the weights that the release file writes to its flash.

use std::net::TcpListener;
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use anyhow::{Context, Result, ensure};
use firmware_file::{Content, Package};
use serde_json::Value;
use xshell::{Shell, cmd};

use super::VERSION;
use crate::firmware::MAIN_BOARD;
use crate::memory;

/// The emulated board's file with the sectors of its flash that change.
const FLASH: &str = "flash.bin";
/// Longest time until the board answers.
const PATIENCE: Duration = Duration::from_mins(1);

/// Starts the emulated board with the weights of the main board's release file.
pub fn check(shell: &Shell, folder: &Path, place: &Path, package: &Package, trainer: &Path) -> Result<()> {
    cmd!(shell, "bash .ci/setup/qemu").quiet().run()?;
    let (images, board) = (place.join("images"), shell.create_dir(place.join("board"))?);
    let packed = folder.join(format!("eupnea-{VERSION}-qemu.zip"));
    cmd!(shell, "python3 -m zipfile -e {packed} {images}").quiet().run()?;
    shell.write_file(board.join(FLASH), flash(&shell.read_file(MAIN_BOARD)?, package)?)?;
    let port = TcpListener::bind("127.0.0.1:0")?.local_addr()?.port();
    let child = Command::new(trainer)
        .args(["qemu", "--listen", &port.to_string(), "--fast"])
        .arg("--images")
        .arg(&images)
        .arg("--folder")
        .arg(&board)
        .stdout(Stdio::null())
        .spawn()?;
    let _running = Running(child);
    let found = identity(shell, trainer, &format!("tcp:localhost:{port}"))?;
    let identity = &found["identity"];
    ensure!(identity["running"] == "A", "the board does not run the weights of the release: {identity}");
    println!("firmware: the board in QEMU runs the weights of the release");
    Ok(())
}

/// The emulator, which ends with this check.
struct Running(Child);

impl Drop for Running {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// The sectors that change, with the weights of a release; all else is erased.
fn flash(map: &str, package: &Package) -> Result<Vec<u8>> {
    let regions = memory::regions(map)?;
    let (first, last) = (memory::find(&regions, "CALIBRATIONS")?, memory::find(&regions, "SLOT_B")?);
    let mut flash = vec![0xFF; (last.origin + last.length - first.origin) as usize];
    for (part, content) in package.parts().filter(|(part, _)| part.content == Content::Weights) {
        let start = (u64::from(part.address) - first.origin) as usize;
        flash
            .get_mut(start..start + content.len())
            .context("weights outside the slots")?
            .copy_from_slice(content);
    }
    Ok(flash)
}

/// What the board says of itself, as soon as it answers.
fn identity(shell: &Shell, trainer: &Path, port: &str) -> Result<Value> {
    let begun = Instant::now();
    loop {
        let answer = cmd!(shell, "{trainer} identify --port {port} --json -").quiet().ignore_stderr().read();
        match answer {
            Ok(answer) => return Ok(serde_json::from_str(&answer)?),
            Err(error) => ensure!(begun.elapsed() < PATIENCE, "the board does not answer: {error}"),
        }
        std::thread::sleep(Duration::from_millis(500));
    }
}
