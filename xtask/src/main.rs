//! Build and check automation: `cargo xtask <command>`, from anywhere in the repository.
#![forbid(unsafe_code)]

mod checksum;
mod ci;
mod cost;
mod faults;
mod firmware;
mod memory;
mod mutants;
mod npm;
mod package;
mod papers;
mod pip;
mod python;
mod qemu_test;
mod release;
mod setup;
mod trainer;
mod web;
mod web_demo;

use std::path::Path;
use std::process::ExitCode;

use anyhow::{Context, Result};
use clap::{Parser, Subcommand};
use xshell::Shell;

/// The chip's instruction set: Cortex-M4 with a hardware unit for f32.
const CHIP_TARGET: &str = "thumbv7em-none-eabihf";
/// What the demonstration in a browser is compiled for.
const WEB_TARGET: &str = "wasm32-unknown-unknown";
/// The profile of the chip's programs, and of tests that need the same optimisation.
const CHIP_PROFILE: &str = "chip";

/// Build and check automation of Eupnea.
#[derive(Parser)]
#[command(name = "cargo xtask")]
struct Arguments {
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    /// Prepare the toolchain to build for the chip, and install QEMU, node and Chromium; skips what is present
    Setup(setup::Arguments),
    /// Build the firmware's images and show how much flash and RAM they use
    Firmware,
    /// Run all tests of the real image in QEMU
    QemuTest {
        /// Run only tests whose names contain one of these texts
        filters: Vec<String>,
    },
    /// Count the instructions of the control tick in QEMU and compare them with the ceilings
    Cost(cost::Arguments),
    /// Check SAFETY.md's claims: run the fault matrix, breaths without a fault, and a torture test
    Faults,
    /// Prove that every safety monitor and response is needed: without it the fault matrix must fail
    MutateMonitors,
    /// Mutate the core and check that its tests detect each mutant
    Mutants(mutants::Arguments),
    /// Run the Python examples, with a plant written in Python
    Python,
    /// Build the Python package's wheel and install it, then lint and test it and run its notebook
    Package,
    /// Build what users install, from a tagged revision, into target/artifacts: wheels, archives, packages, firmware
    Release(release::Arguments),
    /// Check the bedside page, that its bundle is what the sources give, and test it in Chromium
    Web(web::Arguments),
    /// Write the trace matrix, the test report and the lists of third-party software to target/papers
    Papers,
    /// Run every check that a change must pass
    Ci(ci::Arguments),
}

fn main() -> ExitCode {
    match run(&Arguments::parse()) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            // Without a backtrace, which would hide the command that repeats the step.
            eprintln!("error: {error:#}");
            ExitCode::FAILURE
        }
    }
}

fn run(arguments: &Arguments) -> Result<()> {
    let shell = Shell::new()?;
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).parent().context("xtask has no parent folder")?;
    shell.change_dir(root);
    match &arguments.command {
        Command::Setup(arguments) => setup::run(&shell, arguments),
        Command::Firmware => firmware::run(&shell),
        Command::QemuTest { filters } => qemu_test::run(&shell, filters),
        Command::Cost(arguments) => cost::run(&shell, arguments),
        Command::Faults => faults::faults(&shell),
        Command::MutateMonitors => faults::mutate_monitors(&shell),
        Command::Mutants(arguments) => mutants::run(&shell, arguments),
        Command::Python => python::run(&shell),
        Command::Package => package::run(&shell),
        Command::Release(arguments) => release::run(&shell, arguments),
        Command::Web(arguments) => web::run(&shell, arguments),
        Command::Papers => papers::run(&shell),
        Command::Ci(arguments) => ci::run(&shell, arguments),
    }
}
