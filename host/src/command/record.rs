//! Keeps the record of a run beside its results: begins it before a command, ends it after, whatever the command is.

use std::fs;
use std::path::{Path, PathBuf};

use campaign::record::{Ending, MADE_BY, Options, Record, Results, Running};
use clap::{Arg, ArgMatches, Command};

use super::output::{JSON, Makes, Output};

/// The options of the chosen command of a program with their values, defaults included. Values that are a name with a value, as in
/// `--settings peep=8,rate=15`, count as options of their own, so that runs can be compared and plotted by them.
pub fn options(program: &Command, matches: &ArgMatches) -> Options {
    let Some((name, matches)) = matches.subcommand() else { return Options::default() };
    let Some(command) = program.find_subcommand(name) else { return Options::default() };
    command.get_arguments().flat_map(|argument| named(argument, matches)).collect()
}

/// An option with its values, or the named values of one that takes such.
fn named(argument: &Arg, matches: &ArgMatches) -> Vec<(String, String)> {
    let Ok(Some(raw)) = matches.try_get_raw(argument.get_id().as_str()) else { return Vec::new() };
    let values: Vec<String> = raw.map(|value| value.to_string_lossy().into_owned()).collect();
    let name = argument.get_long().unwrap_or(argument.get_id().as_str()).to_owned();
    match values.iter().map(|value| pair(value)).collect::<Option<Vec<_>>>() {
        Some(pairs) if !pairs.is_empty() => pairs,
        _ => vec![(name, values.join(" "))],
    }
}

/// The name and the value of `NAME=VALUE`.
fn pair(text: &str) -> Option<(String, String)> {
    let (name, value) = text.split_once('=')?;
    let is_name = name.bytes().all(|letter| letter.is_ascii_lowercase() || letter == b'_');
    is_name.then(|| (name.to_owned(), value.to_owned()))
}

/// Where a record belongs.
#[derive(Debug, PartialEq)]
pub struct Place {
    /// The record.
    record: PathBuf,
    /// What the command makes: a folder or a file.
    made: PathBuf,
}

impl Place {
    /// The place of the record of a command with this output; none if it keeps none.
    pub fn of(output: Output<'_>) -> Option<Self> {
        let (record, made) = match output.makes {
            Makes::Nothing | Makes::Shard => return None,
            Makes::Folder(folder) => (folder.join(MADE_BY), folder),
            Makes::Experiment => {
                let file = output.json.filter(|_| !output.is_standard_output())?;
                (file.with_extension(MADE_BY), file)
            }
        };
        Some(Self { record, made: made.to_owned() })
    }

    /// Whether the command has made anything.
    fn is_made(&self) -> bool {
        let files = fs::read_dir(&self.made).map(Iterator::count);
        files.map_or_else(|_| self.made.exists(), |files| files > usize::from(self.record.exists()))
    }
}

/// The record of the running command.
pub struct Kept {
    place: Place,
    running: Running,
    /// Whether the file has the record of an earlier run, which only results replace: a refused command changes nothing.
    deferred: bool,
    /// Folders that did not exist, the innermost first.
    new: Vec<PathBuf>,
}

impl Kept {
    /// Begins the record of a command with these options.
    pub fn begin(place: Place, options: &Options) -> Self {
        // A record that cannot be read is replaced: nothing depends on it.
        let earlier = Record::load(&place.record).ok().flatten();
        let record = Record::begin(options);
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

    /// Ends the record, with the numbers of the outcome if there is one.
    pub fn end(self, ending: Ending, results: Option<Results>) {
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
        options.remove(JSON);
        options
    };
    relevant(one) == relevant(other)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_record_is_in_the_folder_or_beside_the_json_of_an_experiment() {
        let place =
            |makes, json: Option<&str>| Some(Place::of(Output { makes, json: json.map(Path::new) })?.record);
        let folder = Makes::Folder(Path::new("a"));
        for (makes, json, record) in [
            (folder, None, Some("a/made-by.json")),
            (folder, Some("b.json"), Some("a/made-by.json")),
            (Makes::Experiment, Some("a/b.json"), Some("a/b.made-by.json")),
            (Makes::Experiment, Some("-"), None),
            (Makes::Experiment, None, None),
            (Makes::Shard, Some("b.json"), None),
            (Makes::Nothing, Some("b.json"), None),
        ] {
            assert_eq!(place(makes, json), record.map(PathBuf::from), "{makes:?} {json:?}");
        }
    }

    #[test]
    fn options_are_kept_with_their_defaults() {
        let option = |name: &'static str| Arg::new(name).long(name);
        let train = Command::new("train").args([
            option("out"),
            option("seed").default_value("1"),
            option("pips").value_delimiter(','),
            option("settings").value_delimiter(','),
            option("plant"),
            option("breathing").action(clap::ArgAction::SetTrue),
            option("gains"),
        ]);
        let program = Command::new("trainer").subcommand(train);
        let typed = ["--out", "a", "--pips", "15,20", "--settings", "peep=8,rate=15", "--plant", "pipe:a=b"];
        let line = ["trainer", "train"].into_iter().chain(typed);
        let options = options(&program, &program.clone().get_matches_from(line));
        let value = |name: &str| options.get(name).map(String::as_str);
        assert_eq!((value("out"), value("seed"), value("pips")), (Some("a"), Some("1"), Some("15 20")));
        assert_eq!((value("breathing"), value("gains")), (Some("false"), None));
        assert_eq!((value("peep"), value("rate"), value("settings")), (Some("8"), Some("15"), None));
        assert_eq!(value("plant"), Some("pipe:a=b"));
    }
}
