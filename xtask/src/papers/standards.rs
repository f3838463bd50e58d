//! What there is for the headings of IEC 62304 and ISO 14971, and what is missing.

use anyhow::{Context, Result};
use serde::Deserialize;

use super::report::table;

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Standards {
    heading: Vec<Heading>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Heading {
    clause: String,
    there: String,
    missing: String,
}

fn headings() -> Result<Vec<Heading>> {
    let standards: Standards = toml::from_str(include_str!("standards.toml")).context("standards.toml")?;
    Ok(standards.heading)
}

/// The table of the headings.
pub fn standards() -> Result<String> {
    let rows = headings()?.into_iter().map(|heading| {
        [heading.clause, heading.there, heading.missing]
            .map(|cell| if cell.is_empty() { "-".into() } else { cell })
            .into()
    });
    Ok(format!(
        "The headings are those of public checklists and tables of contents of IEC 62304:2006 with amendment 1:2015 and of \
         ISO 14971:2019; the standards themselves were not read. Nothing here claims conformity.\n\n{}",
        table(&["heading", "there", "missing"], rows)
    ))
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use super::*;
    use crate::papers::{PAPERS, sbom};

    #[test]
    fn each_heading_names_what_exists_or_what_is_missing() {
        let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("..");
        for Heading { clause, there, missing } in headings().unwrap() {
            assert!(!(there.is_empty() && missing.is_empty()), "{clause}");
            let quoted = there.split('`').skip(1).step_by(2);
            for path in quoted.filter(|word| word.contains(['/', '.'])) {
                let paper = PAPERS.iter().chain(&sbom::FILES).any(|paper| *paper == path);
                assert!(paper || root.join(path).exists(), "{clause} names {path}");
            }
        }
    }
}
