//! `lab submit`: runs the shards of another command on an engine.

use std::path::{Path, PathBuf};

use anyhow::{Context as _, bail};

use super::Cli;
use super::program::{is_ours, program_of};
use experiments::submit::parallel::Parallel;
use experiments::submit::slurm::{Slurm, Submitted};
use experiments::submit::{Job, SubmitError};
use host::cli::Cli as Trainer;
use host::command::bounds::within;
use host::command::{Command, Context, Makes, Program};

/// Run a command in shards, on Slurm or with GNU parallel
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  lab submit slurm --shards 1000 -- robust --plants 10000000 --subset 0 --out out/robust
  lab submit slurm --dry-run -- torture --breaths 6000 --seed 5 --out out/torture
  lab submit slurm --option --partition=short --option --time=1:00:00 -- endure --patients 1000
  lab submit parallel --jobs 8 -- endure --patients 1000 --hours 24

The commands are robust, endure, torture, reproduce and sweep, and the trainer's tune-pid, with
their usual options.
Their folder (--out; without it out/NAME) must be one that all machines see: it is all that the
tasks share.

Slurm gets an array job, and a job that merges after it. What tasks and merge print is in the
folder `log`. Shards that fail or are killed are submitted again, complete ones never. The same
command, given once more, watches jobs that are still in the queue, or does what is left. Ctrl-C
leaves Slurm's jobs running, and ends those of GNU parallel once they have saved what they have
done.")]
pub struct Args {
    #[command(subcommand)]
    engine: Engine,
}

#[derive(Debug, clap::Subcommand)]
enum Engine {
    /// An array job of Slurm, with a merge that depends on it
    Slurm {
        #[command(flatten)]
        common: Common,
        /// An option of sbatch for all jobs; repeatable
        #[arg(long, value_name = "OPTION", allow_hyphen_values = true)]
        option: Vec<String>,
        /// Submit and return, without waiting for the end
        #[arg(long)]
        detach: bool,
    },
    /// Tasks of GNU parallel
    Parallel {
        #[command(flatten)]
        common: Common,
        /// Tasks at a time [default: as many as there are cores]
        #[arg(long, value_name = "N", value_parser = within::<u32>(1, 1_000_000))]
        jobs: Option<u32>,
    },
}

/// What all engines need.
#[derive(Debug, clap::Args)]
struct Common {
    /// Number of shards
    #[arg(long, value_name = "N", default_value_t = 40, value_parser = within::<u64>(1, 1_000_000))]
    shards: u64,
    /// How often shards that fail are submitted again
    #[arg(long, value_name = "N", default_value_t = 2, value_parser = within::<u32>(0, 1000))]
    retries: u32,
    /// Print the script and submit nothing
    #[arg(long)]
    dry_run: bool,
    /// The command, after --
    #[arg(last = true, required = true, value_name = "COMMAND")]
    command: Vec<String>,
}

impl Common {
    /// The command as a job.
    fn job(&self) -> anyhow::Result<Job> {
        let (arguments, out) = without_out(&self.command)?;
        let name = arguments.first().cloned().unwrap_or_default();
        let out = out.unwrap_or_else(|| Path::new("out").join(&name));
        let out = std::path::absolute(&out).with_context(|| out.display().to_string())?;
        let program = program_of(&name)?;
        let job = Job { program, arguments, out, shards: self.shards };
        check(&job)?;
        Ok(job)
    }
}

/// Splits off the folder.
fn without_out(command: &[String]) -> anyhow::Result<(Vec<String>, Option<PathBuf>)> {
    let (mut arguments, mut out) = (Vec::new(), None);
    let mut words = command.iter();
    while let Some(word) = words.next() {
        match word.strip_prefix("--out") {
            Some("") => out = Some(words.next().context("--out needs a folder")?.into()),
            Some(folder) if folder.starts_with('=') => out = Some(folder[1..].into()),
            _ => arguments.push(word.clone()),
        }
    }
    Ok((arguments, out))
}

