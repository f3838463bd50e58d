//! The order of layers, held to every file: ARCHITECTURE.md lists them from the top down, every path in the
//! code points down the list, no files of a crate form a circle, and the host side never uses the laboratory.
//!
//! A *place* is a module at the root of a crate, or the crate's root file (`lib`). A place may use places
//! further down in its crate, and crates further down the list. Tests may use anything that compiles.

mod circles;
mod list;
mod paths;
mod planted;
mod resolve;
mod sources;

use std::collections::BTreeSet;
use std::fs;
use std::path::Path;
use std::sync::LazyLock;

use circles::circles;
use list::{HEADING, Layers, Place};
use sources::{Krate, crates};

/// The top of the repository.
const TOP: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/..");

/// The crates of the repository.
static CRATES: LazyLock<Vec<Krate>> = LazyLock::new(|| crates(Path::new(TOP)));

fn layers() -> Layers {
    let path = Path::new(TOP).join("ARCHITECTURE.md");
    Layers::parse(&fs::read_to_string(path).expect("ARCHITECTURE.md can be read"))
}

/// The crates in the list: all but the chip's and the automation.
fn listed_crates() -> impl Iterator<Item = &'static Krate> {
    CRATES.iter().filter(|krate| !krate.folder.starts_with("firmware") && !krate.folder.starts_with("xtask"))
}

/// Uses of the laboratory on the host side, in manifests and in files.
fn uses_of_the_laboratory(crates: &[Krate]) -> Vec<String> {
    let in_lab =
        |name: &str| crates.iter().any(|krate| krate.folder.starts_with("lab") && krate.name == name);
    let mut found = Vec::new();
    for krate in crates.iter().filter(|krate| krate.folder.starts_with("host")) {
        let listed = krate.dependencies.iter().filter(|name| in_lab(name));
        found.extend(listed.map(|name| format!("{}/Cargo.toml lists {name}", krate.folder.display())));
        for source in &krate.sources {
            let outside = source.named().filter_map(|(within, path)| krate.outside(within, path));
            let named: BTreeSet<&str> = outside.filter(|name| in_lab(name)).collect();
            found.extend(named.iter().map(|name| format!("{} names {name}", source.path.display())));
        }
    }
    found
}

#[test]
fn the_list_names_every_place_once() {
    let layers = layers();
    let listed: BTreeSet<&Place> = layers.0.iter().collect();
    assert_eq!(listed.len(), layers.0.len(), "a place is in the list twice");
    let places_of = |krate: &'static Krate| krate.sources.iter().map(|source| Place::of(krate, source));
    let places: BTreeSet<Place> = listed_crates().flat_map(places_of).collect();
    let found: BTreeSet<&Place> = places.iter().collect();
    let missing: Vec<String> = found.difference(&listed).map(ToString::to_string).collect();
    let gone: Vec<String> = listed.difference(&found).map(ToString::to_string).collect();
    assert!(missing.is_empty(), "add to the list under `{HEADING}` in ARCHITECTURE.md: {missing:?}");
    assert!(gone.is_empty(), "these places do not exist, remove them from the list: {gone:?}");
    assert!(layers.crates().len() > 10, "too few crates found: {:?}", layers.crates());
}

#[test]
fn every_path_points_down_the_list() {
    let layers = layers();
    let found: Vec<String> = listed_crates().flat_map(|krate| layers.offences(&CRATES, krate)).collect();
    assert!(found.is_empty(), "move the used code down, or its user up:\n{}", found.join("\n"));
}

#[test]
fn no_files_form_a_circle() {
    for name in ["shared", "host", "python", "firmware", "shim", "xtask"] {
        let files = CRATES.iter().filter(|krate| krate.name == name).map(|krate| krate.sources.len());
        assert!(files.sum::<usize>() > 5, "too few files of {name}");
    }
    let found: Vec<String> = CRATES.iter().flat_map(circles).collect();
    assert!(found.is_empty(), "move what both files use into a file below them:\n{}", found.join("\n"));
}

#[test]
fn the_host_side_never_uses_the_laboratory() {
    let found = uses_of_the_laboratory(&CRATES);
    assert!(found.is_empty(), "move the user to lab/, or the used code to host/:\n{}", found.join("\n"));
}
