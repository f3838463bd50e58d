//! Writes the gains of the best single PID of the adult family as a constant. Reading the family's file in the browser would make the
//! module half as large again.

use std::path::Path;
use std::{env, fs};

/// Description of the family.
const FAMILY: &str = "../plant/src/bench/family/adult.toml";

fn main() {
    println!("cargo:rerun-if-changed={FAMILY}");
    let text = fs::read_to_string(FAMILY).expect("the family's description is readable");
    let [p, i, d] = ["p", "i", "d"].map(|name| gain(&text, name));
    let constant = format!("PidGains {{ p: {p:?}, i: {i:?}, d: {d:?} }}");
    let folder = env::var("OUT_DIR").expect("cargo names a folder");
    fs::write(Path::new(&folder).join("rival.rs"), constant).expect("the folder is writable");
}

/// A number of the table `[pid]`. A test compares the gains with those that a reader of TOML finds.
fn gain(text: &str, name: &str) -> f32 {
    let lines = text.lines().skip_while(|line| *line != "[pid]").skip(1);
    let mut table = lines.take_while(|line| !line.starts_with('['));
    let number = table.find_map(|line| line.strip_prefix(name)?.trim_start().strip_prefix('='));
    let number: f64 = number
        .and_then(|number| number.trim().parse().ok())
        .unwrap_or_else(|| panic!("{FAMILY} has no number {name} in a line of the table [pid]"));
    number as f32
}
