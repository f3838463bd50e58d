//! The third-party software of the chip's image and of the host's programs, as cargo resolves it: what is linked, without what only
//! builds it (procedural macros, build scripts).

use std::collections::{BTreeMap, BTreeSet};

use anyhow::{Context, Result};
use serde_json::Value;
use xshell::{Shell, cmd};

use crate::CHIP_TARGET;

/// The page's bundle is built from these packages.
const PAGE_LOCK: &str = "host/bedside/web/package-lock.json";

/// A program and what it is made of.
pub struct Program {
    /// Its package.
    pub name: &'static str,
    /// What it is, in `CycloneDX`'s words.
    pub kind: &'static str,
    /// Its parts by id; its own package is one of them.
    pub parts: BTreeMap<Id, Part>,
}

/// Name and version.
pub type Id = (String, String);

/// A part of a program.
#[derive(Debug, Default, PartialEq, Eq)]
pub struct Part {
    /// What it uses.
    pub uses: BTreeSet<Id>,
    /// Licence, an expression of SPDX.
    pub licence: String,
    /// What it is for, in its authors' words.
    pub description: String,
    /// Its registry's kind in a package URL: `cargo` or `npm`; none for the project's own.
    pub registry: Option<&'static str>,
    /// Algorithm and value of its checksum, in hexadecimal digits.
    pub checksum: Option<(&'static str, String)>,
}

/// The firmware.
pub fn chip(shell: &Shell) -> Result<Program> {
    let parts = resolve(shell, "firmware", CHIP_TARGET)?;
    Ok(Program { name: "firmware", kind: "firmware", parts })
}

/// The trainer, with the bedside page.
pub fn host(shell: &Shell) -> Result<Program> {
    let version = cmd!(shell, "rustc -vV").quiet().read()?;
    let target = version.lines().find_map(|line| line.strip_prefix("host: "));
    let mut parts = resolve(shell, "host", target.context("rustc does not tell its host")?)?;
    let page = packages_of_page(&serde_json::from_str(&shell.read_file(PAGE_LOCK)?)?);
    let bedside = parts.iter_mut().find(|((name, _), _)| name == "bedside");
    bedside.context("the trainer does not use bedside")?.1.uses.extend(page.keys().cloned());
    parts.extend(page);
    Ok(Program { name: "host", kind: "application", parts })
}

/// The crates of a program.
fn resolve(shell: &Shell, package: &str, target: &str) -> Result<BTreeMap<Id, Part>> {
    let format = " {p}";
    let tree = cmd!(
        shell,
        "cargo tree --locked --package {package} --target {target} --edges normal,no-proc-macro --prefix depth --format {format}"
    );
    let mut parts = graph(&tree.quiet().read()?)?;
    let metadata = cmd!(shell, "cargo metadata --format-version 1 --locked --filter-platform {target}")
        .quiet()
        .read()?;
    let lock: toml::Table = toml::from_str(&shell.read_file("Cargo.lock")?)?;
    describe(&mut parts, &serde_json::from_str(&metadata)?, &lock);
    Ok(parts)
}

/// The parts of a program and what each of them uses, from the lines of a tree with their depth.
fn graph(tree: &str) -> Result<BTreeMap<Id, Part>> {
    let mut parts: BTreeMap<Id, Part> = BTreeMap::new();
    let mut above: Vec<Id> = Vec::new();
    for line in tree.lines() {
        let mut words = line.split(' ');
        let mut next = || words.next().with_context(|| format!("cargo tree: {line}"));
        let (depth, name, version) = (next()?.parse()?, next()?, next()?);
        let id = (name.to_owned(), version.trim_start_matches('v').to_owned());
        above.truncate(depth);
        if let Some(user) = above.last() {
            parts.entry(user.clone()).or_default().uses.insert(id.clone());
        }
        parts.entry(id.clone()).or_default();
        above.push(id);
    }
    Ok(parts)
}

/// Adds what the packages say of themselves, and the checksums of the lock file.
fn describe(parts: &mut BTreeMap<Id, Part>, metadata: &Value, lock: &toml::Table) {
    for package in metadata["packages"].as_array().into_iter().flatten() {
        let word = |key: &str| package[key].as_str().unwrap_or_default().to_owned();
        if let Some(part) = parts.get_mut(&(word("name"), word("version"))) {
            // The form before cargo knew expressions.
            part.licence = word("license").replace(" / ", "/").replace('/', " OR ");
            part.description = word("description").split_whitespace().collect::<Vec<_>>().join(" ");
            part.registry = package["source"].is_string().then_some("cargo");
        }
    }
    for package in lock.get("package").and_then(toml::Value::as_array).into_iter().flatten() {
        let word = |key: &str| package.get(key).and_then(toml::Value::as_str).unwrap_or_default().to_owned();
        if let Some(part) = parts.get_mut(&(word("name"), word("version"))) {
            let checksum = word("checksum");
            part.checksum = (!checksum.is_empty()).then_some(("SHA-256", checksum));
        }
    }
}

/// The packages that are bundled into the page.
fn packages_of_page(lock: &Value) -> BTreeMap<Id, Part> {
    let packages = lock["packages"].as_object().into_iter().flatten();
    let bundled = packages
        .filter(|(path, package)| !path.is_empty() && package["dev"] != true && package["optional"] != true);
    bundled
        .map(|(path, package)| {
            let name = path.rsplit("node_modules/").next().unwrap_or(path).to_owned();
            let word = |key: &str| package[key].as_str().unwrap_or_default().to_owned();
            let description = "Bundled into the bedside page".to_owned();
            let part =
                Part { licence: word("license"), description, registry: Some("npm"), ..Part::default() };
            ((name, word("version")), part)
        })
        .collect()
}

impl Program {
    /// The parts of third parties.
    pub fn soup(&self) -> impl Iterator<Item = (&Id, &Part)> {
        self.parts.iter().filter(|(_, part)| part.registry.is_some())
    }

