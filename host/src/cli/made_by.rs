//! Keeps the record of a run beside its results: begins it before a command, ends it after, whatever the command is.

use std::fs;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};

use campaign::record::{self, Ending, MADE_BY, Options, Record, Results, Running};
use clap::{ArgMatches, Command};
use serde::Serialize;

use super::common::stopped;
use super::message;

/// Commands that keep a record beside their JSON if they have no folder: those whose JSON is the result of an experiment.
const EXPERIMENTS: [&str; 11] = [
    "bound",
    "endure",
    "evaluate",
    "faults",
    "fit",
    "margins",
    "robust",
    "test-table",
    "torture",
    "tune-pid",
    "tune-rival",
];

/// Numbers of the command's JSON, from [`keep`].
static RESULTS: Mutex<Option<Results>> = Mutex::new(None);

/// Keeps the numbers of a command's JSON for its record.
pub fn keep(results: &impl Serialize) -> anyhow::Result<()> {
    let results = Results::of(&serde_json::to_value(results)?);
    *RESULTS.lock().unwrap_or_else(PoisonError::into_inner) = Some(results);
    Ok(())
}

/// Runs the command given by some arguments, and keeps its record if it writes a folder or the JSON of an experiment.
pub fn recorded(
    cli: &Command,
    matches: &ArgMatches,
    run: impl FnOnce() -> anyhow::Result<()>,
) -> anyhow::Result<()> {
    // In a process that runs several commands, numbers of an earlier one may be left.
    *RESULTS.lock().unwrap_or_else(PoisonError::into_inner) = None;
    let Some((name, matches)) = matches.subcommand() else { return run() };
    let Some(command) = cli.find_subcommand(name) else { return run() };
    record::describe(options(command, matches));
    let Some(place) = Place::of(command, matches) else { return run() };
    let kept = Kept::begin(place);
    let outcome = run();
    let ending = match &outcome {
        Err(error) => Ending::Failed(message(error)),
        Ok(()) if stopped() => Ending::Stopped,
        Ok(()) => Ending::Complete,
    };
    kept.end(ending);
    outcome
}

/// The options of a command with their values, defaults included.
fn options(command: &Command, matches: &ArgMatches) -> Options {
    let value = |id: &str| {
        let values = matches.try_get_raw(id).ok().flatten()?;
        Some(values.map(|value| value.to_string_lossy()).collect::<Vec<_>>().join(" "))
    };
    let option = |argument: &clap::Arg| {
        let name = argument.get_long().unwrap_or(argument.get_id().as_str());
        Some((name.to_owned(), value(argument.get_id().as_str())?))
    };
    command.get_arguments().filter_map(option).collect()
}

/// Where a record belongs.
struct Place {
    /// The record.
    record: PathBuf,
    /// What the command makes: a folder or a file.
    made: PathBuf,
}

impl Place {
    /// The place of a command's record; none if it keeps none.
    fn of(command: &Command, matches: &ArgMatches) -> Option<Self> {
        let path = |id| matches.try_get_one::<PathBuf>(id).ok().flatten();
        let given = |id| matches.try_get_one::<bool>(id).ok().flatten() == Some(&true);
        let is_folder = |argument: &&clap::Arg| {
            argument.get_id() == "out"
                && argument.get_value_names().is_some_and(|names| names.iter().any(|name| name == "DIR"))
        };
        let folder = command.get_arguments().find(is_folder);
        if let Some((argument, folder)) = folder.zip(path("out")) {
            // A shard has a record of its own. Without a default, the folder is only that of shards.
            let divisible = command.get_arguments().any(|argument| argument.get_id() == "shard");
            let divided = matches.try_contains_id("shard").unwrap_or(false)
                || argument.get_default_values().is_empty() && !given("merge");
            let shard = divisible && divided;
            return (!shard).then(|| Self { record: folder.join(MADE_BY), made: folder.clone() });
        }
        let json = path("json").filter(|json| json.as_path() != Path::new("-"))?;
        let experiment = EXPERIMENTS.contains(&command.get_name());
        experiment.then(|| Self { record: json.with_extension(MADE_BY), made: json.clone() })
    }

    /// Whether the command has made anything.
    fn is_made(&self) -> bool {
        let files = fs::read_dir(&self.made).map(Iterator::count);
        files.map_or_else(|_| self.made.exists(), |files| files > usize::from(self.record.exists()))
    }
}

