//! A mutant, and what became of it.

use std::collections::BTreeMap;
use std::ops::Range;

use proc_macro2::LineColumn;
use serde::{Deserialize, Serialize};

use super::graft::{Mutation, offset};

/// What became of a mutant.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Outcome {
    /// A test failed, or did not end.
    Caught,
    DoesNotCompile,
    Survived,
}

/// Outcomes by the names of the mutants.
pub type Outcomes = BTreeMap<String, Outcome>;

/// A mutant as cargo-mutants lists it.
#[derive(Debug, Deserialize)]
pub struct Listed {
    /// Place and mutation.
    pub name: String,
    pub file: String,
    pub replacement: String,
    pub span: Span,
}

/// The code that is replaced.
#[derive(Clone, Copy, Debug, Deserialize)]
pub struct Span {
    pub start: Place,
    pub end: Place,
}

/// A place in a file, both counted from 1.
#[derive(Clone, Copy, Debug, Deserialize)]
pub struct Place {
    pub line: usize,
    pub column: usize,
}

/// A mutant. The name tells it from all others in one run; file, mutation and mutated line do so when lines
/// have moved.
#[derive(Clone, Debug, PartialEq)]
pub struct Mutant {
    /// Place and mutation.
    pub name: String,
    pub file: String,
    /// In the words of cargo-mutants, with the function.
    pub mutation: String,
    /// The mutated line; none where several lines are replaced.
    pub becomes: Option<String>,
    /// The bytes of the file that the replacement replaces.
    range: Range<usize>,
    replacement: String,
}

impl Mutant {
    /// `source` is the text of its file.
    pub fn new(listed: Listed, source: &str) -> Self {
        let Listed { name, file, replacement, span } = listed;
        let Span { start, end } = span;
        let place = format!("{file}:{}:{}: ", start.line, start.column);
        let mutation = name.strip_prefix(&place).unwrap_or(&name).to_owned();
        let line = source.lines().nth(start.line - 1).filter(|_| start.line == end.line);
        let becomes = line.map(|line| {
            let (before, after) = (line.chars().take(start.column - 1), line.chars().skip(end.column - 1));
            let line: String = before.chain(replacement.chars()).chain(after).collect();
            line.trim().to_owned()
        });
        let at = |place: Place| offset(source, LineColumn { line: place.line, column: place.column - 1 });
        let range = at(span.start)..at(span.end);
        Self { name, file, mutation, becomes, range, replacement }
    }

    /// What it does to its file, as the mutant of this number.
    pub fn mutation(&self, number: u32) -> Mutation<'_> {
        Mutation { number, range: self.range.clone(), replacement: &self.replacement }
    }

    /// The entry that would accept it.
    pub fn entry(&self) -> String {
        let becomes = self.becomes.iter().map(|line| format!("becomes = '{line}'\n"));
        let becomes: String = becomes.collect();
        let Self { file, mutation, .. } = self;
        format!("[[accepted]]\nfile = '{file}'\nmutation = '{mutation}'\n{becomes}reason = \"\"\n")
    }
}
