//! `cargo xtask python`: runs the Python examples as a user would, on files that the trainer has just written and on a plant
//! written in Python.

use std::path::{Path, PathBuf};

use anyhow::{Result, bail};
use xshell::{Shell, cmd};

use crate::trainer::Trainer;

/// Folder of the examples.
const EXAMPLES: &str = "examples/python";
/// Imports of the examples, to check that their packages are installed.
const PACKAGES: &str =
    "import control, fmpy, mlflow, numpy, onnx, onnxruntime, pandas, pyarrow, safetensors, tensorboard";

/// Placeholder in command lines, and the plant that replaces it: the Python plant on a pipe.
const PLANT: (&str, &str) = ("PLANT", "pipe:python3 examples/python/plant.py");

/// Runs all examples.
pub fn run(shell: &Shell) -> Result<()> {
    let python = with_packages(shell)?;
    // The pipeline would reuse the results of an earlier run, and replaces none of its recordings.
    for earlier in ["run", "plant.parquet", "replay.parquet"] {
        shell.remove_path(format!("target/python/{earlier}"))?;
    }
    let trainer = Trainer::build(shell)?;
    pipeline_on_a_plant(&trainer)?;
    open_files(shell, &trainer, &python)?;
    repeat_margins(shell, &trainer, &python)?;
    run_networks(shell, &trainer, &python)?;
    run_fmu(shell, &trainer, &python)?;
    copy_runs(shell, &trainer, &python)
}

/// Python with the packages: the machine's own, or a virtual environment that is created here.
fn with_packages(shell: &Shell) -> Result<PathBuf> {
    let complete = |python: &Path| {
        let probe = cmd!(shell, "{python} -c {PACKAGES}").quiet().ignore_stdout().ignore_stderr();
        probe.run().is_ok()
    };
    ensure(shell)?;
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
    cmd!(shell, "python3 -m venv {environment}").quiet().run()?;
    cmd!(shell, "{python} -m pip install --quiet --requirement {EXAMPLES}/requirements.txt").quiet().run()?;
    if complete(&python) {
        Ok(python)
    } else {
        bail!("the packages are installed, but Python fails on: {PACKAGES}")
    }
}

/// Ensures that Python can create virtual environments.
pub fn ensure(shell: &Shell) -> Result<()> {
    if cmd!(shell, "python3 -c 'import ensurepip, venv'").quiet().ignore_stderr().run().is_err() {
        cmd!(shell, "bash .ci/setup/python-venv").quiet().run()?;
    }
    Ok(())
}

/// Tunes, collects, fits, trains and evaluates on the Python plant over a pipe, with the smallest useful sizes.
fn pipeline_on_a_plant(trainer: &Trainer<'_>) -> Result<()> {
    for line in [
        "tune-pid --plant PLANT --grid authors --breaths 1 --pips 20",
        "collect --plant PLANT --gains 2,30 --breaths 40 --out target/python/plant.parquet",
        "fit target/python/plant.parquet --epochs 200 --out target/python/plant.safetensors",
        "train --plant PLANT --gains 2,30 --rounds 1 --breaths 40 --epochs 200 --iterations 100 --out target/python/run",
        "evaluate --plant PLANT --controller target/python/run/controller.safetensors --breaths 1",
    ] {
        trainer.run(line, &[PLANT])?;
    }
    Ok(())
}

/// Opens the files of the pipeline in Python.
fn open_files(shell: &Shell, trainer: &Trainer<'_>, python: &Path) -> Result<()> {
    let controller = "target/python/run/controller.safetensors";
    let replay = format!("--controller {controller} --exploration none --breaths 12");
    trainer.run(&format!("collect --plant PLANT {replay} --out target/python/replay.parquet"), &[PLANT])?;
    trainer.run(&format!("export {controller} --out target/python/weights.bin"), &[])?;
    let folder = "target/python";
    cmd!(
        shell,
        "{python} {EXAMPLES}/files.py {folder}/replay.parquet {folder}/plant.safetensors {controller} {folder}/weights.bin"
    )
    .quiet()
    .run()?;
    Ok(())
}

