//! A command in a folder of its own: as a whole, and submitted to an engine.

use std::fs;
use std::path::PathBuf;
use std::process::{Command, Output};

use tempfile::TempDir;

/// A command of a second or two.
pub const COMMAND: &str = "torture --breaths 1200 --seed 5";

/// A folder, and the variables that programs in it see.
pub struct Place {
    folder: TempDir,
    variables: Vec<(&'static str, PathBuf)>,
}

impl Place {
    pub fn new() -> Self {
        Self { folder: tempfile::tempdir().unwrap(), variables: Vec::new() }
    }

    /// The same folder, in which programs see a variable with the path of a file.
    pub fn with(self, name: &'static str, file: &str) -> Self {
        let variables = vec![(name, self.path(file))];
        Self { variables, ..self }
    }

    pub fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    /// A program in the folder.
    pub fn program(&self, program: &str) -> Command {
        let mut command = Command::new(program);
        command
            .current_dir(self.folder.path())
            .envs(self.variables.iter().map(|(name, value)| (name, value)));
        command
    }

    /// The trainer with arguments separated by blanks.
    pub fn command(&self, line: &str) -> Command {
        let mut command = self.program(env!("CARGO_BIN_EXE_trainer"));
        command.args(line.split_whitespace());
        command
    }

    pub fn run(&self, line: &str) -> Output {
        self.command(line).output().unwrap()
    }

    /// Runs a command that must succeed; returns standard output.
    pub fn ok(&self, line: &str) -> String {
        let output = self.run(line);
        assert!(output.status.success(), "{line}: {}", text(&output.stderr));
        text(&output.stdout)
    }

    /// The results of the command as a whole.
    pub fn whole(&self) -> String {
        self.ok(&format!("{COMMAND} --json whole.json"));
        fs::read_to_string(self.path("whole.json")).unwrap()
    }

    /// Where the merge of a submitted command writes its results: a task may run in any folder.
    pub fn merged(&self) -> PathBuf {
        self.path("merged.json")
    }

    /// The command to submit, after `--`.
    pub fn submitted(&self) -> String {
        format!("-- {COMMAND} --out run --json {}", self.merged().display())
    }
}

/// Output as text.
pub fn text(bytes: &[u8]) -> String {
    String::from_utf8_lossy(bytes).into_owned()
}
