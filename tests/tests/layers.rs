//! The order of layers: ARCHITECTURE.md lists them from the top down, and every path in the code must point down the list.
//!
//! A *place* is a module at the root of a crate, or the crate's root file (`lib`). A place may use places further down in
//! its crate, and crates further down the list. Tests may use anything that compiles.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt;
use std::fs;
use std::path::{Path, PathBuf};

use proc_macro2::{TokenStream, TokenTree};
use syn::visit::{self, Visit};
use syn::{Attribute, Item, ItemUse, UseTree, Visibility};

/// Heading of the list in ARCHITECTURE.md.
const HEADING: &str = "## Layers";
/// Name of a crate's root file in the list.
const ROOT: &str = "lib";

/// A module at the root of a crate.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
struct Place {
    krate: String,
    module: String,
}

impl fmt::Display for Place {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}::{}", self.krate, self.module)
    }
}

/// The places in order, from the top down.
struct Layers(Vec<Place>);

impl Layers {
    /// Reads the code block below the heading: one line per crate, with its modules after a colon.
    fn parse(document: &str) -> Self {
        let (_, section) = document.split_once(HEADING).expect("the document has the heading");
        let block = section.split("```").nth(1).expect("a code block follows the heading");
        let lines = block.lines().filter_map(|line| line.split_once(':'));
        let places = lines.flat_map(|(krate, modules)| {
            let place = |module: &str| Place { krate: krate.trim().to_owned(), module: module.to_owned() };
            modules.split_whitespace().map(place).collect::<Vec<_>>()
        });
        Self(places.collect())
    }

    fn crates(&self) -> BTreeSet<&str> {
        self.0.iter().map(|place| place.krate.as_str()).collect()
    }

    /// Position of a place in the list.
    fn depth(&self, place: &Place) -> Option<usize> {
        self.0.iter().position(|listed| listed == place)
    }

    /// Position of the first place of a crate in the list.
    fn crate_depth(&self, krate: &str) -> Option<usize> {
        self.0.iter().position(|listed| listed.krate == krate)
    }

    /// Reason why `from` must not use `to`, if there is one.
    fn offence(&self, from: &Place, to: &Place) -> Option<String> {
        let points_down = if from.krate == to.krate {
            from == to || self.depth(from) < self.depth(to)
        } else {
            self.crate_depth(&from.krate) < self.crate_depth(&to.krate)
        };
        (!points_down).then(|| format!("{from} uses {to}, which is above it"))
    }
}

/// The source files of a crate, each with its place.
struct Sources {
    krate: String,
    files: Vec<(Place, PathBuf)>,
    /// Items that the root file re-exports, with the module that defines them.
    passed_on: BTreeMap<String, String>,
    /// The manifest, which lists the crate's dependencies.
    manifest: String,
}

impl Sources {
    fn read(krate: &str, folder: &Path) -> Self {
        let files = files_below(folder)
            .into_iter()
            .filter(|path| !is_test_file(path.strip_prefix(folder).expect("the file is in the folder")))
            .map(|path| {
                let first = path.strip_prefix(folder).expect("the file is in the folder").iter().next();
                let name = Path::new(first.expect("a file has a name")).with_extension("");
                (Place { krate: krate.to_owned(), module: name.display().to_string() }, path)
            })
            .collect();
        let root = fs::read_to_string(folder.join("lib.rs")).expect("a crate has a root file");
        let manifest = fs::read_to_string(folder.join("../Cargo.toml")).expect("a crate has a manifest");
        Self { krate: krate.to_owned(), files, passed_on: passed_on(&root), manifest }
    }

    fn depends_on(&self, krate: &str) -> bool {
        let names = self.manifest.lines().filter_map(|line| line.split(['.', ' ', '=']).next());
        names.into_iter().any(|name| name == krate)
    }

    fn modules(&self) -> BTreeSet<&Place> {
        self.files.iter().map(|(place, _)| place).collect()
    }

    /// The place of a path that starts at the crate's root.
    fn resolve(&self, name: &str) -> Place {
        let is_module = self.files.iter().any(|(place, _)| place.module == name);
        let passed_on = || self.passed_on.get(name).map_or(ROOT, String::as_str);
        let module = if is_module { name } else { passed_on() };
        Place { krate: self.krate.clone(), module: module.to_owned() }
    }
}

/// Whether a file contains only tests.
fn is_test_file(path: &Path) -> bool {
    path.iter().any(|part| part == "tests" || part == "tests.rs" || part == "tests_support.rs")
}

