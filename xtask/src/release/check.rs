//! `cargo xtask release --check`: starts what was built as a user would, on emulated machines where it is for another one, and
//! compares the results of all machines.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::time::Instant;

use anyhow::{Context, Result, ensure};
use firmware_file::dfuse::{Element, decode};
use firmware_file::signer;
use xshell::{PushEnv, Shell, cmd};

use super::programs::{self, Processor, Target};
use super::wheels::{JOB, try_programs};
use super::{Part, SIGNATURE, SUMS, VERSION, emulated};
use crate::firmware::{BOARDS, MAIN_BOARD, cargo_folder};
use crate::pip::install;

/// The C library of arm64, for programs that are linked to it.
const ARM_LIBRARIES: &str = "/usr/aarch64-linux-gnu";
/// Files of the job that hold results alone, and no origin; whether they are the same on Windows too. Its C library rounds powers and
/// exponentials otherwise than glibc, so what is trained there differs in the last digits.
const RESULTS: [(&str, bool); 3] =
    [("simulator.safetensors", true), ("weights.bin", false), ("breaths.json", false)];

/// Name of the machine with another C library.
const WINDOWS: &str = "Windows";

/// Programs that are unpacked, and how this machine starts them.
struct Machine {
    name: &'static str,
    folder: PathBuf,
    /// Ending of the programs' names.
    suffix: &'static str,
    runner: &'static [&'static str],
}

/// Checks the chosen parts.
pub fn run(shell: &Shell, folder: &Path, chosen: &dyn Fn(Part) -> bool) -> Result<()> {
    cmd!(shell, "bash .ci/setup/release").quiet().run()?;
    let place = cargo_folder(shell).join("staging/check");
    shell.remove_path(&place)?;
    shell.create_dir(&place)?;
    let _wine = wine(shell, &place)?;
    checksums(shell, folder)?;
    let mut machines = Vec::new();
    if chosen(Part::Wheels) {
        machines.extend(wheels(shell, folder, &place)?);
    }
    if chosen(Part::Archives) {
        machines.extend(archives(shell, folder, &place)?);
        compiles_for_macos(shell)?;
    }
    if chosen(Part::Packages) {
        packages(shell, folder, &place)?;
    }
    if chosen(Part::Windows) {
        machines.push(windows(shell, folder, &place)?);
    }
    if chosen(Part::Firmware) {
        let trainer = machines.first().map(|machine| machine.folder.join("trainer"));
        boards(shell, folder, &place, trainer.as_deref())?;
    }
    same_results(shell, &place, &machines)?;
    if chosen(Part::Wheels) {
        golden(shell)?;
    }
    println!("release: checked");
    Ok(())
}

/// Variables with which Wine is silent about itself, keeps its files here and finds the library that it lacks.
fn wine<'a>(shell: &'a Shell, place: &Path) -> Result<[PushEnv<'a>; 3]> {
    let _tools = programs::tools(shell)?;
    let library = place.join("bcryptprimitives.dll");
    let source = "xtask/src/release/wine/bcryptprimitives.c";
    cmd!(shell, "python3 -m ziglang cc -target x86_64-windows-gnu -shared -o {library} {source} -ladvapi32")
        .quiet()
        .run()?;
    Ok([
        shell.push_env("WINEDEBUG", "-all"),
        shell.push_env("WINEPREFIX", cargo_folder(shell).join("wine")),
        shell.push_env("WINEPATH", place),
    ])
}

/// Every file has its checksum, and the list of checksums its signature.
fn checksums(shell: &Shell, folder: &Path) -> Result<()> {
    let _folder = shell.push_dir(folder);
    let sums = shell.read_file(SUMS).context("no release to check: build one with `cargo xtask release`")?;
    cmd!(shell, "sha256sum --check --quiet --strict {SUMS}").quiet().run()?;
    let signature = shell.read_file(SIGNATURE)?;
    let signer = signer(sums.as_bytes(), signature.as_bytes());
    let signer = signer.with_context(|| format!("{SIGNATURE} is no signature of {SUMS}"))?;
    println!("checksums: signed by {signer}");
    Ok(())
}

