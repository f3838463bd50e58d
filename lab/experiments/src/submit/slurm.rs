//! Slurm: a job array with one task for each shard, and a job that merges them, which depends on it.

use std::time::{Duration, Instant};

use progress::Progress;
use serde::{Deserialize, Serialize};

use super::{Job, SubmitError, THREADS, answer, run, text};
use campaign::shell::quoted;
use data::workspace::Workspace;

/// What to do without Slurm.
const HINT: &str = "is this a login node of a Slurm cluster?";

/// File of the jobs in the folder of the scripts.
const JOBS: &str = "jobs.json";
/// How long a queue that cannot be asked is waited for.
const SILENT: Duration = Duration::from_mins(5);

/// How to submit.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Slurm {
    /// Options of `sbatch` for all jobs, such as `--partition=short`.
    pub options: Vec<String>,
    /// How often shards that are not complete are submitted again.
    pub retries: u32,
}

/// Submitted jobs.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Submitted {
    /// Number of the job array; none if all shards were complete.
    pub array: Option<String>,
    /// Number of the job that merges.
    pub merge: String,
}

impl Slurm {
    fn options(&self) -> String {
        self.options.iter().map(|option| ["#SBATCH ", option, "\n"].concat()).collect()
    }

    /// Script of the array of these shards.
    pub fn array_script(&self, job: &Job, shards: &[u64]) -> String {
        format!(
            "#!/bin/sh\n#SBATCH --job-name=eupnea-{}\n#SBATCH --array={}\n#SBATCH --output={}\n#SBATCH --requeue\n\
             #SBATCH --open-mode=append\n{}{}exec {}\n",
            job.arguments.first().map_or("", String::as_str),
            ranges(shards),
            quoted(job.log().join("%a.txt")),
            self.options(),
            threads(),
            job.shard_line("\"$SLURM_ARRAY_TASK_ID\""),
        )
    }

    /// Script of the job that merges.
    pub fn merge_script(&self, job: &Job) -> String {
        format!(
            "#!/bin/sh\n#SBATCH --job-name=eupnea-merge\n#SBATCH --output={}\n#SBATCH --requeue\n{}{}{}\nstatus=$?\n\
             echo $status >{}\nexit $status\n",
            quoted(job.merge_log()),
            self.options(),
            threads(),
            job.merge_line(),
            quoted(job.merge_status()),
        )
    }

    /// Submits the shards that are not complete and the merge after them, unless earlier jobs for them are still in the queue.
    ///
    /// # Errors
    /// A folder that cannot be written or is divided differently, or a refusal of `sbatch`.
    pub fn submit(&self, job: &Job) -> Result<Submitted, SubmitError> {
        let (open, log) = (job.open()?, Workspace::new(job.log()));
        if let Some(earlier) = log.load::<Submitted>(JOBS)?
            && !Queue::default().left(&earlier.merge)?
        {
            return Ok(earlier);
        }
        for old in [job.merge_log(), job.merge_status()] {
            // Most often there is none.
            let _ = std::fs::remove_file(old);
        }
        let merge = text(&job.write("merge.sh", &self.merge_script(job))?);
        let jobs = if open.is_empty() {
            Submitted { array: None, merge: answer("sbatch", &["--parsable", &merge], HINT)? }
        } else {
            let array = text(&job.write("array.sh", &self.array_script(job, &open))?);
            let array = answer("sbatch", &["--parsable", &array], HINT).map_err(too_many)?;
            // After any end: a task that has saved its shard may still end badly, and the merge names what is missing.
            let dependency = format!("--dependency=afterany:{array}");
            let merge = answer("sbatch", &["--parsable", &dependency, &merge], HINT);
            if merge.is_err() {
                let _ = answer("scancel", &[&array], HINT);
            }
            Submitted { array: Some(array), merge: merge? }
        };
        log.save(JOBS, &jobs)?;
        Ok(jobs)
    }

    /// Submits the shards and watches them until they are merged; submits those that fail again. False if it was stopped before: the
    /// jobs go on.
    ///
    /// # Errors
    /// See [`Self::submit`]; shards that are not complete after all retries, or a merge that fails.
    pub fn run(
        &self,
        job: &Job,
        progress: &Progress<'_>,
        submitted: &mut dyn FnMut(&Submitted),
    ) -> Result<bool, SubmitError> {
        let mut left = self.retries;
        loop {
            let jobs = self.submit(job)?;
            submitted(&jobs);
            let mut queue = Queue::default();
            job.watch(progress, || queue.left(&jobs.merge))?;
            if progress.stopped() {
                return Ok(false);
            }
            match merge_status(job) {
                Some(0) => return Ok(true),
                status if job.open()?.is_empty() && (status.is_some() || left == 0) => {
                    return Err(SubmitError::Merge { status: status.unwrap_or(-1), log: job.merge_log() });
                }
                _ if left == 0 => return job.incomplete().map(|()| false),
                _ => left -= 1,
            }
        }
    }
}

