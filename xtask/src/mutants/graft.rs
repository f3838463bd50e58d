//! Grafts many mutants onto one source, so that one build serves them all: a mutated function gets the bodies of all of its
//! mutants, and a number picks one when the tests run.

use std::collections::BTreeMap;
use std::fmt::Write;
use std::ops::Range;

use anyhow::{Context, Result};
use proc_macro2::LineColumn;
use syn::spanned::Spanned;
use syn::visit::{self, Visit};
use syn::{Block, ImplItemFn, ItemFn, ReturnType, Signature, TraitItemFn, TypeImplTrait};

/// The environment variable with the number of the mutant that a test program is to be; unset or 0: none.
pub const VARIABLE: &str = "EUPNEA_MUTANT";
/// What is added to the crate's root.
pub const ROOT: &str = r#"
#[cfg(test)]
fn active_mutant() -> u32 {
    static NUMBER: std::sync::OnceLock<u32> = std::sync::OnceLock::new();
    *NUMBER.get_or_init(|| std::env::var("EUPNEA_MUTANT").ok().and_then(|text| text.parse().ok()).unwrap_or(0))
}
#[cfg(not(test))]
fn active_mutant() -> u32 {
    0
}
"#;

/// A mutation of a source: a text that replaces a range of its bytes.
#[derive(Clone, Debug, PartialEq)]
pub struct Mutation<'a> {
    /// Number of the mutant, above 0.
    pub number: u32,
    pub range: Range<usize>,
    pub replacement: &'a str,
}

impl Mutation<'_> {
    /// The mutated source.
    pub fn applied(&self, source: &str) -> String {
        self.within(source, 0..source.len())
    }

    /// A part of the source with the mutation in it.
    fn within(&self, source: &str, part: Range<usize>) -> String {
        let Range { start, end } = self.range;
        [&source[part.start..start], self.replacement, &source[end..part.end]].concat()
    }
}

/// A source with many mutants.
#[derive(Debug, Default, PartialEq)]
pub struct Grafted {
    pub text: String,
    /// First and last line of each mutant's body, from 1.
    lines: Vec<(Range<usize>, u32)>,
    /// Mutants that need a build of their own, such as those in constants.
    pub alone: Vec<u32>,
}

impl Grafted {
    /// The mutant whose body is at a line, from 1.
    pub fn at(&self, line: usize) -> Option<u32> {
        self.lines.iter().find(|(lines, _)| lines.contains(&line)).map(|(_, number)| *number)
    }
}

/// Grafts mutations onto a source.
pub fn graft(source: &str, mutations: &[Mutation]) -> Result<Grafted> {
    let mut bodies = Bodies { source, found: Vec::new() };
    bodies.visit_file(&syn::parse_file(source).context("cannot parse")?);
    let mut of_bodies: BTreeMap<usize, (Range<usize>, Vec<&Mutation>)> = BTreeMap::new();
    let mut grafted = Grafted::default();
    for mutation in mutations {
        let covers =
            |body: &&Range<usize>| body.start < mutation.range.start && mutation.range.end < body.end;
        match bodies.found.iter().find(covers) {
            Some(body) => of_bodies.entry(body.start).or_insert((body.clone(), Vec::new())).1.push(mutation),
            None => grafted.alone.push(mutation.number),
        }
    }
    let mut copied = 0;
    for (body, mutations) in of_bodies.into_values() {
        grafted.text += &source[copied..body.start];
        grafted.add_bodies(source, &body, &mutations)?;
        copied = body.end;
    }
    grafted.text += &source[copied..];
    Ok(grafted)
}

impl Grafted {
    /// Adds the bodies of the mutants of a function, and its own.
    fn add_bodies(&mut self, source: &str, body: &Range<usize>, mutations: &[&Mutation]) -> Result<()> {
        self.text += "{ match crate::active_mutant() {\n";
        for mutation in mutations {
            writeln!(self.text, "{}u32 =>", mutation.number)?;
            let first = self.text.lines().count() + 1;
            self.text += &mutation.within(source, body.clone());
            self.text += "\n";
            self.lines.push((first..self.text.lines().count() + 1, mutation.number));
        }
        write!(self.text, "_ =>\n{}\n}} }}", &source[body.clone()])?;
        Ok(())
    }
}

