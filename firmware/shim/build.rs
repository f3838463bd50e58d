//! Links the shim to the memory that the firmware leaves free. Its examples are firmware, and are linked like the firmware.

use std::path::PathBuf;
use std::{env, fs, io};

const MEMORY_MAP: &str = "../../memory.x";
/// Regions of the board that QEMU models.
const REGIONS: &str = "../memory/stm32f405.x";
const SHIM_MAP: &str = "shim.ld";

fn main() -> io::Result<()> {
    println!("cargo::rerun-if-changed={MEMORY_MAP}");
    println!("cargo::rerun-if-changed={SHIM_MAP}");
    if env::var("CARGO_CFG_TARGET_OS").as_deref() != Ok("none") {
        return Ok(());
    }
    let variable = |name| env::var_os(name).map(PathBuf::from).ok_or_else(|| io::Error::other(name));
    let folder = variable("OUT_DIR")?;
    fs::copy(MEMORY_MAP, folder.join("memory.x"))?;
    fs::copy(REGIONS, folder.join("regions.x"))?;
    println!("cargo::rustc-link-search={}", folder.display());
    let map = variable("CARGO_MANIFEST_DIR")?.join(SHIM_MAP);
    println!("cargo::rustc-link-arg-bins=-T{}", map.display());
    println!("cargo::rustc-link-arg-examples=-Tlink.x");
    println!("cargo::rustc-link-arg-examples=-Tdefmt.x");
    Ok(())
}
