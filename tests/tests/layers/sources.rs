//! The crates and their source files, read as the compiler reads them: from each root file along its `mod`
//! items.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::slice::from_ref;

use syn::{Expr, ExprLit, Item, ItemMod, Lit, Meta};

use crate::paths::{self, Body};

/// Folders with a crate; each house may hold more of them, one folder down.
const FOLDERS: [&str; 7] = ["shared", "host", "lab", "python", "firmware", "firmware/shim", "xtask"];
const HOUSES: [&str; 3] = ["shared", "host", "lab"];

/// A library or a program: a root file and the files below it.
pub struct Krate {
    /// Folder of the package, from the top of the repository.
    pub folder: PathBuf,
    /// Name of the package.
    pub name: String,
    /// First name of the root file's path below `src`: `lib` for a library.
    pub root: String,
    /// Packages that it may name, also those of its tests and of its build.
    pub dependencies: Vec<String>,
    pub sources: Vec<Source>,
    /// Places in `sources` of the files with each module: several if features choose among them.
    pub modules: BTreeMap<paths::Path, Vec<usize>>,
}

/// A source file without its test code.
pub struct Source {
    pub path: PathBuf,
    /// Its module, from the crate's root on.
    pub module: paths::Path,
    /// The bodies of this module and of the modules within the file.
    pub bodies: Vec<(paths::Path, Body)>,
}

impl Source {
    /// The paths outside test code, each with the module in which it stands.
    pub fn named(&self) -> impl Iterator<Item = (&[String], &[String])> {
        let bodies = self.bodies.iter();
        bodies.flat_map(|(module, body)| body.named.iter().map(|path| (module.as_slice(), path.as_slice())))
    }
}

/// All libraries and programs of a repository.
pub fn crates(top: &Path) -> Vec<Krate> {
    let mut folders = FOLDERS.map(|folder| top.join(folder)).to_vec();
    for house in HOUSES.map(|house| top.join(house)) {
        folders.extend(entries(&house));
    }
    folders.retain(|folder| folder.join("Cargo.toml").exists());
    folders.iter().flat_map(|folder| crates_of(top, folder)).collect()
}

/// The libraries and programs of the package in a folder.
fn crates_of(top: &Path, folder: &Path) -> Vec<Krate> {
    let manifest = fs::read_to_string(folder.join("Cargo.toml")).expect("a manifest can be read");
    let (name, dependencies) = read_manifest(&manifest);
    let src = folder.join("src");
    let mut roots = vec![src.join("lib.rs"), src.join("main.rs")];
    roots.extend(entries(&src).iter().map(|entry| entry.join("main.rs")));
    roots.extend(entries(&src.join("bin")));
    roots.retain(|root| root.is_file());
    let read = |root: &PathBuf| {
        let below = root.strip_prefix(&src).expect("a root file is in the source folder");
        let first = below.iter().next().expect("a file has a name");
        let mut krate = Krate {
            folder: folder.strip_prefix(top).expect("the folder is in the repository").to_owned(),
            name: name.clone(),
            root: Path::new(first).with_extension("").display().to_string(),
            dependencies: dependencies.clone(),
            sources: Vec::new(),
            modules: BTreeMap::new(),
        };
        krate.add(top, root, root.parent().expect("a file is in a folder"), paths::Path::new());
        krate
    };
    roots.iter().map(read).collect()
}

/// Name and dependencies of a package.
fn read_manifest(text: &str) -> (String, Vec<String>) {
    let (mut table, mut name, mut dependencies) = ("", "", Vec::new());
    for line in text.lines() {
        if let Some(header) = line.strip_prefix('[') {
            table = header.trim_matches(['[', ']']);
        }
        let Some((key, value)) = line.split_once('=') else { continue };
        if table == "package" && key.trim() == "name" {
            name = value.trim().trim_matches('"');
        }
        if table.ends_with("dependencies") {
            dependencies.extend(key.split(['.', ' ']).next().map(str::to_owned));
        }
    }
    (name.to_owned(), dependencies)
}

fn entries(folder: &Path) -> Vec<PathBuf> {
    let entries = fs::read_dir(folder).into_iter().flatten();
    entries.map(|entry| entry.expect("an entry can be read").path()).collect()
}

impl Krate {
    /// Adds the file of a module whose own modules are in `folder`, and their files.
    fn add(&mut self, top: &Path, file: &Path, folder: &Path, module: paths::Path) {
        let text = fs::read_to_string(file).unwrap_or_else(|error| panic!("{}: {error}", file.display()));
        let items = syn::parse_file(&text).expect("the file is Rust").items;
        let path = file.strip_prefix(top).expect("the file is in the repository").to_owned();
        let place = self.sources.len();
        self.sources.push(Source { path, module: module.clone(), bodies: Vec::new() });
        self.add_body(top, file, folder, (place, module), &items);
    }

    /// Adds the body of a module in the file of the source at `place`, and the modules in it.
    fn add_body(
        &mut self,
        top: &Path,
        file: &Path,
        folder: &Path,
        (place, module): (usize, paths::Path),
        items: &[Item],
    ) {
        for item in paths::modules(items) {
            let name = item.ident.to_string();
            let inner = [module.as_slice(), from_ref(&name)].concat();
            let below = folder.join(&name);
            if let Some((_, items)) = &item.content {
                self.add_body(top, file, &below, (place, inner), items);
            } else if let Some(stated) = stated_path(item) {
                let stated = file.parent().expect("a file is in a folder").join(stated);
                self.add(top, &stated, stated.parent().expect("a file is in a folder"), inner);
            } else {
                let beside = below.with_extension("rs");
                let file = if beside.exists() { beside } else { below.join("mod.rs") };
                self.add(top, &file, &below, inner);
            }
        }
        self.modules.entry(module.clone()).or_default().push(place);
        self.sources[place].bodies.push((module, Body::new(items)));
    }
}

/// The value of `#[path = ...]`.
fn stated_path(item: &ItemMod) -> Option<String> {
    item.attrs.iter().find_map(|attribute| match &attribute.meta {
        Meta::NameValue(pair) if pair.path.is_ident("path") => match &pair.value {
            Expr::Lit(ExprLit { lit: Lit::Str(path), .. }) => Some(path.value()),
            _ => None,
        },
        _ => None,
    })
}
