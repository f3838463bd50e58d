//! QEMU: the check of its presence and version, and the command line of a board.

use std::io;
use std::path::Path;
use std::process::Command;

use crate::error::{EmulatorError, LEAST_VERSION, PROGRAM, tried};

/// Virtual time: 2^3 ns per instruction, without waiting for real time while the core sleeps.
const CLOCK: &str = "shift=3,sleep=off";

/// Checks that QEMU can run the board.
pub(super) fn check() -> Result<(), EmulatorError> {
    let output = Command::new(PROGRAM).arg("--version").output().map_err(|error| match error.kind() {
        io::ErrorKind::NotFound => EmulatorError::QemuMissing,
        _ => tried("cannot start QEMU")(error),
    })?;
    let text = String::from_utf8_lossy(&output.stdout);
    match major(&text) {
        Some(major) if major >= LEAST_VERSION => Ok(()),
        _ => Err(EmulatorError::QemuTooOld(text.lines().next().unwrap_or_default().to_owned())),
    }
}

/// The major version.
fn major(text: &str) -> Option<u32> {
    let (_, after) = text.split_once("version ")?;
    after.split('.').next()?.parse().ok()
}

/// The command that runs a board. The link's listening socket is its standard input and the debugger's its standard
/// output, so that no other program can take the ports in between.
pub(super) fn command(firmware: &Path, shim: &Path, debugger: bool) -> Command {
    let mut command = Command::new(PROGRAM);
    command
        .args(["-M", "netduinoplus2", "-nodefaults", "-display", "none", "-monitor", "none"])
        .args(["-semihosting-config", "enable=on,target=native", "-icount", CLOCK])
        .args(["-chardev", "socket,id=link,fd=0,server=on,wait=off,nodelay=on", "-serial", "chardev:link"])
        .arg("-kernel")
        .arg(firmware)
        .arg("-device")
        .arg(format!("loader,file={},cpu-num=0", escaped(shim)));
    if debugger {
        command
            .args(["-chardev", "socket,id=debugger,fd=1,server=on,wait=off,nodelay=on"])
            .args(["-gdb", "chardev:debugger"]);
    }
    command
}

/// A path in a list of options, where a comma is doubled.
fn escaped(path: &Path) -> String {
    path.display().to_string().replace(',', ",,")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_version_is_read() {
        assert_eq!(major("QEMU emulator version 10.0.2 (Debian 1:10.0.2+ds-2)\n"), Some(10));
        assert_eq!(major("QEMU emulator version 7.2.17\n"), Some(7));
        assert_eq!(major("something else"), None);
    }

    #[test]
    fn commas_in_paths_are_kept() {
        assert_eq!(escaped(Path::new("a,b/shim")), "a,,b/shim");
    }
}
