//! The trace matrix: requirement, hazard, code, test, last result; and what is missing in it.

use std::collections::BTreeMap;
use std::fmt::Write as _;

use serde_json::Value;

use super::marks::{Mark, Role};
use super::results::{Run, Steps, date};
use super::safety::{DOCUMENT, Safety};

/// What hazards, code and tests lack of each other, one sentence each.
pub fn gaps(safety: &Safety, marks: &[Mark]) -> Vec<String> {
    let mut gaps: Vec<String> = Vec::new();
    gaps.extend(safety.unanswered.iter().map(|cause| format!("no requirement answers \"{cause}\"")));
    for (id, requirement) in &safety.requirements {
        let marked = |role| marks.iter().any(|mark| mark.role == role && mark.requirement == *id);
        if requirement.causes.is_empty() {
            gaps.push(format!("`{id}` answers no hazard of {DOCUMENT}"));
        }
        if !marked(Role::Fulfils) {
            gaps.push(format!("no code says `Fulfils: {id}`"));
        }
        if !marked(Role::Verifies) && !requirement.causes.iter().any(|cause| cause.injected) {
            gaps.push(format!("no test says `Verifies: {id}`"));
        }
    }
    for mark in marks {
        if !safety.requirements.contains_key(&mark.requirement) {
            gaps.push(format!(
                "{} names `{}`, which {DOCUMENT} does not require",
                mark.file, mark.requirement
            ));
        }
        if mark.role == Role::Verifies && !mark.is_test {
            gaps.push(format!("{} says `Verifies: {}` at no test", mark.file, mark.requirement));
        }
    }
    gaps
}

/// The matrix.
pub fn matrix(safety: &Safety, marks: &[Mark], faults: Option<&Run>, steps: &Steps) -> String {
    let rows = faults.map(|run| lungs_by_fault(&run.value)).unwrap_or_default();
    let mut text = "\
Requirements and hazards are those of SAFETY.md. Code says `Fulfils: ID`, a test `Verifies: ID`; rows of the fault matrix verify what
their column requires. A result is that of the step of CI, or of the command, that ran last.\n"
        .to_owned();
    for (id, requirement) in &safety.requirements {
        writeln!(text, "\n## {id}\n\n{}\n\n| | |\n|---|---|", requirement.text).unwrap();
        for cause in &requirement.causes {
            writeln!(text, "| hazard | {}: {} |", cause.hazard, cause.name).unwrap();
        }
        let of = |role| marks.iter().filter(move |mark| mark.role == role && mark.requirement == *id);
        for mark in of(Role::Fulfils) {
            writeln!(text, "| code | {} |", place(mark)).unwrap();
        }
        for cause in requirement.causes.iter().filter(|cause| cause.injected) {
            let result = rows.get(&*cause.name).zip(faults);
            let result = result.map_or_else(
                || "not run: `cargo xtask faults`".to_owned(),
                |((passed, lungs), run)| {
                    let day = run.record.ended_s.map(date).unwrap_or_default();
                    format!("{passed} of {lungs} lungs pass, {} {day}", run.record.revision)
                },
            );
            writeln!(text, "| test | fault matrix, \"{}\": {result} |", cause.name).unwrap();
        }
        for mark in of(Role::Verifies) {
            writeln!(text, "| test | {}: {} |", place(mark), result(&mark.file, steps)).unwrap();
        }
    }
    text
}

/// File and item of a mark.
fn place(mark: &Mark) -> String {
    let item = mark.item.as_ref().map(|item| format!(" `{item}`")).unwrap_or_default();
    format!("`{}`{item}", mark.file)
}

/// The last result of a file's tests.
fn result(file: &str, steps: &Steps) -> String {
    let on_board = ["tests/tests/qemu/", "tests/tests/emulator.rs"].iter().any(|path| file.starts_with(path));
    let step = if on_board { "qemu-test" } else { "test" };
    match steps.get(step) {
        None => format!("not run: `cargo xtask ci --only {step}`"),
        Some(last) => {
            let result = if last.passed { "passed" } else { "FAILED" };
            format!("step {step} {result}, {} {}", last.revision, date(last.ended_s))
        }
    }
}

