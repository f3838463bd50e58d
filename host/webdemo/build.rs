//! Writes the gains of the best single PID of the adult family as a constant. Reading the family's file in the browser would make the
//! module half as large again.

use std::path::Path;
use std::{env, fs};

use toml::{Table, Value};

/// Description of the family.
const FAMILY: &str = "../plant/src/bench/family/adult.toml";

fn main() {
    println!("cargo:rerun-if-changed={FAMILY}");
    let text = fs::read_to_string(FAMILY).expect("the family's description is readable");
    let family: Table = text.parse().expect("the family's description is TOML");
    let [p, i, d] = ["p", "i", "d"].map(|name| gain(&family, name));
    let constant = format!("PidGains {{ p: {p:?}, i: {i:?}, d: {d:?} }}");
    let folder = env::var("OUT_DIR").expect("cargo names a folder");
    fs::write(Path::new(&folder).join("rival.rs"), constant).expect("the folder is writable");
}

/// A gain of the family's PID. A test compares the gains with those of the family as the program reads it.
fn gain(family: &Table, name: &str) -> f32 {
    let number = family["pid"].get(name).and_then(Value::as_float);
    number.unwrap_or_else(|| panic!("{FAMILY} has no number {name} in its table [pid]")) as f32
}