/// Refuses a command that its tasks would refuse.
fn check(job: &Job) -> anyhow::Result<()> {
    let ours = is_ours(job.arguments.first().map_or("", String::as_str));
    let divides = if ours { divides::<Cli>(job) } else { divides::<Trainer>(job) };
    match divides {
        Ok(true) => Ok(()),
        Ok(false) => bail!(
            "`{}` cannot be divided into shards: torture, endure, robust, tune-pid, reproduce and sweep can",
            job.arguments[0]
        ),
        Err(error) => {
            let text = error.to_string();
            let reason = text.lines().next().unwrap_or_default().trim_start_matches("error: ").to_owned();
            bail!("the command after -- cannot be divided into shards: {reason}")
        }
    }
}

/// Whether a command of a program runs as a shard if it is asked to.
fn divides<P: Program>(job: &Job) -> Result<bool, clap::Error> {
    let (name, out) = (P::command().get_name().to_owned(), job.out.to_string_lossy().into_owned());
    let words = [name].into_iter().chain(job.arguments.iter().cloned());
    let shard = ["--shard", "0/1", "--out", &out].map(str::to_owned);
    Ok(P::try_parse_from(words.chain(shard))?.chosen().output().makes == Makes::Shard)
}

impl Command for Args {
    type Outcome = ();

    fn run(&self, context: &Context<'_>) -> anyhow::Result<Option<()>> {
        match &self.engine {
            Engine::Slurm { common, option, detach } => {
                let slurm = Slurm { options: option.clone(), retries: common.retries };
                submit_to_slurm(&slurm, &common.job()?, common.dry_run, *detach, context)?;
            }
            Engine::Parallel { common, jobs } => {
                let (parallel, job) = (Parallel { jobs: *jobs, retries: common.retries }, common.job()?);
                if common.dry_run {
                    print!("{}", parallel.script(&job));
                    return Ok(None);
                }
                let merged = context.progress(|progress| parallel.run(&job, progress));
                if !shown(&job, merged)? {
                    println!("stopped; the same command continues with the shards that are not complete");
                }
            }
        }
        Ok(None)
    }
}

fn submit_to_slurm(
    slurm: &Slurm,
    job: &Job,
    dry_run: bool,
    detach: bool,
    context: &Context<'_>,
) -> anyhow::Result<()> {
    if dry_run {
        let shards: Vec<u64> = (0..job.shards).collect();
        print!("# the array\n{}\n# after it\n{}", slurm.array_script(job, &shards), slurm.merge_script(job));
        return Ok(());
    }
    if detach {
        tell(job, &slurm.submit(job)?);
        return Ok(());
    }
    let mut last = None;
    let merged = context.progress(|progress| {
        slurm.run(job, progress, &mut |jobs| {
            tell(job, jobs);
            last = Some(jobs.clone());
        })
    });
    if shown(job, merged)? {
        return Ok(());
    }
    if let Some(Submitted { array, merge }) = last {
        let array = array.unwrap_or_default();
        println!(
            "Slurm's jobs go on, and the same command watches them; to end them: scancel {array} {merge}"
        );
    }
    Ok(())
}

fn tell(job: &Job, jobs: &Submitted) {
    let (merge, log) = (&jobs.merge, job.log());
    match &jobs.array {
        None => println!("all shards are complete; the merge is job {merge}"),
        Some(array) => {
            println!("array job {array}, then the merge, job {merge}; they print into {}", log.display());
        }
    }
}

/// Shows what the merge has printed, whether it has succeeded or not; false if it was stopped before.
fn shown(job: &Job, merged: Result<bool, SubmitError>) -> anyhow::Result<bool> {
    if matches!(merged, Ok(true) | Err(SubmitError::Merge { .. })) {
        let log = job.merge_log();
        print!("{}", std::fs::read_to_string(&log).with_context(|| log.display().to_string())?);
    }
    Ok(merged?)
}
