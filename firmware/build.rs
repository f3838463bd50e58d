//! Passes the linker the memory map of the board's chip, and the scripts that place the program in it. The map of the main
//! board is in the root of the workspace.

use std::path::PathBuf;
use std::{env, fs, io};

/// Feature and memory map of each board.
const BOARDS: [(&str, &str); 2] = [("STM32F405", "../memory.x"), ("STM32F446", "memory/stm32f446.x")];

fn main() -> io::Result<()> {
    let chosen: Vec<_> =
        BOARDS.iter().filter(|(board, _)| env::var_os(format!("CARGO_FEATURE_{board}")).is_some()).collect();
    let [(_, map)] = chosen[..] else {
        let boards = BOARDS.map(|(board, _)| board.to_lowercase()).join(", ");
        return Err(io::Error::other(format!("select exactly one board with --features: {boards}")));
    };
    println!("cargo::rerun-if-changed={map}");
    let folder = env::var_os("OUT_DIR").map(PathBuf::from);
    let folder = folder.ok_or_else(|| io::Error::other("OUT_DIR is not set: build with cargo"))?;
    fs::copy(map, folder.join("memory.x"))?;
    println!("cargo::rustc-link-search={}", folder.display());
    if env::var("CARGO_CFG_TARGET_OS").as_deref() == Ok("none") {
        println!("cargo::rustc-link-arg-bins=-Tlink.x");
        println!("cargo::rustc-link-arg-bins=-Tdefmt.x");
    }
    Ok(())
}
