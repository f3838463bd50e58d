//! A sweep: one command of the program, run with every combination of some options.
//!
//! The runs are the units of a campaign. Each is a process of its own with a folder of its own, so a run that was stopped continues if
//! its command can. Of its JSON only the chosen figures are kept.

use std::collections::BTreeMap;
use std::io;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use campaign::{Sums, Work, WorkspaceError, engine};
use serde::{Deserialize, Serialize};
use serde_json::Value;
use thiserror::Error;

use data::files::read_json;
use progress::{Stage, Task};

/// A sweep over options: runs.
pub const SWEEP: Stage = Stage("run the sweep");

/// Why a sweep cannot be run.
#[derive(Debug, Error)]
#[expect(missing_docs, reason = "the messages name every field")]
pub enum SweepError {
    /// The description cannot be read.
    #[error("cannot read {}: {source}", path.display())]
    File { path: PathBuf, source: io::Error },
    /// The description is not valid.
    #[error("{}: {message}", path.display())]
    Description { path: PathBuf, message: String },
    /// The program cannot be started.
    #[error("cannot run {}: {source}", program.display())]
    Program { program: PathBuf, source: io::Error },
    /// A run has failed.
    #[error("run {number} ({point}) failed: {message}")]
    Run { number: u64, point: String, message: String },
    /// A run's JSON has no such number.
    #[error("run {number} ({point}) gave no number {figure}: its JSON is in {}", json.display())]
    Figure { number: u64, point: String, figure: String, json: PathBuf },
    /// The sweep cannot be divided, kept or merged.
    #[error(transparent)]
    Workspace(#[from] WorkspaceError),
}

/// A sweep, as a TOML file describes it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Sweep {
    /// The command with the options that all runs have, separated by blanks. `{out}` stands for a run's own folder; `--json` is added.
    pub command: String,
    /// Figures to keep, as paths into the command's JSON such as `mean.learned`.
    pub figures: Vec<String>,
    /// Values of each option that varies.
    pub options: BTreeMap<String, Vec<Value>>,
}

/// A run's options, by name.
pub type Point = BTreeMap<String, Value>;

impl Sweep {
    /// Reads a description.
    ///
    /// # Errors
    /// A file that cannot be read, or that describes no runs.
    pub fn load(path: &Path) -> Result<Self, SweepError> {
        let file = |source| SweepError::File { path: path.to_owned(), source };
        let wrong = |message: String| SweepError::Description { path: path.to_owned(), message };
        let text = std::fs::read_to_string(path).map_err(file)?;
        let sweep: Self =
            toml::from_str(&text).map_err(|error| wrong(error.to_string().trim().to_owned()))?;
        let empty = sweep.options.iter().find(|(_, values)| values.is_empty());
        if let Some((name, _)) = empty {
            return Err(wrong(format!("option {name} has no value")));
        }
        if sweep.command.trim().is_empty() || sweep.figures.is_empty() {
            return Err(wrong("it needs a command and at least one figure".to_owned()));
        }
        if sweep.command.split_whitespace().any(|word| word == "--json") {
            return Err(wrong("leave out --json: every run has its own".to_owned()));
        }
        Ok(sweep)
    }

    /// Number of runs.
    pub fn runs(&self) -> u64 {
        self.options.values().map(|values| values.len() as u64).product()
    }

    /// Options of a run; the last option varies fastest.
    pub fn point(&self, number: u64) -> Point {
        let mut rest = number as usize;
        let mut point = Point::new();
        for (name, values) in self.options.iter().rev() {
            point.insert(name.clone(), values[rest % values.len()].clone());
            rest /= values.len();
        }
        point
    }

    /// Arguments of a run in a folder.
    fn arguments(&self, point: &Point, folder: &Path) -> Vec<String> {
        let folder = folder.to_string_lossy();
        let words = self.command.split_whitespace();
        let mut words: Vec<String> = words.map(|word| word.replace("{out}", &folder)).collect();
        for (name, value) in point {
            match value {
                Value::Bool(true) => words.push(format!("--{name}")),
                Value::Bool(false) => {}
                // One word, so that a negative number is not taken for an option.
                value => words.push(format!("--{name}={}", plain(value))),
            }
        }
        words
    }
}

/// A value as on a command line.
fn plain(value: &Value) -> String {
    value.as_str().map_or_else(|| value.to_string(), str::to_owned)
}

/// A point in words, such as `rounds 2, seed 5`.
pub fn in_words(point: &Point) -> String {
    point.iter().map(|(name, value)| format!("{name} {}", plain(value))).collect::<Vec<_>>().join(", ")
}

