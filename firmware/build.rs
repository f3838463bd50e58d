//! Hands the linker the chip's memory map, which stands in the root of the workspace, and the linker scripts that place
//! the program in it.

use std::path::PathBuf;
use std::{env, fs, io};

const MEMORY_MAP: &str = "../memory.x";

fn main() -> io::Result<()> {
    println!("cargo::rerun-if-changed={MEMORY_MAP}");
    let folder = env::var_os("OUT_DIR").map(PathBuf::from);
    let folder = folder.ok_or_else(|| io::Error::other("cargo sets OUT_DIR for build scripts"))?;
    fs::copy(MEMORY_MAP, folder.join("memory.x"))?;
    println!("cargo::rustc-link-search={}", folder.display());
    if env::var("CARGO_CFG_TARGET_OS").as_deref() == Ok("none") {
        println!("cargo::rustc-link-arg-bins=-Tlink.x");
        println!("cargo::rustc-link-arg-bins=-Tdefmt.x");
    }
    Ok(())
}
