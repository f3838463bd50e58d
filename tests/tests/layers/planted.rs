//! Faults in a small repository, which the checks must detect, and innocent code, which they must leave
//! alone.

use std::fs;

use tempfile::TempDir;

use crate::circles::circles;
use crate::list::Layers;
use crate::sources::{Krate, crates};
use crate::uses_of_the_laboratory;

/// Two crates in order, and files of the upper one that the planted sources stand beside.
const LIST: &str = "## Layers\n\n```text\ntop: high low\nbottom: lib deep\n```\n";
const TOP: (&str, &str) = ("host/top/src/lib.rs", "mod high; mod low; mod mid; pub use high::Given;");
const HIGH: (&str, &str) = (
    "host/top/src/high.rs",
    "pub struct Thing; pub struct Given; pub const NAME: &str = \"\"; pub fn f() {}",
);

/// A repository with these files, and with those of two crates that are not among them.
fn planted(files: &[(&str, &str)]) -> Vec<Krate> {
    let folder = TempDir::new().expect("a temporary folder");
    let manifest = |name: &str, others: &str| {
        format!("[package]\nname = \"{name}\"\n[dependencies]\nbottom.workspace = true\n{others}")
    };
    let write = |path: &str, text: &str| {
        let path = folder.path().join(path);
        fs::create_dir_all(path.parent().expect("a file is in a folder")).expect("a folder can be made");
        fs::write(path, text).expect("a file can be written");
    };
    write("host/top/Cargo.toml", &manifest("top", ""));
    write("shared/Cargo.toml", &manifest("bottom", "top = { workspace = true }\n"));
    for (path, text) in [
        TOP,
        HIGH,
        ("host/top/src/low.rs", "pub struct Own;"),
        ("host/top/src/mid/mod.rs", "pub mod inner; pub struct Error;"),
        ("host/top/src/mid/inner.rs", "pub struct Inner;"),
        ("shared/src/lib.rs", "pub mod deep; pub struct Item;"),
        ("shared/src/deep.rs", "pub struct Thing;"),
    ] {
        write(path, text);
    }
    for (path, text) in files {
        write(path, text);
    }
    crates(folder.path())
}

fn offences(path: &str, source: &str) -> usize {
    let (layers, crates) = (Layers::parse(LIST), planted(&[(path, source)]));
    let found = crates.iter().flat_map(|krate| layers.offences(&crates, krate));
    found.filter(|offence| offence.starts_with(path)).count()
}

#[test]
fn a_planted_offence_is_found_and_test_code_is_left_alone() {
    let (low, deep) = ("host/top/src/low.rs", "shared/src/deep.rs");
    for offence in [
        "use crate::high::Thing;",
        "use crate::{low, high};",
        "use super::high::Thing;",
        "use super::high::*;",
        "use crate::Given;",
        "use super::{Given as Renamed};",
        "pub(crate) use crate::high::Thing as Other; struct Both(Other);",
        "fn f() { crate::high::f() }",
        "fn f() { use crate::high; high::f() }",
        "fn f() { println!(\"{}\", crate::high::NAME) }",
        "fn f(_: &crate::high::Thing) {}",
        "mod within { use super::super::high::Thing; }",
    ] {
        assert_eq!(offences(low, offence), 1, "{offence}");
    }
    assert_eq!(offences(deep, "use top::low::Own;"), 1, "a crate above");
    assert_eq!(offences(deep, "use crate::Item;"), 1, "the root file stands above");
    for innocent in [
        "use bottom::deep::Thing;",
        "use crate::low::Own; pub struct Own;",
        "#[cfg(test)] mod tests { use crate::high::Thing; }",
        "#[cfg(all(test, unix))] use crate::high::Thing;",
        "struct Own; impl Own { #[cfg(test)] fn f() { crate::high::f() } }",
        "use ::high::Thing; fn f(_: ::high::Thing) {}",
        "/// Like [`crate::high::Thing`].\nfn f() {}",
    ] {
        assert_eq!(offences(low, innocent), 0, "{innocent}");
    }
}

