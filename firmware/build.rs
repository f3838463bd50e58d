//! Passes the linker the memory map of the board's chip, and the scripts that place the program in it. The map of the main
//! board is in the root of the workspace.
//!
//! The variable `EUPNEA_WEIGHTS_KEY` contains the public key whose weights the firmware runs, as `trainer keys` writes it; without
//! it the build is one for development. `EUPNEA_WEIGHTS_PLANT` contains the id of the plant for which these weights must be, as
//! `trainer inspect` shows it; without it they may be for any plant.

use std::path::PathBuf;
use std::{env, fs, io};

/// Feature and memory map of each board.
const BOARDS: [(&str, &str); 2] = [("STM32F405", "../memory.x"), ("STM32F446", "memory/stm32f446.x")];

/// Variable with the public key.
const KEY: &str = "EUPNEA_WEIGHTS_KEY";
/// Variable with the plant's id.
const PLANT: &str = "EUPNEA_WEIGHTS_PLANT";
/// Length of a plant's id in a weights image, bytes.
const PLANT_BYTES: usize = 16;

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
    println!("cargo::rerun-if-env-changed={KEY}");
    println!("cargo::rerun-if-env-changed={PLANT}");
    let key = weights_key()?;
    let plant = weights_plant(key.is_some())?;
    fs::write(folder.join("weights_key.rs"), format!("{key:?}"))?;
    fs::write(folder.join("weights_plant.rs"), format!("{plant:?}"))?;
    println!("cargo::rustc-link-search={}", folder.display());
    if env::var("CARGO_CFG_TARGET_OS").as_deref() == Ok("none") {
        println!("cargo::rustc-link-arg-bins=-Tlink.x");
        println!("cargo::rustc-link-arg-bins=-Tdefmt.x");
    }
    Ok(())
}

/// The key's bytes, if there is a key.
fn weights_key() -> io::Result<Option<Vec<u8>>> {
    let text = env::var(KEY).unwrap_or_default();
    let digits = text.trim();
    if digits.is_empty() {
        return Ok(None);
    }
    let whole = digits.len() == 64 && digits.bytes().all(|digit| digit.is_ascii_hexdigit());
    let wrong =
        || io::Error::other(format!("{KEY} must have 64 hexadecimal digits, as in a file of `trainer keys`"));
    let bytes: Option<Vec<u8>> =
        (0..32).map(|index| u8::from_str_radix(digits.get(2 * index..2 * index + 2)?, 16).ok()).collect();
    bytes.filter(|_| whole).ok_or_else(wrong).map(Some)
}

/// The id of the plant, padded with zeros as in a weights image, if there is one.
fn weights_plant(has_key: bool) -> io::Result<Option<[u8; PLANT_BYTES]>> {
    let text = env::var(PLANT).unwrap_or_default();
    if text.is_empty() {
        return Ok(None);
    }
    let mut plant = [0; PLANT_BYTES];
    let place = plant.get_mut(..text.len()).filter(|_| has_key);
    let wrong = || io::Error::other(format!("{PLANT} needs {KEY}, and has at most {PLANT_BYTES} bytes"));
    place.ok_or_else(wrong)?.copy_from_slice(text.as_bytes());
    Ok(Some(plant))
}
