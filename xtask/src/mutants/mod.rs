//! `cargo xtask mutants`: breaks the core in one place after the other, and demands that a test fails each time.
//!
//! cargo-mutants lists the mutants. To build each of them would take hours, so most are grafted onto one program, which picks one by
//! its number; the others have a build each. What survives the unit tests of `shared` must stand in [`LIST`], with the reason why
//! no test catches it.

mod graft;
mod mutant;
mod tree;
mod trial;
mod tried;

use std::collections::BTreeMap;
use std::process::exit;

use anyhow::{Context, Result, ensure};
use serde::Deserialize;
use xshell::{Shell, cmd};

use mutant::{Listed, Mutant, Outcome, Outcomes};
use tried::try_all;

/// The release of cargo-mutants; [`LIST`] names mutations in its words.
const VERSION: &str = "27.1.0";
/// What is mutated: all that decides about a valve, and what stands between a host or a flash and that. Safety includes the choice of
/// the sensor (`source`) and backup ventilation, control what is learned from breath to breath (`memory`), and device what survives
/// a reset (`prescription`).
const AREAS: [&str; 7] = [
    "shared/src/safety/**",
    "shared/src/control/**",
    "shared/src/ventilator.rs",
    "shared/src/trigger.rs",
    "shared/src/device/**",
    "shared/src/weights/**",
    "shared/src/link/**",
];
/// Survivors that are accepted.
const LIST: &str = "shared/survivors.toml";
/// Arguments of `cargo xtask mutants`.
#[derive(clap::Args)]
#[command(
    after_help = "By default all of shared's safety (with source and backup), control (with memory), ventilator, trigger, device \
                        (with lease and prescription), weights and link are mutated.\n\n\
                        A mutant has another operator, guard, arm or field, or a function with another result. None lacks a whole \
                        statement, such as the reset of a field: each of those needs a test that was seen to fail without it.\n\n\
                        Example: one file, after a change to it or to its tests\n    \
                        cargo xtask mutants --file shared/src/safety/ladder.rs"
)]
pub struct Arguments {
    /// Mutate only these files of the core; may hold `*` and `**`
    #[arg(long, value_name = "GLOB")]
    file: Vec<String>,
    /// Mutants that are tried side by side
    #[arg(short, long, value_name = "N", default_value_t = cores())]
    jobs: usize,
    /// Go on after an interruption: what has been caught is not tried again
    #[arg(long)]
    resume: bool,
}

fn cores() -> usize {
    std::thread::available_parallelism().map_or(1, usize::from)
}

/// The committed list.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct List {
    #[serde(default)]
    accepted: Vec<Accepted>,
}

/// A survivor that is accepted.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
struct Accepted {
    file: String,
    mutation: String,
    becomes: Option<String>,
    reason: String,
}

impl Accepted {
    fn explains(&self, mutant: &Mutant) -> bool {
        let same_line = self.becomes.is_none() || self.becomes == mutant.becomes;
        self.file == mutant.file && self.mutation == mutant.mutation && same_line && !self.reason.is_empty()
    }
}

/// Installs cargo-mutants, unless this release is there.
pub fn install(shell: &Shell) -> Result<()> {
    if is_installed(shell) {
        println!("cargo-mutants: present");
        return Ok(());
    }
    Ok(cmd!(shell, "cargo install cargo-mutants --version {VERSION} --locked").quiet().run()?)
}

fn is_installed(shell: &Shell) -> bool {
    let version = cmd!(shell, "cargo mutants --version").quiet().ignore_stderr().read();
    version.is_ok_and(|version| version == format!("cargo-mutants {VERSION}"))
}

/// Tries all mutants, or those of some files, and compares the survivors with the list.
pub fn run(shell: &Shell, arguments: &Arguments) -> Result<()> {
    ensure!(is_installed(shell), "cargo-mutants {VERSION} is missing; run: cargo xtask setup --mutants");
    let List { accepted } = toml::from_str(&shell.read_file(LIST)?).context(LIST)?;
    let globs: Vec<&str> = match arguments.file.as_slice() {
        [] => AREAS.to_vec(),
        globs => globs.iter().map(String::as_str).collect(),
    };
    let selection: Vec<&str> = globs.iter().flat_map(|glob| ["--file", glob]).collect();
    let mutants = list(shell, &selection)?;
    ensure!(!mutants.is_empty(), "there is nothing to mutate in {}", globs.join(", "));
    let outcomes = try_all(shell, arguments.jobs, arguments.resume, &mutants)?;
    let verdict = Verdict::new(&mutants, &outcomes, &accepted);
    ensure!(verdict.untried == 0, "{} mutants were not tried; go on with --resume", verdict.untried);
    print!("{}", verdict.text());
    if !verdict.unexplained.is_empty() {
        // The last line tells why.
        exit(1);
    }
    Ok(())
}