/// The refusal of an array with advice where its size may be the reason: Slurm only calls it invalid.
fn too_many(error: SubmitError) -> SubmitError {
    match error {
        SubmitError::Refused { program, message } if message.to_lowercase().contains("array") => {
            let advice = "use fewer --shards than `scontrol show config | grep MaxArraySize` says";
            SubmitError::Refused { program, message: format!("{message}; {advice}") }
        }
        other => other,
    }
}

/// Line that gives a job as many threads as it has cores, where Slurm does not confine it to them, unless the user has set a number.
fn threads() -> String {
    format!("export {THREADS}=\"${{{THREADS}:-$SLURM_CPUS_ON_NODE}}\"\n")
}

/// Exit status of the merge; none if it has not come to its end.
fn merge_status(job: &Job) -> Option<i32> {
    std::fs::read_to_string(job.merge_status()).ok()?.trim().parse().ok()
}

/// Slurm's queue.
#[derive(Default)]
struct Queue {
    /// Since when it cannot be asked.
    silent_since: Option<Instant>,
}

impl Queue {
    /// Whether a job has left the queue. A controller that restarts is waited for.
    fn left(&mut self, id: &str) -> Result<bool, SubmitError> {
        let output = run("squeue", &["--noheader", "--jobs", id], HINT)?;
        if output.status.success() {
            self.silent_since = None;
            return Ok(output.stdout.is_empty());
        }
        let message = String::from_utf8_lossy(&output.stderr).trim().replace('\n', "; ");
        // Slurm forgets jobs after a while.
        if message.contains("Invalid job id") {
            return Ok(true);
        }
        if self.silent_since.get_or_insert_with(Instant::now).elapsed() > SILENT {
            return Err(SubmitError::Refused { program: "squeue", message });
        }
        Ok(false)
    }
}

/// Numbers in ascending order as `--array` takes them, such as 0-39 or 3,17-19.
fn ranges(numbers: &[u64]) -> String {
    let mut ranges: Vec<(u64, u64)> = Vec::new();
    for number in numbers {
        match ranges.last_mut() {
            Some((_, last)) if *last + 1 == *number => *last = *number,
            _ => ranges.push((*number, *number)),
        }
    }
    let range = |(first, last): (u64, u64)| {
        if first == last { first.to_string() } else { format!("{first}-{last}") }
    };
    ranges.into_iter().map(range).collect::<Vec<_>>().join(",")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_array_names_ranges_of_shards() {
        assert_eq!(ranges(&(0..40).collect::<Vec<_>>()), "0-39");
        assert_eq!(ranges(&[3, 17, 18, 19, 30]), "3,17-19,30");
        assert_eq!(ranges(&[5]), "5");
    }

    #[test]
    fn an_array_that_slurm_calls_invalid_is_told_its_limit() {
        let refused = |message: &str| SubmitError::Refused { program: "sbatch", message: message.to_owned() };
        let told = |message| too_many(refused(message)).to_string();
        let array = told("sbatch: error: Batch job submission failed: Invalid job array specification");
        assert!(array.contains("MaxArraySize") && array.contains("--shards"), "{array}");
        assert!(!told("sbatch: error: invalid partition specified: night").contains("MaxArraySize"));
    }

    #[test]
    fn the_scripts_run_each_shard_and_then_the_merge() {
        let job = Job {
            program: "/opt/lab".into(),
            arguments: ["torture", "--breaths", "6000"].map(str::to_owned).to_vec(),
            out: "/data/my run".into(),
            shards: 40,
        };
        let slurm = Slurm { options: vec!["--partition=short".to_owned()], retries: 0 };
        let script = slurm.array_script(&job, &[3, 17]);
        let command =
            "exec /opt/lab torture --breaths 6000 --out '/data/my run' --shard \"$SLURM_ARRAY_TASK_ID\"/40\n";
        assert!(script.starts_with("#!/bin/sh\n") && script.ends_with(command), "{script}");
        for option in ["--array=3,17", "--output='/data/my run/log/%a.txt'", "--requeue", "--partition=short"]
        {
            assert!(script.contains(&format!("#SBATCH {option}\n")), "{option}: {script}");
        }
        let merge = slurm.merge_script(&job);
        assert!(
            merge.contains("\n/opt/lab torture --breaths 6000 --out '/data/my run' --merge\n"),
            "{merge}"
        );
    }
}