/// Result of a run.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct RunResult {
    /// Its options.
    pub options: Point,
    /// Its figures, in the order of the description.
    pub figures: Vec<f64>,
}

/// Results by the run's number.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(transparent)]
pub struct RunResults(pub BTreeMap<u64, RunResult>);

impl Sums for RunResults {
    type Unit = RunResult;

    fn add(&mut self, number: u64, result: RunResult) {
        self.0.insert(number, result);
    }

    fn absorb(&mut self, other: Self) {
        self.0.extend(other.0);
    }
}

/// A sweep in a folder.
#[derive(Clone, Debug)]
pub struct SweepWork<'a> {
    /// The sweep.
    pub sweep: &'a Sweep,
    /// The program.
    pub program: PathBuf,
    /// Folder of all runs.
    pub out: PathBuf,
}

impl Work for SweepWork<'_> {
    type Question = Sweep;
    type Sums = RunResults;
    type Error = SweepError;

    fn question(&self) -> Sweep {
        self.sweep.clone()
    }

    fn nothing(&self) -> RunResults {
        RunResults::default()
    }

    fn stage(&self) -> (Stage, f64) {
        (SWEEP, 1.0)
    }

    fn unit(&self, number: u64, task: &Task<'_>) -> Result<Option<RunResult>, SweepError> {
        let options = self.sweep.point(number);
        let (folder, json) =
            (self.out.join(format!("runs/{number}")), self.out.join(format!("runs/{number}.json")));
        let program = |source| SweepError::Program { program: self.program.clone(), source };
        let mut command = Command::new(&self.program);
        command
            .args(self.sweep.arguments(&options, &folder))
            .arg("--json")
            .arg(&json)
            // As many runs at a time as there are cores: each has one.
            .env("RAYON_NUM_THREADS", "1")
            .stdin(Stdio::null());
        // The number of this task is not the command's.
        for variable in engine::variables() {
            command.env_remove(variable);
        }
        let output = command.output().map_err(program)?;
        let point = in_words(&options);
        if !output.status.success() {
            if task.stopped() {
                return Ok(None);
            }
            let errors = String::from_utf8_lossy(&output.stderr);
            let message = errors.lines().find_map(|line| line.strip_prefix("error: "));
            let message = message.map_or_else(|| output.status.to_string(), str::to_owned);
            return Err(SweepError::Run { number, point, message });
        }
        let found: Option<Value> =
            read_json(&json).map_err(|source| SweepError::File { path: json.clone(), source })?;
        let found = found.unwrap_or_default();
        let figure = |name: &String| {
            let pointer = format!("/{}", name.replace('.', "/"));
            found.pointer(&pointer).and_then(Value::as_f64).ok_or_else(|| SweepError::Figure {
                number,
                point: point.clone(),
                figure: name.clone(),
                json: json.clone(),
            })
        };
        let figures = self.sweep.figures.iter().map(figure).collect::<Result<_, _>>()?;
        task.advance(1);
        Ok(Some(RunResult { options, figures }))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn described(text: &str) -> Result<Sweep, SweepError> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("sweep.toml");
        std::fs::write(&path, text).unwrap();
        Sweep::load(&path)
    }

    #[test]
    fn every_combination_of_the_options_is_one_run() {
        let text = "command = \"demo --out {out}\"\nfigures = [\"mean.learned\"]\n\
                    [options]\nrounds = [1, 3]\nseed = [1, 2, 3]\nbreathing = [true, false]\n";
        let sweep = described(text).unwrap();
        assert_eq!(sweep.runs(), 12);
        let words: Vec<_> =
            (0..12).map(|number| sweep.arguments(&sweep.point(number), Path::new("run")).join(" ")).collect();
        assert_eq!(words[0], "demo --out run --breathing --rounds=1 --seed=1");
        assert_eq!(words[11], "demo --out run --rounds=3 --seed=3");
        let different: std::collections::BTreeSet<_> = words.iter().collect();
        assert_eq!(different.len(), 12);
        assert_eq!(in_words(&sweep.point(4)), "breathing true, rounds 3, seed 2");
    }

    #[test]
    fn a_description_without_runs_or_with_unknown_keys_is_refused() {
        for (text, reason) in [
            ("command = \"demo\"\nfigures = [\"a\"]\n[options]\nseed = []\n", "option seed has no value"),
            ("command = \"demo\"\nfigures = []\n[options]\n", "at least one figure"),
            ("command = \"demo --json x\"\nfigures = [\"a\"]\n[options]\n", "leave out --json"),
            ("comand = \"demo\"\n", "comand"),
        ] {
            let refused = described(text).unwrap_err().to_string();
            assert!(refused.contains(reason) && refused.contains("sweep.toml"), "{refused}");
        }
    }
}