/// The record of the running command.
struct Kept {
    place: Place,
    running: Running,
    /// Whether the file has the record of an earlier run, which only results replace: a refused command changes nothing.
    deferred: bool,
    /// Folders that did not exist, the innermost first.
    new: Vec<PathBuf>,
}

impl Kept {
    fn begin(place: Place) -> Self {
        // A record that cannot be read is replaced: nothing depends on it.
        let earlier = Record::load(&place.record).ok().flatten();
        let record = Record::begin();
        let continued = earlier.as_ref().filter(|earlier| same(&earlier.options, &record.options));
        let record = continued.into_iter().fold(record, Record::continuing);
        let deferred = earlier.is_some_and(|earlier| {
            !same(&earlier.options, &record.options) || earlier.ending == Ending::Complete
        });
        let above = place.record.ancestors().skip(1).filter(|folder| *folder != Path::new(""));
        let new = above.take_while(|folder| !folder.exists()).map(Path::to_owned).collect();
        let running = record.running(&place.record);
        if !deferred {
            // The command fails with the reason if nothing can be written there.
            let _ = running.write();
        }
        Self { place, running, deferred, new }
    }

    fn end(self, ending: Ending) {
        let results = RESULTS.lock().unwrap_or_else(PoisonError::into_inner).take();
        let failed = matches!(ending, Ending::Failed(_));
        if self.deferred && results.is_none() && ending != Ending::Complete {
            return;
        }
        if failed && results.is_none() && !self.place.is_made() {
            // A refused command leaves nothing. Only empty folders are removed.
            let _ = fs::remove_file(&self.place.record);
            let _ = self.new.iter().try_for_each(fs::remove_dir);
            return;
        }
        if let Err(error) = self.running.end(ending, results.unwrap_or_default())
            && !failed
        {
            tracing::warn!("the record {} cannot be written: {error}", self.place.record.display());
        }
    }
}

/// Whether two commands with these options make the same. Where the JSON goes does not matter.
fn same(one: &Options, other: &Options) -> bool {
    let relevant = |options: &Options| {
        let mut options = options.clone();
        options.remove("json");
        options
    };
    relevant(one) == relevant(other)
}

#[cfg(test)]
mod tests {
    use super::super::Cli;
    use super::*;
    use clap::CommandFactory;

    fn place(line: &str) -> Option<PathBuf> {
        let (cli, words) = (Cli::command(), format!("trainer {line}"));
        let matches = cli.clone().try_get_matches_from(words.split(' ')).unwrap();
        let (name, matches) = matches.subcommand().unwrap();
        Some(Place::of(cli.find_subcommand(name).unwrap(), matches)?.record)
    }

    #[test]
    fn a_record_is_in_the_folder_or_beside_the_json_of_an_experiment() {
        for (line, wanted) in [
            ("demo", Some("out/demo/made-by.json")),
            ("demo --out a --json b.json", Some("a/made-by.json")),
            ("sweep a.toml --out a --merge", Some("a/made-by.json")),
            ("torture --out a --merge", Some("a/made-by.json")),
            ("torture --json a/b.json", Some("a/b.made-by.json")),
            ("torture --json -", None),
            ("torture", None),
            ("torture --out a", None),
            ("torture --shard 1/2 --out a", None),
            ("sweep a.toml --out a --shard 1/2", None),
            ("reproduce --shard 1/2 --out a", None),
            ("collect --out a.parquet --json b.json", None),
            ("inspect a.bin --json b.json", None),
        ] {
            assert_eq!(place(line), wanted.map(PathBuf::from), "{line}");
        }
    }

    #[test]
    fn options_are_kept_with_their_defaults() {
        let cli = Cli::command();
        let matches = cli.clone().get_matches_from(["trainer", "train", "--out", "a", "--pips", "15,20"]);
        let (name, matches) = matches.subcommand().unwrap();
        let options = options(cli.find_subcommand(name).unwrap(), matches);
        let value = |name: &str| options.get(name).map(String::as_str);
        assert_eq!((value("out"), value("seed"), value("pips")), (Some("a"), Some("1"), Some("15 20")));
        assert_eq!((value("breathing"), value("gains")), (Some("false"), None));
    }
}