/// Repeats the margins of a controller with python-control.
fn repeat_margins(shell: &Shell, trainer: &Trainer<'_>, python: &Path) -> Result<()> {
    let file = "target/python/margins.json";
    trainer.lab(&format!("margins --bench R20C20 --gains 3,30 --json {file}"), &[])?;
    cmd!(shell, "{python} {EXAMPLES}/margins.py {file}").quiet().run()?;
    Ok(())
}

/// Exports controllers and simulators, runs them in onnxruntime, and one controller as a policy.
fn run_networks(shell: &Shell, trainer: &Trainer<'_>, python: &Path) -> Result<()> {
    let folder = "target/python/onnx";
    shell.remove_path(folder)?;
    for line in [
        format!("collect --breaths 24 --out {folder}/fast.parquet"),
        format!("fit {folder}/fast.parquet --epochs 20 --out {folder}/state-space.safetensors"),
        format!(
            "fit target/python/plant.parquet --epochs 20 --architecture stitched --out {folder}/stitched.safetensors"
        ),
        format!("train-family --units 4 --iterations 2 --start-from adult --out {folder}/family"),
    ] {
        trainer.run(&line, &[])?;
    }
    let simulators = ["state-space", "stitched", "family/round-0/unit-0"];
    let mut sources: Vec<String> =
        simulators.iter().map(|name| format!("{folder}/{name}.safetensors")).collect();
    sources.extend(["adult", "target/python/run/controller.safetensors"].map(str::to_owned));
    let mut files = Vec::new();
    for (number, source) in sources.iter().enumerate() {
        let made = [format!("{folder}/{number}.onnx"), format!("{folder}/{number}.json")];
        trainer.run(&format!("export {source} --out {} --check {}", made[0], made[1]), &[])?;
        files.extend(made);
    }
    cmd!(shell, "{python} {EXAMPLES}/onnx_check.py {files...}").quiet().run()?;
    let policy = format!("pipe:{} {EXAMPLES}/policy.py --onnx {folder}/3.onnx", python.display());
    trainer.lab("evaluate --policy POLICY --pips 20 --breaths 2", &[("POLICY", &policy)])
}

/// Runs an FMU in fmpy and compares it with a recording.
fn run_fmu(shell: &Shell, trainer: &Trainer<'_>, python: &Path) -> Result<()> {
    let folder = "target/python/fmu";
    shell.remove_path(folder)?;
    let fmu = format!("{folder}/neonate.fmu");
    let recording = format!("{folder}/neonate.parquet");
    let bench = "--bench neonate-R100C2";
    trainer.run(&format!("export neonate --out {fmu} {bench}"), &[])?;
    trainer.run(
        &format!("collect --controller neonate --exploration none --breaths 10 {bench} --out {recording}"),
        &[],
    )?;
    cmd!(shell, "{python} {EXAMPLES}/fmu_check.py {fmu} {recording}").quiet().run()?;
    Ok(())
}

/// Copies runs into `MLflow` and `TensorBoard`, twice, and compares what these programs then have with the records.
fn copy_runs(shell: &Shell, trainer: &Trainer<'_>, python: &Path) -> Result<()> {
    let folder = "target/python/exports";
    // Runs of an earlier call would be there too.
    shell.remove_path(folder)?;
    trainer.lab(&format!("torture --breaths 60 --json {folder}/runs/torture.json"), &[])?;
    trainer.run(
        &format!(
            "train --rounds 1 --breaths 12 --epochs 5 --iterations 10 --batch 16 --out {folder}/runs/train"
        ),
        &[],
    )?;
    let (store, events) = (format!("{folder}/mlruns"), format!("{folder}/events"));
    let listed = format!("{folder}/runs.json");
    trainer.lab(&format!("runs {folder}/runs --json {listed}"), &[])?;
    for _ in 0..2 {
        cmd!(shell, "{python} {EXAMPLES}/runs.py {folder}/runs --mlflow {store} --tensorboard {events}")
            .quiet()
            .run()?;
    }
    cmd!(shell, "{python} {EXAMPLES}/runs_check.py {listed} {store} {events}").quiet().run()?;
    Ok(())
}
