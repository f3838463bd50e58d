//! SAFETY.md states what the code does: its tables are generated, and each number of its prose is that of the
//! constant that acts.
//!
//! | module | contains |
//! |---|---|
//! | [`alarm_table`] | the table of alarms, with the conditions that begin and end each |
//! | [`fault_tables`] | the tables of the fault matrix |
//! | [`claims`] | the sentences of the prose that state numbers |
//! | [`sentence`] | finds such a sentence in a document, and compares its numbers |
//! | [`figures`] | how the documents write a number |
//!
//! `EUPNEA_BLESS=1 cargo test -p tests --test safety_document` writes the numbers and tables of the code into
//! the documents.

mod alarm_table;
mod claims;
mod fault_tables;
mod figures;
mod sentence;

use std::fs;
use std::path::{Path, PathBuf};

use claims::claims;
use sentence::{Claim, checked_numbers};
use shared::safety::alarms::ALARMS;
use trials::faults::cases::cases;

const SAFETY: &str = "SAFETY.md";
const BLESS: &str = "EUPNEA_BLESS=1 cargo test -p tests --test safety_document";

fn path(document: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("..").join(document)
}

fn read(document: &str) -> String {
    fs::read_to_string(path(document)).unwrap_or_else(|error| panic!("{document}: {error}"))
}

/// What the code says: the generated parts of SAFETY.md by their marks, and the sentences of all documents.
struct Code {
    tables: Vec<(&'static str, String)>,
    claims: Vec<(&'static str, Claim)>,
}

impl Code {
    fn new() -> Self {
        let tables = vec![("alarms", alarm_table::table()), ("faults", fault_tables::tables())];
        Self { tables, claims: claims() }
    }

    /// The documents that state something.
    fn documents(&self) -> Vec<&'static str> {
        let mut documents: Vec<_> = self.claims.iter().map(|(document, _)| *document).collect();
        documents.dedup();
        documents
    }

    /// A document's tables, by their marks.
    fn tables_of(&self, document: &str) -> &[(&'static str, String)] {
        if document == SAFETY { &self.tables } else { &[] }
    }

    fn claims_of(&self, document: &str) -> impl Iterator<Item = &Claim> {
        self.claims.iter().filter(move |(of, _)| *of == document).map(|(_, claim)| claim)
    }

    /// Where a document's text differs from the code.
    fn problems<'a>(&'a self, document: &'a str, text: &'a str) -> impl Iterator<Item = String> + 'a {
        let outdated = |(name, table): &(&str, String)| {
            let stated: Vec<_> = between_marks(text, name).1.lines().collect();
            let missing = || table.lines().find(|line| !stated.contains(line)).unwrap_or_default();
            (!table.lines().eq(stated.iter().copied()))
                .then(|| format!("the part `{name}` is outdated; the code has: {}", missing()))
        };
        let tables = self.tables_of(document).iter().filter_map(outdated);
        tables.chain(self.claims_of(document).filter_map(|claim| claim.problem(text)))
    }

    /// The text with the code's tables and numbers.
    fn corrected(&self, document: &str, mut text: String) -> String {
        for (name, table) in self.tables_of(document) {
            let (before, _, after) = between_marks(&text, name);
            text = [before, table, after].concat();
        }
        self.claims_of(document).fold(text, |text, claim| claim.corrected(text))
    }
}

/// The text before, in and after a part between marks.
fn between_marks<'a>(text: &'a str, name: &str) -> (&'a str, &'a str, &'a str) {
    let mark = |end: &str| format!("<!-- {name}: {end} -->");
    let at = |end: &str| text.find(&mark(end)).unwrap_or_else(|| panic!("{SAFETY} lacks {}", mark(end)));
    let (begin, end) = (at("begin") + mark("begin").len() + 1, at("end"));
    (&text[..begin], &text[begin..end], &text[end..])
}

#[test]
fn the_documents_state_the_numbers_that_act() {
    let code = Code::new();
    let mut problems = Vec::new();
    for document in code.documents() {
        if tests::blesses() {
            fs::write(path(document), code.corrected(document, read(document))).unwrap();
        }
        let text = read(document);
        problems.extend(code.problems(document, &text).map(|problem| format!("{document}: {problem}")));
    }
    assert!(
        problems.is_empty(),
        "documents and code differ; if the code is right, run {BLESS}\n{}",
        problems.join("\n")
    );
}

#[test]
fn each_number_of_the_safety_document_is_reported_when_it_changes() {
    let code = Code::new();
    // An outdated table would hide every other difference.
    let text = code.corrected(SAFETY, read(SAFETY));
    let unchecked: Vec<_> = checked_numbers(&text)
        .into_iter()
        .filter(|number| {
            let changed = [&text[..number.start], "7431", &text[number.end..]].concat();
            code.problems(SAFETY, &changed).next().is_none()
        })
        .map(|number| {
            let line = 1 + text[..number.start].matches('\n').count();
            format!("{SAFETY}:{line}: {}", &text[number])
        })
        .collect();
    assert!(
        unchecked.is_empty(),
        "these numbers are checked by nothing: add their sentence to claims.rs or, if they are results of \
         measurements, put them between `measured` marks\n{}",
        unchecked.join("\n")
    );
}

#[test]
fn a_number_of_the_code_that_changes_is_reported_and_written() {
    let code = Code::new();
    for (document, claim) in &code.claims {
        let text = read(document);
        for changed in claim.with_each_figure_changed() {
            let problem = changed.problem(&text).unwrap_or_else(|| panic!("unnoticed: {changed:?}"));
            assert!(problem.contains("7431"), "{problem}");
            assert_eq!(changed.problem(&changed.corrected(text.clone())), None);
        }
    }
}

#[test]
fn every_alarm_that_a_monitor_raises_has_a_fault_that_proves_it() {
    for alarm in &ALARMS {
        assert!(cases().any(|case| case.monitors.contains(&alarm.fault)), "{}", alarm.id);
    }
}

#[test]
fn every_row_has_an_alarm_or_a_safeguard() {
    for case in cases() {
        assert_ne!(case.monitors.is_empty(), case.safeguard.is_none(), "{}", case.name);
    }
}
