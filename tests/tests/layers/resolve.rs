//! Where a path leads: through modules, imports and re-exports to the module that defines what it names.

use std::slice::from_ref;

use crate::paths::{Body, Path};
use crate::sources::{Krate, Source};

/// Imports that are followed, one after the other, before a path counts as one that leads nowhere.
const MOST_IMPORTS: usize = 8;

/// The end of a path.
#[derive(Debug, PartialEq)]
pub struct Target {
    pub module: Path,
    /// The item of that module; none if the path ends with the module.
    pub item: Option<String>,
}

impl Krate {
    /// The end of a path in this crate, seen from one of its modules; none if it leads out of the crate.
    pub fn resolve(&self, within: &[String], path: &[String]) -> Option<Target> {
        self.follow(within, path, 0)
    }

    fn follow(&self, within: &[String], path: &[String], imports: usize) -> Option<Target> {
        if imports > MOST_IMPORTS {
            return None;
        }
        if path.first().is_some_and(String::is_empty) {
            return None;
        }
        let mut module = within.to_vec();
        for (index, name) in path.iter().enumerate() {
            let rest = &path[index + 1..];
            let inner = [module.as_slice(), from_ref(name)].concat();
            let is_item = rest.is_empty() && self.defines(&module, name);
            match name.as_str() {
                "crate" => module.clear(),
                "self" => {}
                "super" => drop(module.pop()?),
                _ if !is_item && self.bodies(&inner).next().is_some() => module = inner,
                _ => {
                    if let Some(import) = self.bodies(&module).find_map(|body| body.import(name)) {
                        return self.follow(&module, &[import, rest].concat(), imports + 1);
                    }
                    if self.defines(&module, name) {
                        return Some(Target { module, item: Some(name.clone()) });
                    }
                    let passed_on = self.through_globs(&module, &path[index..], imports);
                    let missing = (index > 0).then(|| Target { module, item: Some(name.clone()) });
                    return passed_on.or(missing);
                }
            }
        }
        Some(Target { module, item: None })
    }

    /// The end of a path that starts at an item which the module imports by `*`.
    fn through_globs(&self, module: &[String], path: &[String], imports: usize) -> Option<Target> {
        let globs = self.bodies(module).flat_map(|body| &body.globs);
        let ends = globs.filter_map(|glob| self.follow(module, &[glob, path].concat(), imports + 1));
        ends.into_iter().find(|end| end.item.as_ref().is_some_and(|item| self.defines(&end.module, item)))
    }

    fn defines(&self, module: &[String], name: &str) -> bool {
        self.bodies(module).any(|body| body.items.contains(name))
    }

    fn bodies(&self, module: &[String]) -> impl Iterator<Item = &Body> {
        let bodies = self.sources_at(module).flat_map(|source| &source.bodies);
        bodies.filter(move |(path, _)| path == module).map(|(_, body)| body)
    }

    /// The files with a module.
    pub fn sources_at(&self, module: &[String]) -> impl Iterator<Item = &Source> {
        self.modules.get(module).into_iter().flatten().map(|place| &self.sources[*place])
    }

    /// The first name of a path that leads out of this crate: that of another crate.
    pub fn outside<'a>(&self, within: &[String], path: &'a [String]) -> Option<&'a str> {
        if let [root, name, ..] = path
            && root.is_empty()
        {
            return Some(name);
        }
        let first = path.first().filter(|_| path.len() > 1)?;
        let inner = [within, from_ref(first)].concat();
        let is_inside = ["crate", "self", "super"].contains(&first.as_str())
            || self.bodies(&inner).next().is_some()
            || self.bodies(within).any(|body| body.import(first).is_some());
        (!is_inside).then_some(first)
    }
}
