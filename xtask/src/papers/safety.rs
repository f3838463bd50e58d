//! The requirements of SAFETY.md and the hazards that they answer, read from its tables. A test holds the tables to the constants that
//! act (`tests/tests/safety_document`), so nothing is stated a second time.

use std::collections::BTreeMap;

use anyhow::{Context, Result};

/// The document.
pub const DOCUMENT: &str = "SAFETY.md";
/// The column of a table of hazards with the ids of requirements.
const COLUMN: &str = "requirement";

/// What keeps a cause harmless: an alarm with its response, or a safeguard.
#[derive(Debug, Default)]
pub struct Requirement {
    /// In words.
    pub text: String,
    /// What it answers.
    pub causes: Vec<Cause>,
}

/// A cause of a hazard.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Cause {
    /// The hazard.
    pub hazard: String,
    /// The cause, which is the name of a row if the fault matrix injects it.
    pub name: String,
    /// Whether the fault matrix injects it.
    pub injected: bool,
}

/// What the document states.
#[derive(Debug, Default)]
pub struct Safety {
    /// Requirements by id.
    pub requirements: BTreeMap<String, Requirement>,
    /// Hazards and causes without a requirement.
    pub unanswered: Vec<String>,
}

impl Safety {
    /// Reads the document's tables.
    pub fn read(text: &str) -> Result<Self> {
        let mut safety = Self::default();
        for row in part(text, "alarms")?.lines().filter_map(cells) {
            if let ([id], [_, priority, action, entry, ..]) = (&ids(&row[0])[..], &row[..]) {
                let text = format!("{entry}: {action} ({priority} priority)");
                safety.requirements.insert(id.clone(), Requirement { text, causes: Vec::new() });
            }
        }
        let faults = part(text, "faults")?;
        let others = text.split_once(faults).map_or("", |(_, after)| after);
        for (text, injected) in [(faults, true), (others, false)] {
            for (hazard, rest) in hazards(text) {
                safety.add_table(hazard, rest, injected)?;
            }
        }
        Ok(safety)
    }

    /// Adds the table below a hazard.
    fn add_table(&mut self, hazard: &str, text: &str, injected: bool) -> Result<()> {
        let mut rows = text.lines().skip_while(|line| line.is_empty()).map_while(cells);
        let head = rows.next().with_context(|| format!("\"{hazard}\" has no table"))?;
        let column = head.iter().position(|name| name == COLUMN);
        let column = column.with_context(|| format!("the table of \"{hazard}\" has no column {COLUMN}"))?;
        // After the line below the head.
        let mut rows = rows.skip(1).peekable();
        if rows.peek().is_none() {
            self.unanswered.push(hazard.to_owned());
        }
        for row in rows {
            self.add(&Cause { hazard: hazard.to_owned(), name: row[0].clone(), injected }, column, &row);
        }
        Ok(())
    }

    /// Adds a row of a table of hazards.
    fn add(&mut self, cause: &Cause, column: usize, row: &[String]) {
        let ids = row.get(column).map(|cell| ids(cell)).unwrap_or_default();
        if ids.is_empty() {
            self.unanswered.push(format!("{}: {}", cause.hazard, cause.name));
        }
        for id in ids {
            let requirement = self.requirements.entry(id).or_default();
            if requirement.text.is_empty() {
                requirement.text = row.get(column + 1).cloned().unwrap_or_default();
            }
            requirement.causes.push(cause.clone());
        }
    }
}

/// The part of a text between two marks.
fn part<'a>(text: &'a str, name: &str) -> Result<&'a str> {
    let after = text.split_once(&format!("<!-- {name}: begin -->")).map(|(_, after)| after);
    let part = after.and_then(|after| after.split_once(&format!("<!-- {name}: end -->")));
    Ok(part.with_context(|| format!("{DOCUMENT} lacks the part `{name}`"))?.0)
}

/// Hazards, each with the text behind its heading.
fn hazards(text: &str) -> impl Iterator<Item = (&str, &str)> {
    text.split("\nHazard: ").skip(1).filter_map(|rest| rest.split_once(".\n"))
}

/// The cells of a line of a table.
fn cells(line: &str) -> Option<Vec<String>> {
    let inner = line.strip_prefix("| ").or_else(|| line.strip_prefix("|-"))?.strip_suffix('|')?;
    Some(inner.split(" | ").map(|cell| cell.trim().to_owned()).collect())
}

/// The words in backquotes.
fn ids(cell: &str) -> Vec<String> {
    cell.split('`').skip(1).step_by(2).map(str::to_owned).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    const TEXT: &str = "<!-- alarms: begin -->
| alarm | priority | action | entry | exit | text |
|---|---|---|---|---|---|
| `leak` | medium | report | 5 breaths | gone | leak |
<!-- alarms: end -->
<!-- faults: begin -->

Hazard: too little gas.

| cause | requirement | response |
|---|---|---|
| small leak | `peep-flow` | a flow holds PEEP |
| large leak | `leak`, `peep-flow` | report |

<!-- faults: end -->

Hazard: another.

| cause | requirement | response |
|---|---|---|
| a host | none | refused |
";

    #[test]
    fn alarms_and_safeguards_are_requirements_with_their_hazards() {
        let safety = Safety::read(TEXT).unwrap();
        let ids: Vec<_> = safety.requirements.keys().collect();
        assert_eq!(ids, ["leak", "peep-flow"]);
        assert_eq!(safety.requirements["leak"].text, "5 breaths: report (medium priority)");
        let flow = &safety.requirements["peep-flow"];
        assert_eq!(flow.text, "a flow holds PEEP");
        let names: Vec<_> = flow.causes.iter().map(|cause| &cause.name).collect();
        assert_eq!(names, ["small leak", "large leak"]);
        assert!(flow.causes.iter().all(|cause| cause.injected && cause.hazard == "too little gas"));
    }

    #[test]
    fn a_cause_without_a_requirement_is_found() {
        assert_eq!(Safety::read(TEXT).unwrap().unanswered, ["another: a host"]);
    }
}