/// Installs the wheel of this processor in an environment of its own and tries all that it promises; unpacks the other one.
fn wheels(shell: &Shell, folder: &Path, place: &Path) -> Result<[Machine; 2]> {
    let wheel = |processor: Processor| {
        folder.join(format!("eupnea-{VERSION}-cp310-abi3-manylinux_2_28_{}.whl", processor.name()))
    };
    let environment = place.join("environment");
    cmd!(shell, "python3 -m venv {environment}").quiet().run()?;
    let python = environment.join("bin/python");
    let begun = Instant::now();
    install(shell, &python, &wheel(Processor::X86), "")?;
    let demo = place.join("demo");
    cmd!(shell, "{environment}/bin/trainer demo --out {demo}").quiet().run()?;
    for file in ["report.html", "one-inspiration.svg"] {
        ensure!(demo.join(file).exists(), "the demo has written no {file}");
    }
    println!("wheel: from nothing to the table of the demo in {:.0} s", begun.elapsed().as_secs_f64());
    try_programs(shell, &python)?;
    let foreign = place.join("wheel-arm64");
    let packed = wheel(Processor::Arm);
    cmd!(shell, "{python} -m zipfile -e {packed} {foreign}").quiet().run()?;
    let programs = foreign.join(format!("eupnea-{VERSION}.data/scripts"));
    cmd!(shell, "chmod +x {programs}/trainer {programs}/lab").quiet().run()?;
    Ok([
        Machine { name: "x86-64, glibc", folder: environment.join("bin"), suffix: "", runner: &[] },
        Machine {
            name: "arm64, glibc",
            folder: programs,
            suffix: "",
            runner: &["qemu-aarch64", "-L", ARM_LIBRARIES],
        },
    ])
}

/// Unpacks the archives for Linux; their programs need no library.
fn archives(shell: &Shell, folder: &Path, place: &Path) -> Result<Vec<Machine>> {
    let mut machines = Vec::new();
    for (processor, name, runner) in [
        (Processor::X86, "x86-64, static", [].as_slice()),
        (Processor::Arm, "arm64, static", &["qemu-aarch64"]),
    ] {
        let archive = format!("eupnea-{VERSION}-{}-linux", processor.name());
        let packed = folder.join(format!("{archive}.tar.gz"));
        cmd!(shell, "tar -C {place} -xzf {packed}").quiet().run()?;
        machines.push(Machine { name, folder: place.join(archive), suffix: "", runner });
    }
    Ok(machines)
}

/// No machine here starts programs for macOS, so they are only compiled.
fn compiles_for_macos(shell: &Shell) -> Result<()> {
    let target = "aarch64-apple-darwin";
    cmd!(shell, "bash .ci/setup/target {target}").quiet().run()?;
    let _tools = programs::tools(shell)?;
    cmd!(shell, "cargo-zigbuild check --quiet --target {target} -p host -p lab -p fmu_library")
        .quiet()
        .run()?;
    println!("macOS: compiles");
    Ok(())
}

/// Lints the packages, and starts the programs of the one for this processor from where it puts them.
fn packages(shell: &Shell, folder: &Path, place: &Path) -> Result<()> {
    for processor in Processor::ALL {
        let package = folder.join(format!("eupnea_{VERSION}_{}.deb", processor.debian()));
        cmd!(shell, "lintian --fail-on error,warning --allow-root {package}").quiet().run()?;
        let root = place.join(processor.debian());
        cmd!(shell, "dpkg-deb --extract {package} {root}").quiet().run()?;
    }
    let programs = place.join(Processor::X86.debian()).join("usr/bin");
    for program in ["trainer", "lab"] {
        says_version(&cmd!(shell, "{programs}/{program} --version").quiet().read()?, program)?;
    }
    Ok(())
}

/// Unpacks the archive for Windows, and asks for a port that does not exist.
fn windows(shell: &Shell, folder: &Path, place: &Path) -> Result<Machine> {
    let packed = folder.join(format!("eupnea-{VERSION}-x86_64-windows.zip"));
    let programs = place.join("windows");
    cmd!(shell, "python3 -m zipfile -e {packed} {programs}").quiet().run()?;
    let machine = Machine { name: WINDOWS, folder: programs, suffix: ".exe", runner: &["wine"] };
    let output = machine.start(shell, "trainer", "identify --port COM99")?.ignore_status().output()?;
    let message = String::from_utf8_lossy(&output.stderr).into_owned();
    ensure!(
        !output.status.success() && message.contains("COM99"),
        "a port that does not exist is not named: {message}"
    );
    Ok(machine)
}

