//! `cargo xtask faults` and `cargo xtask mutate-monitors`: they check SAFETY.md's claims about the monitors.

use anyhow::{Context, Result};
use xshell::Shell;

use crate::trainer::Trainer;

/// Runs the fault matrix, ten thousand breaths without a fault, and a short torture test.
pub fn faults(shell: &Shell) -> Result<()> {
    let trainer = Trainer::build(shell)?;
    ["faults", "faults --nominal 10080", "torture --breaths 20000"]
        .iter()
        .try_for_each(|line| trainer.run(line, &[]))
}

/// Removes the monitors one by one and requires that a row of the fault matrix fails each time, which proves that each
/// monitor is needed.
pub fn mutate_monitors(shell: &Shell) -> Result<()> {
    Trainer::build(shell)?.run("faults --mutate", &[]).context(
        "a monitor can be removed without a failing row of the fault matrix; the table above shows which one",
    )
}
