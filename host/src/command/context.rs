//! What a command runs in: the request to stop, its progress, and its output.

use std::io::{self, ErrorKind, Write};
use std::path::Path;
use std::sync::OnceLock;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;

use campaign::record::Options;
use campaign::shell::quoted;
use progress::{Event, Progress};
use show::report::{Block, Report, Section, Table, duration};

use super::bars::with_bars;

/// Receives the progress of a command, on any thread.
pub type Observer<'a> = dyn Fn(&Event<'_>) + Send + Sync + 'a;

/// What a command runs in.
#[derive(Clone, Copy)]
pub struct Context<'a> {
    /// The request to stop.
    pub(super) stop: &'a AtomicBool,
    /// Receives the progress; none shows it as bars.
    pub(super) observer: Option<&'a Observer<'a>>,
    /// Whether tables and lines are left out.
    pub(super) silent: bool,
    /// The options of the command.
    pub(super) options: &'a Options,
    /// The command line, as a shell takes it.
    pub(super) line: &'a str,
    /// When the command began.
    pub(super) began: Instant,
    /// Why a line was lost, if one was.
    pub(super) lost: &'a OnceLock<io::Error>,
}

impl Context<'_> {
    /// Runs work that reports its progress and stops on request.
    pub fn progress<T>(&self, work: impl FnOnce(&Progress<'_>) -> T) -> T {
        match self.observer {
            Some(observer) => work(&Progress::new(observer, self.stop)),
            None => with_bars(self.stop, work),
        }
    }

    /// The request to stop.
    pub fn stop(&self) -> &AtomicBool {
        self.stop
    }

    /// Whether the command is to stop, and to keep its results so far.
    pub fn stopped(&self) -> bool {
        self.stop.load(Ordering::Relaxed)
    }

    /// The options of the command with their values, for records of parts of its run.
    pub fn options(&self) -> &Options {
        self.options
    }

    /// The bench of this command as an option of another one, if it has one.
    pub fn bench_option(&self) -> String {
        // Several benches are separated by blanks, as are the words of a file's name: leave out what is not one word.
        let bench = self.options.get("bench").filter(|bench| !bench.is_empty() && !bench.contains(' '));
        bench.map_or_else(String::new, |bench| format!(" --bench {}", quoted(bench)))
    }

    /// Prints a table, unless standard output is for JSON alone.
    pub fn table(&self, table: &Table) {
        self.line(&format!("{}\n", table.to_terminal()));
    }

    /// Prints a line, unless standard output is for JSON alone or belongs to a program that has called the command.
    pub fn line(&self, text: &str) {
        if !self.silent {
            // Neither is a reason to stop: files are still to be written. That nobody reads on (`| head`) is not even an error.
            match writeln!(io::stdout(), "{text}") {
                Err(error) if error.kind() != ErrorKind::BrokenPipe => drop(self.lost.set(error)),
                _ => {}
            }
        }
    }

    /// Reports that a file was written.
    pub fn saved(&self, path: &Path) {
        self.line(&format!("saved {}", path.display()));
    }

    /// Writes a report, if requested, with the command that made it and the time it took.
    ///
    /// # Errors
    /// A report that cannot be made, or a file that cannot be written.
    pub fn report(
        &self,
        path: Option<&Path>,
        report: impl FnOnce() -> anyhow::Result<Report>,
    ) -> anyhow::Result<()> {
        let Some(path) = path else { return Ok(()) };
        let mut report = report()?;
        let time =
            format!("This command made the page, in {}:", duration(self.began.elapsed().as_secs_f64()));
        let made = vec![Block::Command(self.line.to_owned())];
        report.sections.push(Section::new("How this page was made", time, made));
        report.save(path)?;
        self.saved(path);
        Ok(())
    }
}
