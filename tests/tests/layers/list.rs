//! The list of layers in ARCHITECTURE.md, and what it forbids.

use std::collections::BTreeSet;
use std::fmt;

use crate::sources::{Krate, Source};

/// Heading of the list in ARCHITECTURE.md.
pub const HEADING: &str = "## Layers";

/// A module at the root of a crate, or its root file.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Place {
    krate: String,
    module: String,
}

impl Place {
    pub fn new(krate: &str, module: &str) -> Self {
        Self { krate: krate.to_owned(), module: module.to_owned() }
    }

    pub fn of(krate: &Krate, source: &Source) -> Self {
        Self::new(&krate.name, source.module.first().unwrap_or(&krate.root))
    }
}

impl fmt::Display for Place {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}::{}", self.krate, self.module)
    }
}

/// The places in order, from the top down.
pub struct Layers(pub Vec<Place>);

impl Layers {
    /// Reads the code block below the heading: one line per crate, with its modules after a colon.
    pub fn parse(document: &str) -> Self {
        let (_, section) = document.split_once(HEADING).expect("the document has the heading");
        let block = section.split("```").nth(1).expect("a code block follows the heading");
        let lines = block.lines().filter_map(|line| line.split_once(':'));
        let places = lines.flat_map(|(krate, modules)| {
            modules.split_whitespace().map(|module| Place::new(krate.trim(), module)).collect::<Vec<_>>()
        });
        Self(places.collect())
    }

    pub fn crates(&self) -> BTreeSet<&str> {
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
            // A crate outside the list, such as the shim, is below all that are in it.
            self.crate_depth(&to.krate).is_none_or(|depth| self.crate_depth(&from.krate) < Some(depth))
        };
        (!points_down).then(|| format!("{from} uses {to}, which is above it"))
    }

    /// Forbidden uses in the files of a crate, without duplicates.
    pub fn offences(&self, crates: &[Krate], krate: &Krate) -> BTreeSet<String> {
        let mut found = BTreeSet::new();
        for source in &krate.sources {
            let from = Place::of(krate, source);
            for used in source.named().flat_map(|(within, path)| places(crates, krate, within, path)) {
                let offence = self.offence(&from, &used);
                found.extend(offence.map(|offence| format!("{}: {offence}", source.path.display())));
            }
        }
        found
    }
}

/// The places that a path in a module of `krate` names, in this crate or another.
fn places(crates: &[Krate], krate: &Krate, within: &[String], path: &[String]) -> Vec<Place> {
    let (owner, within, path) = match krate.outside(within, path) {
        None => (Some(krate), within, path),
        Some(name) => {
            let named = crates.iter().find(|other| other.root == "lib" && other.name == name);
            let may_name =
                |other: &&Krate| krate.name == other.name || krate.dependencies.contains(&other.name);
            (named.filter(may_name), [].as_slice(), &path[1..])
        }
    };
    let Some(owner) = owner else { return Vec::new() };
    let target = owner.resolve(within, path);
    let sources = target.iter().flat_map(|target| owner.sources_at(&target.module));
    sources.map(|source| Place::of(owner, source)).collect()
}
