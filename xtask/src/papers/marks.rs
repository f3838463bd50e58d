//! Marks in comments, which name requirements where code fulfils and tests verify them: `Fulfils: leak` at a constant, function or type,
//! `Verifies: leak, peep-flow` at a test, and either one in the head of a file for all of it.

use std::path::Path;

use anyhow::{Context, Result};

/// Folders with marks.
const FOLDERS: [&str; 5] = ["firmware", "host", "lab", "shared", "tests"];
/// Words before a name.
const KEYWORDS: [&str; 7] = ["fn", "const", "static", "struct", "enum", "trait", "type"];

/// Whether code fulfils a requirement, or a test verifies it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Role {
    /// Code.
    Fulfils,
    /// A test.
    Verifies,
}

/// A mark.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Mark {
    /// Id of the requirement.
    pub requirement: String,
    /// What the item is to it.
    pub role: Role,
    /// Path of the file from the top.
    pub file: String,
    /// Name of the item; none in the head of a file.
    pub item: Option<String>,
    /// Whether the item, or something in the file, is a test.
    pub is_test: bool,
}

/// All marks of the repository, in the order of the files' paths.
pub fn all(root: &Path) -> Result<Vec<Mark>> {
    let mut marks = Vec::new();
    for folder in FOLDERS {
        search(root, folder, &mut marks)?;
    }
    Ok(marks)
}

fn search(root: &Path, folder: &str, marks: &mut Vec<Mark>) -> Result<()> {
    let entries = std::fs::read_dir(root.join(folder)).with_context(|| format!("cannot read {folder}"))?;
    let mut names = Vec::new();
    for entry in entries {
        let entry = entry?;
        names.push((entry.file_name().to_string_lossy().into_owned(), entry.file_type()?.is_dir()));
    }
    names.sort_unstable();
    for (name, is_folder) in names {
        let path = format!("{folder}/{name}");
        if is_folder && !["target", "node_modules"].contains(&&*name) {
            search(root, &path, marks)?;
        } else if Path::new(&name).extension().is_some_and(|end| end == "rs") {
            let text = std::fs::read_to_string(root.join(&path)).with_context(|| path.clone())?;
            marks.extend(of_file(&path, &text));
        }
    }
    Ok(())
}

/// The marks of a file.
fn of_file(path: &str, text: &str) -> Vec<Mark> {
    let lines: Vec<&str> = text.lines().map(str::trim_start).collect();
    let mut marks = Vec::new();
    for (at, line) in lines.iter().enumerate().filter(|(_, line)| line.starts_with("//")) {
        for (word, role) in [("Fulfils: ", Role::Fulfils), ("Verifies: ", Role::Verifies)] {
            let Some((_, list)) = line.split_once(word) else { continue };
            let (item, is_test) = if line.starts_with("//!") {
                (None, lines.iter().any(|line| line.starts_with("#[test]")))
            } else {
                item_after(&lines[at..])
            };
            marks.extend(ids(list).map(|id| Mark {
                requirement: id.to_owned(),
                role,
                file: path.to_owned(),
                item: item.clone(),
                is_test,
            }));
        }
    }
    marks
}

/// Ids between commas, up to the first other character.
fn ids(list: &str) -> impl Iterator<Item = &str> {
    let end = list.find(|letter: char| !(letter.is_ascii_lowercase() || "-, ".contains(letter)));
    list[..end.unwrap_or(list.len())].split(',').map(str::trim).filter(|id| !id.is_empty())
}

/// Name of the item behind a comment, and whether it is a test.
fn item_after(lines: &[&str]) -> (Option<String>, bool) {
    let before_item = |line: &&&str| line.starts_with("//") || line.starts_with("#[") || line.is_empty();
    let is_test = lines.iter().take_while(before_item).any(|line| line.starts_with("#[test]"));
    let item = lines.iter().find(|line| !before_item(line)).map_or("", |line| line);
    let mut words = item.split([' ', '(', ':', '<', '{', ';']).filter(|word| !word.is_empty());
    let named =
        words.clone().skip_while(|word| !KEYWORDS.contains(word)).find(|word| !KEYWORDS.contains(word));
    (named.or_else(|| words.next()).map(str::to_owned), is_test)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_mark_names_its_requirements_and_the_item_behind_it() {
        let text =
            "/// Fraction, s. Fulfils: leak, peep-flow. Or so.\n#[inline]\npub const OPEN: f32 = 0.6;\n";
        let marks = of_file("a.rs", text);
        let found: Vec<_> = marks.iter().map(|mark| (&*mark.requirement, mark.item.as_deref())).collect();
        assert_eq!(found, [("leak", Some("OPEN")), ("peep-flow", Some("OPEN"))]);
        assert!(marks.iter().all(|mark| mark.role == Role::Fulfils && !mark.is_test));
        assert_eq!(
            of_file("a.rs", "    /// Verifies: leak.\n    confirmed: bool,\n")[0].item.as_deref(),
            Some("confirmed")
        );
    }

    #[test]
    fn a_test_is_told_from_other_code() {
        let at_test = "/// Verifies: leak.\n#[test]\nfn leaks() {}\n";
        assert!(
            of_file("a.rs", at_test).iter().all(|mark| mark.is_test && mark.item.as_deref() == Some("leaks"))
        );
        assert!(!of_file("a.rs", "/// Verifies: leak.\nfn leaks() {}\n#[test]\n")[0].is_test);
        let head = of_file("a.rs", "//! Verifies: leak.\n\n#[test]\nfn leaks() {}\n");
        assert!(head[0].is_test && head[0].item.is_none());
    }

    #[test]
    fn only_comments_hold_marks() {
        assert_eq!(of_file("a.rs", "let text = \"Fulfils: leak\";\n"), []);
    }
}