/// Finds the bodies of all functions that can pick one when they run.
struct Bodies<'a> {
    source: &'a str,
    found: Vec<Range<usize>>,
}

impl Bodies<'_> {
    fn add(&mut self, signature: &Signature, body: &Block) {
        let mut returned = HasImpl(false);
        if let ReturnType::Type(_, kind) = &signature.output {
            returned.visit_type(kind);
        }
        // A constant function cannot ask for the number, and each body would return another type.
        if signature.constness.is_none() && !returned.0 {
            let span = body.brace_token.span.join().span();
            self.found.push(offset(self.source, span.start())..offset(self.source, span.end()));
        }
    }
}

impl<'ast> Visit<'ast> for Bodies<'_> {
    fn visit_item_fn(&mut self, function: &'ast ItemFn) {
        self.add(&function.sig, &function.block);
    }

    fn visit_impl_item_fn(&mut self, function: &'ast ImplItemFn) {
        self.add(&function.sig, &function.block);
    }

    fn visit_trait_item_fn(&mut self, function: &'ast TraitItemFn) {
        if let Some(body) = &function.default {
            self.add(&function.sig, body);
        }
    }
}

/// Whether a type is opaque, or a part of it.
struct HasImpl(bool);

impl<'ast> Visit<'ast> for HasImpl {
    fn visit_type_impl_trait(&mut self, kind: &'ast TypeImplTrait) {
        self.0 = true;
        visit::visit_type_impl_trait(self, kind);
    }
}

/// Byte offset of a place: lines from 1, columns in characters from 0.
pub fn offset(source: &str, place: LineColumn) -> usize {
    let before: usize = source.split_inclusive('\n').take(place.line - 1).map(str::len).sum();
    let line = &source[before..];
    before + line.char_indices().nth(place.column).map_or(line.len(), |(offset, _)| offset)
}

#[cfg(test)]
mod tests {
    use super::*;

    const SOURCE: &str = "const HIGH: f32 = 40.0 - 1.0;\nfn high(p: f32) -> bool {\n    p > HIGH // µ\n}\n";

    fn mutation<'a>(number: u32, of: &str, replacement: &'a str) -> Mutation<'a> {
        let start = SOURCE.find(of).unwrap();
        Mutation { number, range: start..start + of.len(), replacement }
    }

    #[test]
    fn a_function_has_the_bodies_of_its_mutants_and_its_own() {
        let grafted =
            graft(SOURCE, &[mutation(7, "> HIGH", "< HIGH"), mutation(8, "p > HIGH", "true")]).unwrap();
        let expected = "const HIGH: f32 = 40.0 - 1.0;\nfn high(p: f32) -> bool { match crate::active_mutant() {\n\
            7u32 =>\n{\n    p < HIGH // µ\n}\n8u32 =>\n{\n    true // µ\n}\n_ =>\n{\n    p > HIGH // µ\n}\n} }\n";
        assert_eq!((grafted.text.as_str(), grafted.alone.len()), (expected, 0));
        let mutants = [3, 4, 6, 7, 8, 10, 11].map(|line| grafted.at(line));
        assert_eq!(mutants, [None, Some(7), Some(7), None, Some(8), Some(8), None]);
    }

    #[test]
    fn what_cannot_ask_for_the_number_is_built_alone() {
        let source = "const fn a() -> u32 { 1 }\nfn b() -> impl Iterator<Item = u32> { 1..2 }\n";
        let at = |of: &str| source.find(of).unwrap();
        let mutations = [("{ 1 }", 1), ("1..2", 2)].map(|(of, number)| Mutation {
            number,
            range: at(of) + 2..at(of) + 3,
            replacement: "0",
        });
        assert_eq!(
            graft(source, &mutations).unwrap(),
            Grafted { text: source.to_owned(), alone: vec![1, 2], ..Grafted::default() }
        );
        assert_eq!(mutations[0].applied(source).lines().next(), Some("const fn a() -> u32 { 0 }"));
    }

    #[test]
    fn grafted_sources_parse() {
        let grafted = graft(SOURCE, &[mutation(1, "p > HIGH", "false")]).unwrap();
        assert!(syn::parse_file(&grafted.text).is_ok());
        assert!(syn::parse_file(ROOT).is_ok() && ROOT.contains(VARIABLE));
    }
}
