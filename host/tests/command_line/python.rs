//! The Python examples: whether they can run, as servers, and command lines that start them.

use std::io::{BufRead, BufReader};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output, Stdio};

use super::support::{Place, text};

/// An example of the repository.
pub fn example(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../examples/python").join(name)
}

/// Whether Python is installed; says so if it is not.
pub fn python_is_there() -> bool {
    let there = Command::new("python3").arg("--version").output().is_ok_and(|output| output.status.success());
    if !there {
        eprintln!("skipped: python3 is not installed");
    }
    there
}

/// An example as a server, which prints its port; ends when dropped.
pub struct Server {
    process: Child,
    port: u16,
}

impl Server {
    pub fn start(script: &Path, arguments: &[&str]) -> Self {
        let mut command = Command::new("python3");
        command.arg(script).args(arguments).stderr(Stdio::piped());
        let mut process = command.spawn().unwrap();
        let mut line = String::new();
        BufReader::new(process.stderr.take().unwrap()).read_line(&mut line).unwrap();
        let port = line.trim().rsplit(' ').next().unwrap().parse().unwrap();
        Self { process, port }
    }

    pub fn address(&self) -> String {
        format!("tcp:localhost:{}", self.port)
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        self.process.kill().unwrap();
        self.process.wait().unwrap();
    }
}

/// Runs a line in which a non-breaking space represents a blank within an argument.
pub fn run(place: &Place, line: &str) -> Output {
    let mut command = place.command("");
    command.args(line.split_ascii_whitespace().map(|word| word.replace('\u{a0}', " ")));
    command.output().unwrap()
}

/// Runs such a line, which must succeed; returns standard output.
pub fn ok(place: &Place, line: &str) -> String {
    let output = run(place, line);
    assert!(output.status.success() && output.stderr.is_empty(), "{line}: {}", text(&output.stderr));
    text(&output.stdout)
}

/// Runs such a line, which must succeed; returns its JSON.
pub fn json(place: &Place, line: &str) -> serde_json::Value {
    serde_json::from_str(&ok(place, &format!("{line} --json -"))).unwrap()
}

/// Runs such a line, which must be refused; returns the reason.
pub fn refused(place: &Place, line: &str) -> String {
    let output = run(place, line);
    let stderr = text(&output.stderr);
    assert_eq!(output.status.code(), Some(1), "{line}: {stderr}");
    stderr
}