/// All mutants of the selected files.
fn list(shell: &Shell, selection: &[&str]) -> Result<Vec<Mutant>> {
    let json = cmd!(shell, "cargo mutants --list --json --package shared {selection...}").quiet().read()?;
    let listed: Vec<Listed> = serde_json::from_str(&json)?;
    let mut sources = BTreeMap::new();
    for Listed { file, .. } in &listed {
        if !sources.contains_key(file) {
            sources.insert(file.clone(), shell.read_file(file)?);
        }
    }
    let identified = listed.into_iter().map(|mutant| {
        let source = &sources[&mutant.file];
        Mutant::new(mutant, source)
    });
    Ok(identified.collect())
}

/// What a run says of the tests.
#[derive(Debug, Default, PartialEq)]
struct Verdict<'a> {
    caught: usize,
    explained: usize,
    unexplained: Vec<&'a Mutant>,
    not_compiling: usize,
    untried: usize,
    /// Entries of the list that explain nothing.
    stale: Vec<&'a Accepted>,
}

impl<'a> Verdict<'a> {
    fn new(mutants: &'a [Mutant], outcomes: &Outcomes, accepted: &'a [Accepted]) -> Self {
        let mut verdict = Self::default();
        let survived = |mutant: &Mutant| outcomes.get(&mutant.name) == Some(&Outcome::Survived);
        for mutant in mutants {
            match outcomes.get(&mutant.name) {
                None => verdict.untried += 1,
                Some(Outcome::Caught) => verdict.caught += 1,
                Some(Outcome::DoesNotCompile) => verdict.not_compiling += 1,
                Some(Outcome::Survived) if accepted.iter().any(|entry| entry.explains(mutant)) => {
                    verdict.explained += 1;
                }
                Some(Outcome::Survived) => verdict.unexplained.push(mutant),
            }
        }
        let tried = |entry: &&Accepted| mutants.iter().any(|mutant| mutant.file == entry.file);
        let explains =
            |entry: &Accepted| mutants.iter().any(|mutant| survived(mutant) && entry.explains(mutant));
        verdict.stale = accepted.iter().filter(tried).filter(|entry| !explains(entry)).collect();
        verdict
    }

    /// What there is to do, and a last line that counts.
    fn text(&self) -> String {
        let mut lines = vec![String::new()];
        for Accepted { file, mutation, becomes, .. } in &self.stale {
            let line = becomes.as_deref().unwrap_or("(no line)");
            lines.push(format!("{LIST} explains what did not survive: {file}: {mutation}: {line}"));
        }
        lines.extend(self.unexplained.iter().map(|mutant| format!("{}\n{}", mutant.name, mutant.entry())));
        if !self.unexplained.is_empty() {
            lines.push(format!("catch these by tests, or accept them in {LIST} and say why"));
        }
        if self.not_compiling > 0 {
            lines.push(format!("{} more do not compile", self.not_compiling));
        }
        let (caught, explained, unexplained) = (self.caught, self.explained, self.unexplained.len());
        let all = caught + explained + unexplained;
        lines.push(format!(
            "{all} mutants: {caught} caught, {explained} explained, {unexplained} unexplained\n"
        ));
        lines.join("\n")
    }
}

#[cfg(test)]
mod tests {
    use super::mutant::{Place, Span};
    use super::*;

    const SOURCE: &str = "fn high(p: f32) -> bool {\n    p > 40.0 && p > 0.0\n}\n";