fn files_below(folder: &Path) -> Vec<PathBuf> {
    let mut files = Vec::new();
    for entry in fs::read_dir(folder).expect("a source folder can be read") {
        let path = entry.expect("an entry can be read").path();
        if path.is_dir() {
            files.extend(files_below(&path));
        } else if path.extension().is_some_and(|extension| extension == "rs") {
            files.push(path);
        }
    }
    files
}

/// Names that `pub use module::name` re-exports, with their module.
fn passed_on(root: &str) -> BTreeMap<String, String> {
    let file = syn::parse_file(root).expect("the root file is Rust");
    let mut names = BTreeMap::new();
    for item in &file.items {
        if let Item::Use(ItemUse { vis: Visibility::Public(_), tree, .. }) = item {
            let paths = leaves(tree).into_iter().filter(|path| path.len() > 1);
            names.extend(paths.map(|path| (path[path.len() - 1].clone(), path[0].clone())));
        }
    }
    names
}

/// All paths of a `use` item, as names.
fn leaves(tree: &UseTree) -> Vec<Vec<String>> {
    let below = |name: String, tree: &UseTree| {
        leaves(tree).into_iter().map(|path| [vec![name.clone()], path].concat()).collect()
    };
    match tree {
        UseTree::Path(path) => below(path.ident.to_string(), &path.tree),
        UseTree::Name(name) => vec![vec![name.ident.to_string()]],
        UseTree::Rename(name) => vec![vec![name.ident.to_string()]],
        UseTree::Glob(_) => vec![vec!["*".to_owned()]],
        UseTree::Group(group) => group.items.iter().flat_map(leaves).collect(),
    }
}

/// Collects the first two names of every path outside test code.
#[derive(Default)]
struct Paths(BTreeSet<(String, String)>);

impl Paths {
    fn add(&mut self, path: &[String]) {
        if let [first, second, ..] = path {
            self.0.insert((first.clone(), second.clone()));
        }
    }

    /// Adds the paths in the arguments of a macro, which are not parsed.
    fn add_tokens(&mut self, tokens: TokenStream) {
        let tokens: Vec<TokenTree> = tokens.into_iter().collect();
        for (index, token) in tokens.iter().enumerate() {
            match (token, tokens.get(index + 1..index + 4)) {
                (TokenTree::Group(group), _) => self.add_tokens(group.stream()),
                (
                    TokenTree::Ident(first),
                    Some([TokenTree::Punct(a), TokenTree::Punct(b), TokenTree::Ident(second)]),
                ) if (a.as_char(), b.as_char()) == (':', ':') => {
                    self.add(&[first.to_string(), second.to_string()]);
                }
                _ => {}
            }
        }
    }
}

fn is_test(attributes: &[Attribute]) -> bool {
    let of_tests = |attribute: &Attribute| {
        let words = attribute.meta.require_list().map(|list| list.tokens.to_string()).unwrap_or_default();
        attribute.path().is_ident("cfg")
            && words.split(|c: char| !c.is_alphanumeric()).any(|word| word == "test")
    };
    attributes.iter().any(of_tests)
}

impl<'ast> Visit<'ast> for Paths {
    fn visit_item(&mut self, item: &'ast Item) {
        let attributes = match item {
            Item::Mod(item) => &item.attrs,
            Item::Fn(item) => &item.attrs,
            Item::Use(item) => &item.attrs,
            Item::Impl(item) => &item.attrs,
            _ => return visit::visit_item(self, item),
        };
        if !is_test(attributes) {
            visit::visit_item(self, item);
        }
    }

    fn visit_item_use(&mut self, item: &'ast ItemUse) {
        // A re-export is not a use.
        if !matches!(item.vis, Visibility::Public(_)) {
            for path in leaves(&item.tree) {
                self.add(&path);
            }
        }
    }

    fn visit_path(&mut self, path: &'ast syn::Path) {
        self.add(&path.segments.iter().map(|segment| segment.ident.to_string()).collect::<Vec<_>>());
        visit::visit_path(self, path);
    }

    fn visit_macro(&mut self, call: &'ast syn::Macro) {
        self.add_tokens(call.tokens.clone());
        visit::visit_macro(self, call);
    }
}

/// Forbidden uses in a file of `place`, without duplicates. `at_root`: `super` is the crate's root.
fn offences(layers: &Layers, crates: &[Sources], place: &Place, at_root: bool, source: &str) -> Vec<String> {
    let own = crates.iter().find(|sources| sources.krate == place.krate).expect("the crate is read");
    let mut paths = Paths::default();
    paths.visit_file(&syn::parse_file(source).expect("the file is Rust"));
    let names = paths.0.into_iter().filter_map(|(first, second)| match first.as_str() {
        "crate" => Some(own.resolve(&second)),
        "super" if at_root => Some(own.resolve(&second)),
        module if place.module == ROOT && own.resolve(module).module == module => Some(own.resolve(module)),
        krate if own.depends_on(krate) => {
            crates.iter().find(|sources| sources.krate == krate).map(|sources| sources.resolve(&second))
        }
        _ => None,
    });
    let used: BTreeSet<Place> = names.collect();
    used.iter().filter_map(|to| layers.offence(place, to)).collect()
}

