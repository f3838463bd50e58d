//! Build and check automation: `cargo xtask <command>`, from anywhere in the repository.
#![forbid(unsafe_code)]

mod ci;
mod cost;
mod faults;
mod firmware;
mod memory;
mod python;
mod qemu_test;
mod setup;
mod trainer;

use std::path::Path;
use std::process::ExitCode;

use anyhow::{Context, Result};
use clap::{Parser, Subcommand};
use xshell::Shell;

/// The chip's instruction set: Cortex-M4 with a hardware unit for f32.
const CHIP_TARGET: &str = "thumbv7em-none-eabihf";
/// The profile of the chip's programs, and of tests that must see the same optimisation.
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
    /// Prepare the toolchain to build for the chip, and QEMU to run it; does nothing that is done
    Setup(setup::Arguments),
    /// Build the firmware's images and show how much flash and RAM they take
    Firmware,
    /// Run all tests on the real image in QEMU
    QemuTest {
        /// Run only tests whose names hold one of these words
        filters: Vec<String>,
    },
    /// Count the instructions of the control tick in QEMU and compare them with their ceilings
    Cost(cost::Arguments),
    /// Break things on the virtual bench, breathe without a fault, and torture: what SAFETY.md claims
    Faults,
    /// Prove every safety monitor: without it the fault matrix must fail
    MutateMonitors,
    /// Run the examples in Python, with a plant that exists in Python alone
    Python,
    /// Run every check that a change must pass
    Ci(ci::Arguments),
}

fn main() -> ExitCode {
    match run(&Arguments::parse()) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            // The chain of causes alone: a backtrace would push the command to repeat out of sight.
            eprintln!("error: {error:#}");
            ExitCode::FAILURE
        }
    }
}

fn run(arguments: &Arguments) -> Result<()> {
    let shell = Shell::new()?;
    let root =
        Path::new(env!("CARGO_MANIFEST_DIR")).parent().context("xtask lies in the root of the workspace")?;
    shell.change_dir(root);
    match &arguments.command {
        Command::Setup(arguments) => setup::run(&shell, arguments),
        Command::Firmware => firmware::run(&shell),
        Command::QemuTest { filters } => qemu_test::run(&shell, filters),
        Command::Cost(arguments) => cost::run(&shell, arguments),
        Command::Faults => faults::faults(&shell),
        Command::MutateMonitors => faults::mutate_monitors(&shell),
        Command::Python => python::run(&shell),
        Command::Ci(arguments) => ci::run(&shell, arguments),
    }
}