/// Circles of the planted repository's upper crate, where `high` uses `low` and `mid` uses `mid::inner`.
fn circles_with(files: &[(&str, &str)]) -> Vec<String> {
    let mut all = vec![
        ("host/top/src/high.rs", "use crate::low::Own; pub struct Thing; pub struct Given;"),
        ("host/top/src/mid/mod.rs", "pub mod inner; use inner::Inner; pub struct Error;"),
    ];
    all.extend(files);
    planted(&all).iter().flat_map(circles).collect()
}

#[test]
fn a_planted_circle_is_found_with_its_files_and_paths() {
    let low = "host/top/src/low.rs";
    let expected = "a circle of 2 files:\
        \n    host/top/src/high.rs uses host/top/src/low.rs: crate::low::Own\
        \n    host/top/src/low.rs uses host/top/src/high.rs: super::high::Thing";
    assert_eq!(circles_with(&[(low, "use super::high::Thing; pub struct Own;")]), [expected]);
    for closing in [
        "pub struct Own(crate::high::Thing);",
        "pub use super::high::Thing as Other; pub struct Own(Other);",
        "use super::Given; pub struct Own;",
        "use super::{high, mid}; pub struct Own; fn f(_: high::Thing) {}",
        "pub struct Own; fn f() { vec![crate::high::Thing] }",
        "use super::high::*; pub struct Own;",
        "pub struct Own; mod within { use super::super::high::Thing; }",
    ] {
        assert_eq!(circles_with(&[(low, closing)]).len(), 1, "{closing}");
    }
}

#[test]
fn a_longer_circle_and_one_through_a_parent_are_found() {
    let inner = ("host/top/src/mid/inner.rs", "use crate::high::Thing; pub struct Inner;");
    assert_eq!(circles_with(&[inner]), [] as [&str; 0]);
    let through =
        circles_with(&[inner, ("host/top/src/low.rs", "use crate::mid::inner::Inner; pub struct Own;")]);
    assert!(through[0].starts_with("a circle of 3 files"), "{through:?}");
    let parent = circles_with(&[inner, ("host/top/src/low.rs", "use crate::mid::Error; pub struct Own;")]);
    assert!(parent[0].starts_with("a circle of 4 files"), "{parent:?}");
}

#[test]
fn a_child_may_use_its_ancestors_and_a_reexport_is_no_use() {
    for (path, innocent) in [
        ("host/top/src/mid/inner.rs", "use super::Error; pub struct Inner(Error);"),
        ("host/top/src/mid/inner.rs", "use crate::top_level; pub struct Inner;"),
        ("host/top/src/low.rs", "pub use super::high::Thing; pub struct Own;"),
        ("host/top/src/low.rs", "use super::high; pub struct Own;"),
        ("host/top/src/low.rs", "pub struct Own; #[cfg(test)] mod tests { use super::super::high::Thing; }"),
    ] {
        assert_eq!(circles_with(&[(path, innocent)]), [] as [&str; 0], "{innocent}");
    }
}

#[test]
fn a_use_of_the_laboratory_is_found_on_the_host_side_only() {
    let lab = [
        ("lab/laws/Cargo.toml", "[package]\nname = \"laws\"\n[dependencies]\ntop.workspace = true\n"),
        ("lab/laws/src/lib.rs", "use top::Given;"),
    ];
    let found = |files: &[(&str, &str)]| uses_of_the_laboratory(&planted(&[&lab, files].concat()));
    assert_eq!(found(&[]), [] as [&str; 0]);
    for table in ["dependencies", "dev-dependencies", "target.'cfg(unix)'.build-dependencies"] {
        let manifest = format!("[package]\nname = \"top\"\n[{table}]\nlaws.workspace = true\n");
        assert_eq!(found(&[("host/top/Cargo.toml", &manifest)]), ["host/top/Cargo.toml lists laws"]);
    }
    let named = found(&[("host/top/src/low.rs", "fn f() { laws::f() }")]);
    assert_eq!(named, ["host/top/src/low.rs names laws"]);
    assert_eq!(
        found(&[("host/top/src/low.rs", "mod laws { pub fn f() {} } fn f() { laws::f() }")]),
        [] as [&str; 0]
    );
}
