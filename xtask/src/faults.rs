//! `cargo xtask faults` and `cargo xtask mutate-monitors`: they check SAFETY.md's claims about the monitors.

use anyhow::{Context, Result};
use xshell::Shell;

use crate::papers::results::{self, EXPERIMENTS};
use crate::trainer::Trainer;

/// Runs the fault matrix, once also at the highest pressure limit, the test table and short torture tests, which leave their results
/// for the papers, and ten thousand breaths without a fault.
pub fn faults(shell: &Shell) -> Result<()> {
    let trainer = Trainer::build(shell)?;
    for experiment in EXPERIMENTS.iter().filter(|experiment| experiment.quick) {
        let file = experiment.file(&results::folder(shell)).display().to_string();
        trainer.lab(&format!("{} --json FILE", experiment.line), &[("FILE", &file)])?;
    }
    trainer.lab("faults --nominal 10080", &[])
}

/// Removes the monitors and responses one by one and requires that a row of the fault matrix fails each time, which proves
/// that each one is needed. The first such row ends a search.
pub fn mutate_monitors(shell: &Shell) -> Result<()> {
    Trainer::build(shell)?.lab("faults --mutate", &[]).context(
        "a monitor or a response can be removed without a failing row of the fault matrix; the table above shows which one",
    )
}
