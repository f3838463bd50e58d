//! Licences, sources and known vulnerabilities of all dependencies, by cargo-deny with the rules of deny.toml.

use std::path::PathBuf;

use anyhow::{Context, Result};
use serde_json::Value;
use xshell::{Shell, cmd};

/// What `RustSec`'s database says.
#[derive(Debug, PartialEq, Eq)]
pub enum Advisories {
    /// It cannot be reached, for this reason.
    Unreachable(String),
    /// Crates with known vulnerabilities, or that are no longer maintained; one line each.
    Found(Vec<String>),
}

/// The program, which the set-up installs where it is missing.
fn program(shell: &Shell) -> PathBuf {
    let own = shell.current_dir().join("target/deny/bin/cargo-deny");
    if own.exists() { own } else { "cargo-deny".into() }
}

/// Fails if a licence or a source is not allowed.
pub fn check(shell: &Shell) -> Result<()> {
    let program = program(shell);
    cmd!(shell, "{program} --locked --log-level error check bans licenses sources")
        .quiet()
        .run()
        .context("cargo-deny refuses a dependency, or is missing: cargo xtask setup installs it")
}

/// Known vulnerabilities, from the database as it is today.
pub fn advisories(shell: &Shell) -> Result<Advisories> {
    let program = program(shell);
    let output = cmd!(shell, "{program} --locked --format json check advisories")
        .env("GIT_TERMINAL_PROMPT", "0")
        .quiet()
        .ignore_status()
        .output()
        .context("cargo-deny is missing: cargo xtask setup installs it")?;
    told(&String::from_utf8_lossy(&output.stderr), output.status.success())
}

/// The meaning of what the program says, one value in JSON per line.
fn told(lines: &str, succeeded: bool) -> Result<Advisories> {
    let values: Vec<Value> = lines.lines().filter_map(|line| serde_json::from_str(line).ok()).collect();
    let of = |kind| values.iter().filter(move |value| value["type"] == kind).map(|value| &value["fields"]);
    let mut logged = of("log").filter_map(|fields| fields["message"].as_str());
    if let Some(message) = logged.find(|message| message.starts_with("failed to fetch advisory database")) {
        return Ok(Advisories::Unreachable(message.lines().last().unwrap_or_default().to_owned()));
    }
    let found: Vec<_> = of("diagnostic")
        .filter(|fields| fields["advisory"].is_object())
        .map(|fields| {
            let word = |key: &str| fields["advisory"][key].as_str().unwrap_or_default();
            format!("{} in {}: {}", word("id"), word("package"), word("title"))
        })
        .collect();
    anyhow::ensure!(succeeded || !found.is_empty(), "cargo-deny fails: {lines}");
    Ok(Advisories::Found(found))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_database_out_of_reach_is_neither_a_finding_nor_a_clean_result() {
        let line = r#"{"fields":{"level":"ERROR","message":"failed to fetch advisory database\nCloning\nfatal: no route"},"type":"log"}"#;
        assert_eq!(told(line, false).unwrap(), Advisories::Unreachable("fatal: no route".into()));
    }

    #[test]
    fn vulnerabilities_are_told_and_their_absence_too() {
        let line = r#"{"fields":{"advisory":{"id":"RUSTSEC-2020-0001","package":"crc","title":"wrong"},"code":"vulnerability"},"type":"diagnostic"}"#;
        assert_eq!(
            told(line, false).unwrap(),
            Advisories::Found(vec!["RUSTSEC-2020-0001 in crc: wrong".into()])
        );
        let none = r#"{"fields":{"advisories":{"errors":0}},"type":"summary"}"#;
        assert_eq!(told(none, true).unwrap(), Advisories::Found(Vec::new()));
        assert!(told(none, false).is_err(), "an unknown failure");
    }
}