/// The sources of `shared` and of every crate of the host side.
fn crates() -> Vec<Sources> {
    let top = Path::new(env!("CARGO_MANIFEST_DIR")).join("..");
    let mut folders =
        ["shared", "host", "python"].map(|krate| (krate.to_owned(), top.join(krate).join("src"))).to_vec();
    for entry in fs::read_dir(top.join("host")).expect("the host side can be read") {
        let path = entry.expect("an entry can be read").path();
        if path.join("Cargo.toml").exists() {
            let name = path.file_name().expect("a folder has a name").display().to_string();
            folders.push((name, path.join("src")));
        }
    }
    folders.iter().map(|(krate, folder)| Sources::read(krate, folder)).collect()
}

fn document() -> String {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../ARCHITECTURE.md");
    fs::read_to_string(path).expect("ARCHITECTURE.md can be read")
}

#[test]
fn the_list_names_every_place_once() {
    let layers = Layers::parse(&document());
    let crates = crates();
    let listed: BTreeSet<&Place> = layers.0.iter().collect();
    assert_eq!(listed.len(), layers.0.len(), "a place is in the list twice");
    let found: BTreeSet<&Place> = crates.iter().flat_map(Sources::modules).collect();
    let missing: Vec<String> = found.difference(&listed).map(ToString::to_string).collect();
    let gone: Vec<String> = listed.difference(&found).map(ToString::to_string).collect();
    assert!(missing.is_empty(), "add to the list under `{HEADING}` in ARCHITECTURE.md: {missing:?}");
    assert!(gone.is_empty(), "these places do not exist, remove them from the list: {gone:?}");
    assert!(layers.crates().len() > 10, "too few crates found: {:?}", layers.crates());
}

#[test]
fn every_path_points_down_the_list() {
    let layers = Layers::parse(&document());
    let crates = crates();
    let mut found = Vec::new();
    for (place, path) in crates.iter().flat_map(|sources| &sources.files) {
        let folder = path.parent().and_then(Path::file_name);
        let at_root = folder.is_some_and(|folder| folder == "src")
            || path.ends_with(format!("{}/mod.rs", place.module));
        let source = fs::read_to_string(path).expect("a source file can be read");
        let above = offences(&layers, &crates, place, at_root, &source);
        found.extend(above.into_iter().map(|offence| format!("{}: {offence}", path.display())));
    }
    assert!(found.is_empty(), "move the used code down, or its user up:\n{}", found.join("\n"));
}

#[test]
fn a_planted_offence_is_found_and_test_code_is_left_alone() {
    let layers = Layers::parse("## Layers\n\n```text\ntop: high low\nbottom: lib deep\n```\n");
    let place = |krate: &str, module: &str| Place { krate: krate.to_owned(), module: module.to_owned() };
    let sources = |krate: &str, modules: &[&str]| Sources {
        krate: krate.to_owned(),
        files: modules.iter().map(|module| (place(krate, module), PathBuf::new())).collect(),
        passed_on: BTreeMap::from([("Given".to_owned(), "high".to_owned())]),
        manifest: "top.workspace = true\nbottom = { workspace = true }\n".to_owned(),
    };
    let crates = [sources("top", &["high", "low"]), sources("bottom", &["lib", "deep"])];
    let found = |from: &Place, source: &str| offences(&layers, &crates, from, true, source).len();
    let (low, deep) = (place("top", "low"), place("bottom", "deep"));
    for offence in [
        "use crate::high::Thing;",
        "use crate::{low, high};",
        "use super::high::Thing;",
        "use crate::Given;",
        "fn f() { crate::high::f() }",
        "fn f() { println!(\"{}\", crate::high::NAME) }",
        "fn f(_: &crate::high::Thing) {}",
    ] {
        assert_eq!(found(&low, offence), 1, "{offence}");
    }
    assert_eq!(found(&deep, "use top::low::Thing;"), 1, "a crate above");
    assert_eq!(found(&deep, "use crate::Item;"), 1, "the root file stands above");
    for innocent in [
        "use bottom::deep::Thing;",
        "use crate::low::Own;",
        "#[cfg(test)] mod tests { use crate::high::Thing; }",
        "#[cfg(all(test, unix))] use crate::high::Thing;",
        "/// Like [`crate::high::Thing`].\nfn f() {}",
    ] {
        assert_eq!(found(&low, innocent), 0, "{innocent}");
    }
}