    /// The program's own part.
    pub fn own(&self) -> Option<(&Id, &Part)> {
        self.parts.iter().find(|((name, _), _)| name == self.name)
    }

    /// Names of the parts that use this one.
    pub fn users(&self, id: &Id) -> Vec<&str> {
        self.parts
            .iter()
            .filter(|(_, part)| part.uses.contains(id))
            .map(|((name, _), _)| name.as_str())
            .collect()
    }

    /// Names of third-party parts that are there in several versions.
    pub fn several(&self) -> BTreeSet<&str> {
        let names: Vec<&str> = self.soup().map(|((name, _), _)| name.as_str()).collect();
        names.windows(2).filter(|pair| pair[0] == pair[1]).map(|pair| pair[0]).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    fn id(name: &str, version: &str) -> Id {
        (name.into(), version.into())
    }

    #[test]
    fn the_depths_of_a_tree_tell_who_uses_what() {
        let tree = "0 firmware v0.1.0 (/here)\n1 shared v0.1.0 (/here/shared)\n2 crc v3.4.0\n1 crc v3.4.0 (*)\n1 crc v2.0.0\n";
        let mut parts = graph(tree).unwrap();
        for (part, registry) in parts.iter_mut().map(|((name, _), part)| (part, name == "crc")) {
            part.registry = registry.then_some("cargo");
        }
        let program = Program { name: "firmware", kind: "firmware", parts };
        assert_eq!(program.users(&id("crc", "3.4.0")), ["firmware", "shared"]);
        assert_eq!(program.own().unwrap().1.uses.len(), 3);
        assert_eq!(program.several().into_iter().collect::<Vec<_>>(), ["crc"]);
        assert!(graph("a tree without depths").is_err());
    }

    #[test]
    fn licences_descriptions_and_checksums_are_those_of_the_packages() {
        let mut parts = graph("0 shared v0.1.0\n1 void v1.0.2\n").unwrap();
        let metadata = json!({"packages": [
            {"name": "void", "version": "1.0.2", "license": "MIT/Apache-2.0", "description": "An\nempty type", "source": "registry"},
            {"name": "shared", "version": "0.1.0", "license": "MIT", "description": "core", "source": null},
        ]});
        let lock = toml::toml! {
            [[package]]
            name = "void"
            version = "1.0.2"
            checksum = "6a02"
        };
        describe(&mut parts, &metadata, &lock);
        let void = &parts[&id("void", "1.0.2")];
        assert_eq!((&*void.licence, &*void.description), ("MIT OR Apache-2.0", "An empty type"));
        assert_eq!((void.registry, &void.checksum), (Some("cargo"), &Some(("SHA-256", "6a02".to_owned()))));
        assert_eq!(parts[&id("shared", "0.1.0")].registry, None);
    }

    #[test]
    fn only_what_is_bundled_into_the_page_belongs_to_it() {
        let lock = json!({"packages": {
            "": {"version": "0.0.0"},
            "node_modules/uplot": {"version": "1.6.32", "license": "MIT"},
            "node_modules/ws": {"version": "8.23.0", "license": "MIT", "dev": true},
        }});
        let names: Vec<_> = packages_of_page(&lock).into_keys().collect();
        assert_eq!(names, [id("uplot", "1.6.32")]);
    }
}
