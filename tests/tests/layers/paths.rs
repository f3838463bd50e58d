//! The paths that a module names outside test code, and the names that it imports.

use std::collections::{BTreeMap, BTreeSet};
use std::mem::take;

use proc_macro2::{TokenStream, TokenTree};
use syn::visit::{self, Visit};
use syn::{Attribute, ImplItemFn, Item, ItemMod, ItemUse, UseTree, Visibility};

/// A path, as written.
pub type Path = Vec<String>;

/// What stands in the body of a module.
#[derive(Default)]
pub struct Body {
    /// Paths of its code and of its private `use` items; a re-export is not a use.
    pub named: BTreeSet<Path>,
    /// Paths of all `use` items by the names under which the module knows them.
    imports: BTreeMap<String, Path>,
    /// Modules and enums of which it imports everything.
    pub globs: Vec<Path>,
    /// Names of the items that it defines.
    pub items: BTreeSet<String>,
}

/// The modules among the items, without those of test code.
pub fn modules(items: &[Item]) -> impl Iterator<Item = &ItemMod> {
    items.iter().filter_map(|item| match item {
        Item::Mod(module) if !is_test(&module.attrs) => Some(module),
        _ => None,
    })
}

impl Body {
    pub fn new(items: &[Item]) -> Self {
        let mut body = Self::default();
        body.items.extend(items.iter().filter_map(name));
        for item in items {
            body.visit_item(item);
        }
        body
    }

    /// The path of the `use` item that makes a name known, unless it starts with that name: then the name is
    /// a crate's.
    pub fn import(&self, name: &String) -> Option<&[String]> {
        self.imports.get(name).filter(|path| path.first() != Some(name)).map(Vec::as_slice)
    }

    fn add(&mut self, path: Path) {
        if !path.is_empty() {
            self.named.insert(path);
        }
    }

    /// Adds the paths in the arguments of a macro, which are not parsed.
    fn add_tokens(&mut self, tokens: TokenStream) {
        let (mut path, mut colons) = (Path::new(), 0);
        for token in tokens {
            match token {
                TokenTree::Ident(name) => {
                    if colons != 2 {
                        self.add(take(&mut path));
                    }
                    path.push(name.to_string());
                    colons = 0;
                }
                TokenTree::Punct(mark) if mark.as_char() == ':' => colons += 1,
                other => {
                    self.add(take(&mut path));
                    colons = 0;
                    if let TokenTree::Group(group) = other {
                        self.add_tokens(group.stream());
                    }
                }
            }
        }
        self.add(path);
    }

    /// Adds the paths of a `use` item below `path`.
    fn add_use(&mut self, mut path: Path, tree: &UseTree, is_use: bool) {
        let (name, known_as) = match tree {
            UseTree::Group(group) => {
                return group.items.iter().for_each(|tree| self.add_use(path.clone(), tree, is_use));
            }
            UseTree::Path(step) => {
                path.push(step.ident.to_string());
                return self.add_use(path, &step.tree, is_use);
            }
            UseTree::Glob(_) => {
                self.globs.push(path.clone());
                path.push("*".to_owned());
                return self.add_if(is_use, path);
            }
            UseTree::Name(name) => (&name.ident, &name.ident),
            UseTree::Rename(name) => (&name.ident, &name.rename),
        };
        if name != "self" {
            path.push(name.to_string());
        }
        let known_as = if known_as == "self" { path.last().cloned() } else { Some(known_as.to_string()) };
        self.imports.extend(known_as.map(|name| (name, path.clone())));
        self.add_if(is_use, path);
    }

    fn add_if(&mut self, is_use: bool, path: Path) {
        if is_use {
            self.add(path);
        }
    }
}

/// Beginning of a path: a nameless step before the name of another crate, as in `::bench`.
fn root(is_global: bool) -> Path {
    if is_global { vec![String::new()] } else { Path::new() }
}

impl<'ast> Visit<'ast> for Body {
    fn visit_item(&mut self, item: &'ast Item) {
        if !matches!(item, Item::Mod(_)) && !is_test(attributes(item)) {
            visit::visit_item(self, item);
        }
    }

    fn visit_impl_item_fn(&mut self, function: &'ast ImplItemFn) {
        if !is_test(&function.attrs) {
            visit::visit_impl_item_fn(self, function);
        }
    }

    fn visit_item_use(&mut self, item: &'ast ItemUse) {
        self.add_use(
            root(item.leading_colon.is_some()),
            &item.tree,
            matches!(item.vis, Visibility::Inherited),
        );
    }

    fn visit_visibility(&mut self, _: &'ast Visibility) {
        // It says who may use an item, and uses none.
    }

    fn visit_path(&mut self, path: &'ast syn::Path) {
        let names = path.segments.iter().map(|segment| segment.ident.to_string());
        self.add(root(path.leading_colon.is_some()).into_iter().chain(names).collect());
        visit::visit_path(self, path);
    }

    fn visit_macro(&mut self, call: &'ast syn::Macro) {
        self.add_tokens(call.tokens.clone());
        visit::visit_macro(self, call);
    }
}

fn name(item: &Item) -> Option<String> {
    let name = match item {
        Item::Const(item) => &item.ident,
        Item::Enum(item) => &item.ident,
        Item::Fn(item) => &item.sig.ident,
        Item::Macro(item) => item.ident.as_ref()?,
        Item::Static(item) => &item.ident,
        Item::Struct(item) => &item.ident,
        Item::Trait(item) => &item.ident,
        Item::Type(item) => &item.ident,
        _ => return None,
    };
    Some(name.to_string())
}

fn attributes(item: &Item) -> &[Attribute] {
    match item {
        Item::Const(item) => &item.attrs,
        Item::Enum(item) => &item.attrs,
        Item::Fn(item) => &item.attrs,
        Item::Impl(item) => &item.attrs,
        Item::Macro(item) => &item.attrs,
        Item::Static(item) => &item.attrs,
        Item::Struct(item) => &item.attrs,
        Item::Trait(item) => &item.attrs,
        Item::Type(item) => &item.attrs,
        Item::Use(item) => &item.attrs,
        _ => &[],
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
