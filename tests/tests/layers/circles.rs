//! Circles of files: files of a crate that use one another. Each must be readable after those that it uses.
//!
//! A module may use its ancestors, whose errors, configuration and types it serves: such a use makes no
//! circle.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use crate::sources::Krate;

/// The files that each file uses, with the paths that name them.
type Uses<'a> = BTreeMap<&'a Path, BTreeMap<&'a Path, BTreeSet<String>>>;

/// A text for each circle: its files, and the paths that close it.
pub fn circles(krate: &Krate) -> Vec<String> {
    let uses = uses(krate);
    let within_reach: BTreeMap<&Path, BTreeSet<&Path>> =
        uses.keys().map(|file| (*file, reachable(&uses, file))).collect();
    let circle_of = |file: &Path| -> BTreeSet<&Path> {
        let others = within_reach[file].iter().filter(|other| within_reach[**other].contains(file));
        others.copied().collect()
    };
    let circles: BTreeSet<BTreeSet<&Path>> = uses.keys().map(|file| circle_of(file)).collect();
    circles.iter().filter(|circle| !circle.is_empty()).map(|circle| describe(&uses, circle)).collect()
}

fn uses(krate: &Krate) -> Uses<'_> {
    let mut uses = Uses::new();
    for source in &krate.sources {
        let used = uses.entry(&source.path).or_default();
        for (within, path) in source.named() {
            let Some(target) = krate.resolve(within, path).filter(|target| target.item.is_some()) else {
                continue;
            };
            if !within.starts_with(&target.module) {
                for file in krate.sources_at(&target.module).filter(|file| file.path != source.path) {
                    used.entry(&file.path).or_default().insert(path.join("::"));
                }
            }
        }
    }
    uses
}

/// The files that a file uses, and those that these use.
fn reachable<'a>(uses: &Uses<'a>, from: &'a Path) -> BTreeSet<&'a Path> {
    let (mut reached, mut open) = (BTreeSet::new(), vec![from]);
    while let Some(file) = open.pop() {
        open.extend(uses[file].keys().filter(|used| reached.insert(**used)));
    }
    reached
}

fn describe(uses: &Uses, circle: &BTreeSet<&Path>) -> String {
    let mut lines = vec![format!("a circle of {} files:", circle.len())];
    for file in circle {
        for (used, paths) in uses[file].iter().filter(|(used, _)| circle.contains(*used)) {
            let paths: Vec<&str> = paths.iter().map(String::as_str).collect();
            lines.push(format!("    {} uses {}: {}", file.display(), used.display(), paths.join(", ")));
        }
    }
    lines.join("\n")
}