/// Lungs on which each fault's row passes, and all lungs of the row.
fn lungs_by_fault(value: &Value) -> BTreeMap<&str, (u32, u32)> {
    let mut faults = BTreeMap::new();
    for row in value["rows"].as_array().into_iter().flatten() {
        let (passed, all) = faults.entry(row["fault"].as_str().unwrap_or_default()).or_insert((0, 0));
        *passed += u32::from(row["pass"] == true);
        *all += 1;
    }
    faults
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use super::*;
    use crate::papers::marks;
    use crate::papers::results::{Record, Step};
    use crate::papers::safety::{Cause, Requirement};

    fn mark(requirement: &str, role: Role) -> Mark {
        let file = "shared/src/a.rs".to_owned();
        Mark { requirement: requirement.into(), role, file, item: Some("item".into()), is_test: true }
    }

    fn safety() -> Safety {
        let cause = |name: &str, injected| Cause { hazard: "gas".into(), name: name.into(), injected };
        let requirement = |causes| Requirement { text: "words".into(), causes };
        let requirements = [
            ("leak".to_owned(), requirement(vec![cause("large leak", true)])),
            ("lease".to_owned(), requirement(vec![cause("two programs", false)])),
        ];
        Safety { requirements: requirements.into(), unanswered: Vec::new() }
    }

    #[test]
    fn every_requirement_has_a_hazard_code_and_a_test_and_every_mark_a_requirement() {
        let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("..");
        let safety = Safety::read(&std::fs::read_to_string(root.join(DOCUMENT)).unwrap()).unwrap();
        let marks = marks::all(&root).unwrap();
        assert!(safety.requirements.len() > 50 && marks.len() > 100, "the documents or marks are not found");
        let gaps = gaps(&safety, &marks);
        assert!(gaps.is_empty(), "the trace matrix has gaps:\n{}", gaps.join("\n"));
    }

    #[test]
    fn each_kind_of_gap_is_found() {
        let marks =
            [mark("leak", Role::Fulfils), mark("lease", Role::Fulfils), mark("lease", Role::Verifies)];
        let found = |safety: &Safety, marks: &[Mark]| gaps(safety, marks).join("; ");
        assert_eq!(found(&safety(), &marks), "");
        assert_eq!(found(&safety(), &marks[1..]), "no code says `Fulfils: leak`");
        assert_eq!(found(&safety(), &marks[..2]), "no test says `Verifies: lease`");
        let unknown = [&marks[..], &[mark("leek", Role::Fulfils)]].concat();
        assert!(found(&safety(), &unknown).contains("`leek`"));
        let mut helper = marks.clone();
        helper[2].is_test = false;
        assert!(found(&safety(), &helper).contains("`Verifies: lease` at no test"));
        let mut harmless = safety();
        harmless.requirements.get_mut("lease").unwrap().causes.clear();
        assert!(found(&harmless, &marks).contains("`lease` answers no hazard"));
        let unanswered = Safety { unanswered: vec!["gas: a leak".into()], ..safety() };
        assert!(found(&unanswered, &marks).contains("no requirement answers \"gas: a leak\""));
    }

    #[test]
    fn the_matrix_states_the_last_result_or_how_to_get_it() {
        let marks = [mark("leak", Role::Fulfils), mark("lease", Role::Verifies)];
        let never = matrix(&safety(), &marks, None, &Steps::new());
        assert!(never.contains("\"large leak\": not run: `cargo xtask faults`"), "{never}");
        assert!(never.contains("`shared/src/a.rs` `item`: not run: `cargo xtask ci --only test`"), "{never}");
        let value = serde_json::json!({"rows": [{"fault": "large leak", "pass": true}, {"fault": "large leak", "pass": false}]});
        let record = Record { command: Vec::new(), revision: "abc".into(), ended_s: Some(0) };
        let step = Step { passed: true, revision: "def".into(), ended_s: 86_400 };
        let run = matrix(&safety(), &marks, Some(&Run { record, value }), &[("test".into(), step)].into());
        assert!(run.contains("\"large leak\": 1 of 2 lungs pass, abc 1970-01-01"), "{run}");
        assert!(run.contains("`item`: step test passed, def 1970-01-02"), "{run}");
    }
}