/// Every board's file is whole, signed with the key of the checksums, and says the same in all its forms. The main board's starts.
fn boards(shell: &Shell, folder: &Path, place: &Path, trainer: Option<&Path>) -> Result<()> {
    let (sums, signature) = (shell.read_file(folder.join(SUMS))?, shell.read_file(folder.join(SIGNATURE))?);
    let key = signer(sums.as_bytes(), signature.as_bytes()).context("the checksums are unsigned")?;
    for board in &BOARDS {
        let path = folder.join(format!("eupnea-{VERSION}-{}.zip", board.name));
        let package = firmware_file::read(&shell.read_binary_file(&path)?, &key)
            .with_context(|| path.display().to_string())?;
        ensure!(package.manifest.firmware.board == board.name, "{} is of another board", path.display());
        let parts: Vec<_> = package
            .parts()
            .map(|(part, data)| Element { address: part.address, data: data.to_vec() })
            .collect();
        let dfu = decode(&package.files[&format!("{}.dfu", board.name)])?;
        ensure!(dfu == parts, "the DFU file of {} has other parts", board.name);
        if let (Some(trainer), true) = (trainer, board.map == MAIN_BOARD) {
            emulated::check(shell, folder, place, &package, trainer)?;
        }
    }
    Ok(())
}

impl Machine {
    /// A command line of a program, split at spaces.
    fn start<'a>(&self, shell: &'a Shell, program: &str, line: &str) -> Result<xshell::Cmd<'a>> {
        let program = self.folder.join(format!("{program}{}", self.suffix));
        ensure!(program.exists(), "{} is missing", program.display());
        let mut words = self.runner.iter().map(PathBuf::from).chain([program]);
        let first = words.next().context("a program to start")?;
        Ok(shell.cmd(first).args(words).args(line.split(' ')).quiet())
    }
}

/// Runs the same job on all machines and compares the bytes of its results.
fn same_results(shell: &Shell, place: &Path, machines: &[Machine]) -> Result<()> {
    let mut all: Vec<(&str, BTreeMap<&str, Vec<u8>>)> = Vec::new();
    for machine in machines {
        println!("job: {}", machine.name);
        for program in ["trainer", "lab"] {
            says_version(&machine.start(shell, program, "--version")?.read()?, program)?;
        }
        let folder = place.join("job").join(machine.name.replace(", ", "-"));
        let _folder = shell.push_dir(shell.create_dir(folder)?);
        for line in JOB {
            machine.start(shell, "trainer", line)?.ignore_stdout().run()?;
        }
        machine.start(shell, "trainer", "judge recording.parquet")?.ignore_stdout().run()?;
        let results: Result<_, xshell::Error> =
            RESULTS.iter().map(|(file, _)| Ok((*file, shell.read_binary_file(file)?))).collect();
        all.push((machine.name, results?));
    }
    let Some((first, others)) = all.split_first() else { return Ok(()) };
    for (file, on_windows) in RESULTS {
        let compared = others.iter().filter(|(name, _)| on_windows || *name != WINDOWS);
        let different: Vec<_> =
            compared.filter(|other| other.1[file] != first.1[file]).map(|other| other.0).collect();
        ensure!(different.is_empty(), "{file} differs from that of {} on: {}", first.0, different.join("; "));
        println!("{file}: the same bytes{}", if on_windows { "" } else { ", Windows aside" });
    }
    Ok(())
}

/// Runs the golden traces of the core on the other machines.
fn golden(shell: &Shell) -> Result<()> {
    let _tools = programs::tools(shell)?;
    for (target, variable, runner) in [
        (
            Target::Glibc(Processor::Arm),
            "CARGO_TARGET_AARCH64_UNKNOWN_LINUX_GNU_RUNNER",
            "qemu-aarch64 -L /usr/aarch64-linux-gnu",
        ),
        (Target::Windows, "CARGO_TARGET_X86_64_PC_WINDOWS_GNU_RUNNER", "wine"),
    ] {
        let triple = target.triple();
        println!("golden traces: {triple}");
        cmd!(shell, "cargo-zigbuild test --quiet --target {triple} -p tests --no-default-features --test golden -- golden")
            .env(variable, runner)
            .quiet()
            .run()?;
    }
    Ok(())
}

fn says_version(text: &str, program: &str) -> Result<()> {
    ensure!(text.trim() == format!("{program} {VERSION}"), "`{program} --version` says: {text}");
    Ok(())
}
