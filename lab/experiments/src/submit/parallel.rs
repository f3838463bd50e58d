//! GNU parallel: tasks on this machine.

use std::fs::File;
use std::num::NonZero;
use std::os::unix::process::CommandExt;
use std::path::Path;
use std::process::Command;
use std::time::Duration;

use progress::Progress;

use super::{Job, SubmitError, THREADS};
use campaign::WorkspaceError;
use campaign::shell::quoted;

/// What to do without GNU parallel.
const HINT: &str = "install GNU parallel (Debian: apt-get install parallel)";

/// Time between two signals.
const BETWEEN_SIGNALS: Duration = Duration::from_millis(300);

/// How to run the tasks.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Parallel {
    /// Tasks at a time; as many as there are cores if it is not given.
    pub jobs: Option<u32>,
    /// How often a task that fails is started again.
    pub retries: u32,
}

impl Parallel {
    /// Arguments of `parallel`, which reads the numbers of the shards.
    fn arguments(&self, job: &Job) -> Vec<String> {
        let jobs = self.jobs.map(|jobs| format!("--jobs={jobs}"));
        let options = [
            "--will-cite".to_owned(),
            // An interrupted task saves what it has done.
            "--termseq=INT,60000,KILL,100".to_owned(),
            format!("--retries={}", self.retries.saturating_add(1)),
            format!("--joblog={}", job.log().join("parallel.txt").display()),
        ];
        options.into_iter().chain(jobs).chain([job.shard_line("{}")]).collect()
    }

    /// Threads of each task: its share of this machine's cores, at least one.
    fn threads(&self) -> usize {
        let cores = std::thread::available_parallelism().map_or(1, NonZero::get);
        let jobs = self.jobs.map_or(cores, |jobs| jobs as usize);
        (cores / jobs.max(1)).max(1)
    }

    /// The command lines: of all shards, then of the merge.
    pub fn script(&self, job: &Job) -> String {
        let threads = format!("{THREADS}=\"${{{THREADS}:-{}}}\"", self.threads());
        let words: Vec<_> = self.arguments(job).iter().map(quoted).collect();
        let last = job.shards - 1;
        let (words, merge) = (words.join(" "), job.merge_line());
        format!("#!/bin/sh\nseq 0 {last} | {threads} parallel {words}\n{merge}\n")
    }

    /// Runs the shards that are not complete, then merges all. False if it was stopped.
    ///
    /// # Errors
    /// A folder that cannot be written or is divided differently, no GNU parallel, shards that are not complete after all retries, or a
    /// merge that fails.
    pub fn run(&self, job: &Job, progress: &Progress<'_>) -> Result<bool, SubmitError> {
        let open = job.open()?;
        job.write("parallel.sh", &self.script(job))?;
        if !open.is_empty() {
            self.run_shards(job, &open, progress)?;
        }
        if progress.stopped() {
            return Ok(false);
        }
        job.incomplete()?;
        let mut merge = Command::new(&job.program);
        merge.args(&job.arguments).args(["--merge", "--out"]).arg(&job.out);
        let merged =
            printing(&mut merge, &job.merge_log())?.status().map_err(WorkspaceError::file(&job.program))?;
        match merged.code() {
            _ if progress.stopped() => Ok(false),
            Some(0) => Ok(true),
            status => Err(SubmitError::Merge { status: status.unwrap_or(-1), log: job.merge_log() }),
        }
    }

    fn run_shards(&self, job: &Job, open: &[u64], progress: &Progress<'_>) -> Result<(), SubmitError> {
        let failed = |source| SubmitError::Program { program: "parallel", source, hint: HINT };
        let numbers = open.iter().map(u64::to_string).collect::<Vec<_>>().join("\n");
        let numbers = job.write("open.txt", &numbers)?;
        let input = File::open(&numbers).map_err(WorkspaceError::file(&numbers))?;
        let mut parallel = Command::new("parallel");
        // In a group of its own, so that Ctrl-C reaches only this program.
        parallel.args(self.arguments(job)).stdin(input).process_group(0);
        if std::env::var_os(THREADS).is_none() {
            parallel.env(THREADS, self.threads().to_string());
        }
        let mut tasks = printing(&mut parallel, &job.log().join("tasks.txt"))?.spawn().map_err(failed)?;
        let watched = job.watch(progress, || Ok(tasks.try_wait().map_err(failed)?.is_some()));
        if progress.stopped() {
            // The first signal ends the starting of tasks, the second interrupts those that run.
            for _ in 0..2 {
                let _ = Command::new("kill").arg(tasks.id().to_string()).status();
                std::thread::sleep(BETWEEN_SIGNALS);
            }
        }
        tasks.wait().map_err(failed)?;
        watched
    }
}

/// A command that prints everything into a file.
fn printing<'a>(command: &'a mut Command, path: &Path) -> Result<&'a mut Command, SubmitError> {
    let output = File::create(path).map_err(WorkspaceError::file(path))?;
    let errors = output.try_clone().map_err(WorkspaceError::file(path))?;
    Ok(command.stdout(output).stderr(errors))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_task_gets_its_share_of_the_cores() {
        let threads = |jobs| Parallel { jobs, retries: 0 }.threads();
        let cores = std::thread::available_parallelism().unwrap().get();
        assert_eq!((threads(None), threads(Some(1)), threads(Some(u32::MAX))), (1, cores, 1));
        assert_eq!(threads(Some(2)), (cores / 2).max(1));
    }
}
