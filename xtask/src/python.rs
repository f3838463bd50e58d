//! `cargo xtask python`: the examples in Python as a user would run them, on files that the trainer has just written and on a
//! plant that exists in Python alone.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};
use xshell::{Shell, cmd};

/// Where the examples are.
const EXAMPLES: &str = "examples/python";
/// What the example for files needs, as one would import it.
const PACKAGES: &str = "import numpy, pandas, pyarrow, safetensors";

/// Runs both examples.
pub fn run(shell: &Shell) -> Result<()> {
    let python = with_packages(shell)?;
    // What an earlier run has left would be found and not made again.
    shell.remove_path("target/python/run")?;
    let trainer = Trainer::build(shell)?;
    pipeline_on_a_plant(&trainer)?;
    open_files(&trainer, &python)
}

/// Python with the packages: the machine's own, or a virtual environment that is made for it.
fn with_packages(shell: &Shell) -> Result<PathBuf> {
    let complete = |python: &Path| {
        let probe = cmd!(shell, "{python} -c {PACKAGES}").quiet().ignore_stdout().ignore_stderr();
        probe.run().is_ok()
    };
    let own = PathBuf::from("python3");
    if complete(&own) {
        return Ok(own);
    }
    let environment = shell.current_dir().join("target/python/venv");
    let python = environment.join("bin/python");
    if complete(&python) {
        return Ok(python);
    }
    println!("python packages: installing them into {}", environment.display());
    shell.remove_path(&environment)?;
    cmd!(shell, "python3 -m venv {environment}")
        .quiet()
        .run()
        .context("python3 with the module venv is needed (Debian: apt-get install python3-venv)")?;
    cmd!(shell, "{python} -m pip install --quiet --requirement {EXAMPLES}/requirements.txt").quiet().run()?;
    if complete(&python) {
        Ok(python)
    } else {
        bail!("pip installed packages that {PACKAGES:?} does not find")
    }
}

/// The trainer as the test step has built it: another selection of packages would build its dependencies anew.
struct Trainer<'a> {
    shell: &'a Shell,
    program: PathBuf,
}

impl<'a> Trainer<'a> {
    fn build(shell: &'a Shell) -> Result<Self> {
        let target =
            shell.var("CARGO_TARGET_DIR").map_or_else(|_| shell.current_dir().join("target"), PathBuf::from);
        cmd!(shell, "cargo test --quiet --workspace --exclude firmware --test command_line --no-run")
            .quiet()
            .run()?;
        Ok(Self { shell, program: target.join("debug/trainer") })
    }

    /// Runs a command line, in which PLANT stands for the plant in Python on a pipe.
    fn run(&self, line: &str) -> Result<()> {
        let (program, plant) = (&self.program, format!("pipe:python3 {EXAMPLES}/plant.py"));
        let arguments =
            line.split_whitespace().map(|word| if word == "PLANT" { plant.as_str() } else { word });
        Ok(cmd!(self.shell, "{program} {arguments...}").quiet().run()?)
    }
}

/// Tune, collect, fit, train and evaluate on the plant in Python, over a pipe; sizes are just large enough to run.
fn pipeline_on_a_plant(trainer: &Trainer<'_>) -> Result<()> {
    for line in [
        "tune-pid --plant PLANT --authors-grid --breaths 1 --pips 20",
        "collect --plant PLANT --gains 2,30 --breaths 40 --out target/python/plant.parquet",
        "fit --data target/python/plant.parquet --epochs 200 --out target/python/plant.safetensors",
        "train --plant PLANT --gains 2,30 --rounds 1 --breaths 40 --epochs 200 --iterations 100 --out target/python/run",
        "evaluate --plant PLANT --controller target/python/run/controller.safetensors --breaths 1",
    ] {
        trainer.run(line)?;
    }
    Ok(())
}

/// The files of the pipeline, opened in Python.
fn open_files(trainer: &Trainer<'_>, python: &Path) -> Result<()> {
    let controller = "target/python/run/controller.safetensors";
    let replay = format!("--controller {controller} --no-exploration --breaths 12");
    trainer.run(&format!("collect --plant PLANT {replay} --out target/python/replay.parquet"))?;
    trainer.run(&format!("pack {controller} --out target/python/weights.bin"))?;
    let (shell, folder) = (trainer.shell, "target/python");
    cmd!(
        shell,
        "{python} {EXAMPLES}/files.py {folder}/replay.parquet {folder}/plant.safetensors {controller} {folder}/weights.bin"
    )
    .quiet()
    .run()?;
    Ok(())
}
