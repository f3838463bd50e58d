//! Wheels of the Python package that contain the programs too: `pip install` puts `trainer` and `lab` beside the interpreter.

use std::io::{BufRead as _, BufReader, Read as _, Write as _};
use std::net::TcpStream;
use std::path::{Path, PathBuf};
use std::process::{ChildStdout, Command, Stdio};

use anyhow::{Context, Result, ensure};
use xshell::{Shell, cmd};

use super::programs::{self, Processor, Target, only_file};
use super::{Release, VERSION};
use crate::firmware::cargo_folder;
use crate::trainer::Trainer;

/// Builds a wheel for each processor.
pub fn build(release: &Release<'_>) -> Result<()> {
    let shell = release.shell;
    for target in Processor::ALL.map(Target::Glibc) {
        let programs = programs::build(shell, target)?;
        let staging = release.staging("wheel")?;
        let wheel = programs::wheel(shell, target, &staging)?;
        let _tools = programs::tools(shell)?;
        with_programs(shell, Path::new("python"), &wheel, &programs, &release.folder)?;
    }
    Ok(())
}

/// Builds a wheel in the profile of the host's tests, whose crates are there already: that of a release would need minutes more. The
/// interpreter gets the packages that it needs for this.
pub fn for_tests(shell: &Shell, python: &Path) -> Result<PathBuf> {
    let trainer = Trainer::build(shell)?;
    let staging = cargo_folder(shell).join("staging/wheel-for-tests");
    shell.remove_path(&staging)?;
    cmd!(shell, "{python} -m pip install --quiet maturin wheel").quiet().run()?;
    let built = staging.join("native");
    cmd!(shell, "{python} -m maturin build --profile dev --manifest-path python/Cargo.toml --out {built}")
        .quiet()
        .run()?;
    let folder = shell.create_dir(staging.join("programs"))?;
    let mut programs = Vec::new();
    for file in Target::Glibc(Processor::X86).files() {
        let program = folder.join(file);
        // Cargo puts what a test depends on into a folder of its own.
        let places =
            [file.to_string(), format!("deps/{file}")].map(|place| trainer.program().with_file_name(place));
        let built =
            places.iter().find(|place| place.exists()).with_context(|| format!("{file} is not built"))?;
        shell.copy_file(built, &program)?;
        cmd!(shell, "strip {program}").quiet().run()?;
        programs.push(program);
    }
    let wheel = only_file(shell, &built)?;
    with_programs(shell, python, &wheel, &programs, &staging.join("complete"))
}

/// Adds programs to a wheel and writes it to another folder; returns its path.
fn with_programs(
    shell: &Shell,
    python: &Path,
    wheel: &Path,
    programs: &[PathBuf],
    out: &Path,
) -> Result<PathBuf> {
    let open = wheel.with_extension("open");
    cmd!(shell, "{python} -m wheel unpack --dest {open} {wheel}").quiet().ignore_stdout().run()?;
    let content = open.join(format!("eupnea-{VERSION}"));
    // Pip copies what is in this folder to that of the interpreter's programs, and makes it executable.
    let scripts = shell.create_dir(content.join(format!("eupnea-{VERSION}.data/scripts")))?;
    for program in programs {
        shell.copy_file(program, &scripts)?;
    }
    shell.create_dir(out)?;
    cmd!(shell, "{python} -m wheel pack --dest-dir {out} {content}").quiet().ignore_stdout().run()?;
    Ok(out.join(wheel.file_name().context("a wheel has a name")?))
}

/// A whole job in seconds: recording, simulator, controller, weights image, breaths.
pub const JOB: [&str; 5] = [
    "collect --breaths 6 --seed 3 --out recording.parquet",
    "fit recording.parquet --out simulator.safetensors --epochs 2",
    "train --out run --simulator simulator.safetensors --gains 6.5,265,0.13 --iterations 20",
    "export run/controller.safetensors --out weights.bin",
    "evaluate --controller run/controller.safetensors --bench R20C20 --pips 20 --breaths 1 --json breaths.json",
];

/// Tries what a wheel promises, in the environment of this interpreter and an empty folder: the package is imported, the programs
/// start, a whole job ends, an FMU is written, and the page is served.
pub fn try_programs(shell: &Shell, python: &Path) -> Result<()> {
    let programs = python.with_file_name("");
    let trainer = programs.join("trainer");
    let folder = tempfile::tempdir()?;
    let _folder = shell.push_dir(folder.path());
    let first = "import eupnea; eupnea.Bench()";
    cmd!(shell, "{python} -c {first}").quiet().run()?;
    for program in ["trainer", "lab"] {
        cmd!(shell, "{programs}/{program} --version").quiet().run()?;
    }
    for line in JOB.into_iter().chain(["export run/controller.safetensors --out controller.fmu"]) {
        let words = line.split(' ');
        cmd!(shell, "{trainer} {words...}").quiet().ignore_stdout().run()?;
    }
    serves(&trainer)
}

/// Starts the bedside page with its demonstration and loads it.
fn serves(trainer: &Path) -> Result<()> {
    let mut server = Command::new(trainer)
        .args(["serve", "--demo", "--listen", "127.0.0.1:0"])
        .stdout(Stdio::piped())
        .stderr(Stdio::null())
        .spawn()?;
    let page = server.stdout.take().context("no pipe").and_then(load);
    server.kill()?;
    server.wait()?;
    let page = page?;
    ensure!(page.contains("200 OK") && page.contains("<html"), "the page is not served: {page}");
    Ok(())
}

/// Loads the page whose address a server prints first.
fn load(output: ChildStdout) -> Result<String> {
    let mut line = String::new();
    BufReader::new(output).read_line(&mut line)?;
    let address = line.trim().strip_prefix("http://").and_then(|rest| rest.split('/').next());
    let address = address.with_context(|| format!("the server's first line is no address: {line}"))?;
    let mut stream = TcpStream::connect(address)?;
    write!(stream, "GET / HTTP/1.1\r\nHost: {address}\r\nConnection: close\r\n\r\n")?;
    let mut page = String::new();
    stream.read_to_string(&mut page)?;
    Ok(page)
}
