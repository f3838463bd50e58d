//! `cargo xtask ci`: every check that a change must pass, as one table of cargo commands.
//!
//! The first failing step ends the run and names the command that repeats it.

use std::time::{Duration, Instant};

use anyhow::{Result, bail};
use clap::builder::PossibleValuesParser;
use xshell::{Shell, cmd};

use crate::CHIP_TARGET;

/// One check.
struct Step {
    name: &'static str,
    environment: Option<(&'static str, &'static str)>,
    cargo: &'static [&'static str],
}

/// Cheap checks first, so that a slip is told early.
const STEPS: &[Step] = &[
    step("format", &["fmt", "--all", "--check"]),
    step("clippy", &["clippy", "--all-targets", "--features", "tests/board", "--", "-D", "warnings"]),
    step("test", &["test", "--workspace", "--exclude", "firmware"]),
    step("python", &["xtask", "python"]),
    // The test step ran them in debug; an optimiser that changed a bit of a command would show here.
    step("golden", &["test", "--release", "-p", "tests", "golden"]),
    step("faults", &["xtask", "faults"]),
    step("monitors", &["xtask", "mutate-monitors"]),
    step("frames", &["test", "--release", "-p", "tests", "--test", "fuzz", "--", "--ignored"]),
    Step {
        environment: Some(("RUSTDOCFLAGS", "-D warnings")),
        ..step("doc", &["doc", "--no-deps", "--document-private-items"])
    },
    step("setup", &["xtask", "setup"]),
    step("clippy-board", &chip_clippy("firmware", "stm32f405")),
    step("clippy-hil", &chip_clippy("firmware", "stm32f405,hil,cost")),
    step("clippy-f446", &chip_clippy("firmware", "stm32f446")),
    step("clippy-shim", &chip_clippy("shim", "")),
    step("firmware", &["xtask", "firmware"]),
    step("qemu-test", &["xtask", "qemu-test"]),
    step("cost", &["xtask", "cost"]),
];

/// The lints of a package for the chip, with these features.
const fn chip_clippy(package: &'static str, features: &'static str) -> [&'static str; 14] {
    [
        "clippy",
        "--release",
        "-p",
        package,
        "--no-default-features",
        "--features",
        features,
        "--bins",
        "--examples",
        "--target",
        CHIP_TARGET,
        "--",
        "-D",
        "warnings",
    ]
}

const fn step(name: &'static str, cargo: &'static [&'static str]) -> Step {
    Step { name, environment: None, cargo }
}

impl Step {
    /// The command as one would type it.
    fn command_line(&self) -> String {
        let environment =
            self.environment.map(|(name, value)| format!("{name}='{value}' ")).unwrap_or_default();
        format!("{environment}cargo {}", self.cargo.join(" "))
    }

    fn run(&self, shell: &Shell) -> Result<(), xshell::Error> {
        let cargo = self.cargo;
        cmd!(shell, "cargo {cargo...}").envs(self.environment).quiet().run()
    }
}

/// Arguments of `cargo xtask ci`.
#[derive(clap::Args)]
pub struct Arguments {
    /// Run only these steps
    #[arg(long, value_name = "STEP", value_parser = PossibleValuesParser::new(STEPS.iter().map(|step| step.name)))]
    only: Vec<String>,
}

/// Runs all steps, or those asked for, in the table's order.
pub fn run(shell: &Shell, arguments: &Arguments) -> Result<()> {
    let mut times = Vec::new();
    for step in STEPS {
        if !arguments.only.is_empty() && !arguments.only.iter().any(|name| name == step.name) {
            continue;
        }
        println!("\n=== {}: {}", step.name, step.command_line());
        let start = Instant::now();
        let result = step.run(shell);
        times.push((step.name, start.elapsed()));
        if result.is_err() {
            print!("{}", summary(&times));
            bail!("step `{}` failed; repeat it with: {}", step.name, step.command_line());
        }
    }
    print!("{}", summary(&times));
    println!("all {} steps passed", times.len());
    Ok(())
}

/// A line per step and their sum.
fn summary(times: &[(&str, Duration)]) -> String {
    let total = ("total", times.iter().map(|(_, time)| time).sum());
    let line = |(name, time): &(&str, Duration)| format!("{name:<12} {:>7.1} s\n", time.as_secs_f64());
    let lines: String = times.iter().chain([&total]).map(line).collect();
    format!("\n=== summary\n{lines}")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_step_can_be_repeated_from_its_command_line() {
        let doc = STEPS.iter().find(|step| step.name == "doc").unwrap();
        assert_eq!(
            doc.command_line(),
            "RUSTDOCFLAGS='-D warnings' cargo doc --no-deps --document-private-items"
        );
    }

    #[test]
    fn the_summary_adds_up() {
        let text = summary(&[("format", Duration::from_millis(1500)), ("test", Duration::from_secs(62))]);
        assert_eq!(
            text,
            "\n=== summary\nformat           1.5 s\ntest            62.0 s\ntotal           63.5 s\n"
        );
    }

    #[test]
    fn no_two_steps_share_a_name() {
        let mut names: Vec<_> = STEPS.iter().map(|step| step.name).collect();
        names.sort_unstable();
        names.dedup();
        assert_eq!(names.len(), STEPS.len());
    }
}
