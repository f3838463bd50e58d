//! `cargo xtask setup`: makes the toolchain able to build for the chip, and installs QEMU for the virtual board.
//!
//! For the toolchain three ways, the first that works: nothing to do; `rustup target add`; or, on a Debian machine that reaches a
//! package mirror but not rustup's server, the core library built from Debian's source of the same release.

mod debian;
mod qemu;

use anyhow::{Result, ensure};
use xshell::{Shell, cmd};

use crate::CHIP_TARGET;

/// Uses both libraries that the image needs.
const PROBE: &str = "#![no_std]
extern crate alloc;
pub fn probe(x: f32) -> alloc::vec::Vec<f32> { alloc::vec![x] }
";

/// Arguments of `cargo xtask setup`.
#[derive(clap::Args)]
pub struct Arguments {
    /// Leave QEMU out: enough to build the firmware
    #[arg(long)]
    target_only: bool,
}

/// Prepares whatever is missing.
pub fn run(shell: &Shell, arguments: &Arguments) -> Result<()> {
    prepare_toolchain(shell)?;
    if arguments.target_only { Ok(()) } else { qemu::run(shell) }
}

fn prepare_toolchain(shell: &Shell) -> Result<()> {
    if can_build(shell)? {
        println!("{CHIP_TARGET}: present");
        return Ok(());
    }
    if added_by_rustup(shell) && can_build(shell)? {
        println!("{CHIP_TARGET}: added by rustup");
        return Ok(());
    }
    println!("{CHIP_TARGET}: rustup could not add it, building the core library from Debian's source");
    debian::install(shell)?;
    ensure!(
        can_build(shell)?,
        "the core library was built but rustc does not accept it; run: rustup target add {CHIP_TARGET}"
    );
    println!("{CHIP_TARGET}: built from source");
    Ok(())
}

/// Whether a program for the chip compiles, which a look into folders would not tell.
pub fn can_build(shell: &Shell) -> Result<bool> {
    let folder = shell.create_temp_dir()?;
    let (source, object) = (folder.path().join("probe.rs"), folder.path().join("probe.o"));
    shell.write_file(&source, PROBE)?;
    let rustc = cmd!(
        shell,
        "rustc --edition 2024 --crate-type lib --emit obj --target {CHIP_TARGET} -o {object} {source}"
    );
    let output = rustc.quiet().ignore_status().ignore_stderr().output()?;
    Ok(output.status.success())
}

/// Without retries: where rustup's server is out of reach, waiting does not bring it closer.
fn added_by_rustup(shell: &Shell) -> bool {
    let rustup = cmd!(shell, "rustup target add {CHIP_TARGET}").env("RUSTUP_MAX_RETRIES", "0");
    rustup.quiet().run().is_ok()
}