    /// Mutants of [`SOURCE`] as cargo-mutants lists them.
    fn mutants() -> Vec<Mutant> {
        let json = r#"[
            {"name": "a.rs:2:5: replace high -> bool with true", "file": "a.rs", "replacement": "true",
             "span": {"start": {"line": 2, "column": 5}, "end": {"line": 2, "column": 24}}},
            {"name": "a.rs:2:7: replace > with >= in high", "file": "a.rs", "replacement": ">=",
             "span": {"start": {"line": 2, "column": 7}, "end": {"line": 2, "column": 8}}},
            {"name": "a.rs:2:19: replace > with >= in high", "file": "a.rs", "replacement": ">=",
             "span": {"start": {"line": 2, "column": 19}, "end": {"line": 2, "column": 20}}}
        ]"#;
        let listed: Vec<Listed> = serde_json::from_str(json).unwrap();
        listed.into_iter().map(|listed| Mutant::new(listed, SOURCE)).collect()
    }

    fn accepted(becomes: &str) -> Accepted {
        Accepted {
            file: "a.rs".to_owned(),
            mutation: "replace > with >= in high".to_owned(),
            becomes: Some(becomes.to_owned()),
            reason: "no pressure is exactly 40".to_owned(),
        }
    }

    /// The mutants of [`SOURCE`], of which the first is caught and the others survive.
    fn outcomes(mutants: &[Mutant]) -> Outcomes {
        let outcome = |n| if n == 0 { Outcome::Caught } else { Outcome::Survived };
        mutants.iter().enumerate().map(|(n, mutant)| (mutant.name.clone(), outcome(n))).collect()
    }

    fn last_line(text: &str) -> &str {
        text.lines().last().unwrap()
    }

    #[test]
    fn mutants_of_one_line_are_told_apart_by_what_it_becomes() {
        let lines: Vec<_> = mutants().into_iter().map(|mutant| mutant.becomes.unwrap()).collect();
        assert_eq!(lines, ["true", "p >= 40.0 && p > 0.0", "p > 40.0 && p >= 0.0"]);
    }

    #[test]
    fn a_survivor_with_a_reason_is_explained_and_any_other_is_not() {
        let (mutants, list) = (mutants(), [accepted("p >= 40.0 && p > 0.0")]);
        let verdict = Verdict::new(&mutants, &outcomes(&mutants), &list);
        assert_eq!((verdict.unexplained.as_slice(), verdict.stale.len()), ([&mutants[2]].as_slice(), 0));
        assert_eq!(last_line(&verdict.text()), "3 mutants: 1 caught, 1 explained, 1 unexplained");
        let silent = [Accepted { reason: String::new(), ..list[0].clone() }];
        assert_eq!(Verdict::new(&mutants, &outcomes(&mutants), &silent).explained, 0);
    }

    #[test]
    fn an_entry_stays_true_when_its_line_moves() {
        let moved = format!("//! Pressures.\n\n{SOURCE}");
        let span = |column| Place { line: 4, column };
        let listed = Listed {
            name: "a.rs:4:7: replace > with >= in high".to_owned(),
            file: "a.rs".to_owned(),
            replacement: ">=".to_owned(),
            span: Span { start: span(7), end: span(8) },
        };
        assert!(accepted("p >= 40.0 && p > 0.0").explains(&Mutant::new(listed, &moved)));
    }

    #[test]
    fn an_entry_that_explains_nothing_is_named_if_its_file_was_mutated() {
        let (mutants, list) = (mutants(), [accepted("p >= 30.0 && p > 0.0")]);
        let verdict = Verdict::new(&mutants, &outcomes(&mutants), &list);
        assert!(verdict.text().contains("did not survive: a.rs: replace > with >= in high: p >= 30.0"));
        assert_eq!(Verdict::new(&mutants[..1], &outcomes(&mutants), &list).stale.len(), 1);
        assert_eq!(Verdict::new(&[], &Outcomes::new(), &list).stale.len(), 0);
    }

    #[test]
    fn what_does_not_compile_is_no_mutant_and_what_was_not_tried_is_counted() {
        let mutants = mutants();
        let tried = Outcomes::from([(mutants[0].name.clone(), Outcome::DoesNotCompile)]);
        let verdict = Verdict::new(&mutants, &tried, &[]);
        assert_eq!((verdict.not_compiling, verdict.untried), (1, 2));
        assert_eq!(last_line(&verdict.text()), "0 mutants: 0 caught, 0 explained, 0 unexplained");
    }

    #[test]
    fn the_entry_that_is_offered_accepts_its_mutant_once_it_has_a_reason() {
        for mutant in mutants() {
            let text = mutant.entry().replace("\"\"", "\"harmless\"");
            let list: List = toml::from_str(&text).unwrap();
            assert!(list.accepted[0].explains(&mutant), "{text}");
        }
    }

    /// Parts in which a defect would not show in a well-behaved breath: they are in an area, and their functions share a build.
    #[test]
    fn what_acts_only_after_a_fault_or_a_reset_is_mutated() {
        let files = [
            "safety/source.rs",
            "safety/backup.rs",
            "safety/supervisor.rs",
            "safety/supervisor/state.rs",
            "control/memory.rs",
            "ventilator.rs",
            "trigger.rs",
            "device/control.rs",
            "device/lease.rs",
            "device/server.rs",
            "device/prescription.rs",
            "weights/slots.rs",
        ];
        let shell = Shell::new().unwrap();
        shell.change_dir("..");
        for file in files.map(|file| format!("shared/src/{file}")) {
            let is_in = |area: &&str| file.starts_with(area.trim_end_matches('*'));
            assert!(AREAS.iter().any(is_in), "{file} is in no area");
            let source = shell.read_file(&file).unwrap();
            // A mutation at the start of each body, as far as the text tells where one is.
            let starts = source.match_indices(" {\n").map(|(at, text)| at + text.len());
            let mutations: Vec<_> = (1..)
                .zip(starts)
                .map(|(number, at)| graft::Mutation { number, range: at..at, replacement: "" })
                .collect();
            let grafted = graft::graft(&source, &mutations).unwrap();
            let share = mutations.len() - grafted.alone.len();
            assert!(2 * share > mutations.len(), "{file}: {share} of {} share a build", mutations.len());
        }
    }

    #[test]
    fn the_committed_list_gives_a_reason_for_each_survivor_of_a_file_that_exists() {
        let shell = Shell::new().unwrap();
        shell.change_dir("..");
        let List { accepted } = toml::from_str(&shell.read_file(LIST).unwrap()).unwrap();
        for (place, entry) in accepted.iter().enumerate() {
            assert!(shell.path_exists(&entry.file) && !entry.reason.is_empty(), "{entry:?}");
            assert!(!accepted[..place].contains(entry), "twice: {entry:?}");
        }
    }
}
