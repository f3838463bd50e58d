//! Passes the linker the memory regions of the board's chip, which memory.x in the root of the workspace includes, and the scripts that
//! place the program in them.
//!
//! The variable `EUPNEA_WEIGHTS_KEY` contains the public key whose weights the firmware runs, as `trainer keys` writes it; without
//! it the build is one for development. `EUPNEA_WEIGHTS_PLANT` contains the id of the plant for which these weights must be, as
//! `trainer inspect` shows it; without it they may be for any plant.

use std::path::PathBuf;
use std::{env, fs, io};

/// A board's feature, its memory regions, and those of its image for the desk.
const BOARDS: [[&str; 3]; 2] = [
    ["STM32F405", "memory/stm32f405.x", "memory/stm32f405-desk.x"],
    ["STM32F446", "memory/stm32f446.x", "memory/stm32f446-desk.x"],
];

/// Variable with the public key.
const KEY: &str = "EUPNEA_WEIGHTS_KEY";
/// Variable with the plant's id.
const PLANT: &str = "EUPNEA_WEIGHTS_PLANT";
/// Length of a plant's id in a weights image, bytes.
const PLANT_BYTES: usize = 16;

fn main() -> io::Result<()> {
    let chosen: Vec<_> =
        BOARDS.iter().filter(|[board, ..]| env::var_os(format!("CARGO_FEATURE_{board}")).is_some()).collect();
    let [[_, map, desk]] = chosen[..] else {
        let boards = BOARDS.map(|[board, ..]| board.to_lowercase()).join(", ");
        return Err(io::Error::other(format!("select exactly one board with --features: {boards}")));
    };
    let map = if env::var_os("CARGO_FEATURE_DESK").is_some() { desk } else { map };
    println!("cargo::rerun-if-changed={map}");
    println!("cargo::rerun-if-changed=../memory.x");
    let folder = env::var_os("OUT_DIR").map(PathBuf::from);
    let folder = folder.ok_or_else(|| io::Error::other("OUT_DIR is not set: build with cargo"))?;
    fs::copy(map, folder.join("regions.x"))?;
    // The linker finds it in the root of the workspace, but only if it is called from there.
    fs::copy("../memory.x", folder.join("memory.x"))?;
    println!("cargo::rerun-if-env-changed={KEY}");
    println!("cargo::rerun-if-env-changed={PLANT}");
    let key = weights_key()?;
    let plant = weights_plant(key.is_some())?;
    fs::write(folder.join("weights_key.rs"), format!("{key:?}"))?;
    fs::write(folder.join("weights_plant.rs"), format!("{plant:?}"))?;
    select_plant()?;
    println!("cargo::rustc-link-search={}", folder.display());
    if env::var("CARGO_CFG_TARGET_OS").as_deref() == Ok("none") {
        println!("cargo::rustc-link-arg-bins=-Tlink.x");
        println!("cargo::rustc-link-arg-bins=-Tdefmt.x");
    }
    Ok(())
}

/// Sets the condition `bedside` for an image with sensors and valves: without a feature that puts something in their place.
fn select_plant() -> io::Result<()> {
    println!("cargo::rustc-check-cfg=cfg(bedside)");
    let others = ["HIL", "DESK"].map(|plant| env::var_os(format!("CARGO_FEATURE_{plant}")).is_some());
    match others {
        [false, false] => println!("cargo::rustc-cfg=bedside"),
        [true, true] => return Err(io::Error::other("select at most one of --features hil and desk")),
        _ => {}
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
