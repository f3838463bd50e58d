//! `cargo xtask faults` and `cargo xtask mutate-monitors`: what SAFETY.md claims of the monitors.

use anyhow::{Context, Result};
use xshell::Shell;

use crate::trainer::Trainer;

/// The fault matrix, ten thousand breaths without a fault, and a short torture.
pub fn faults(shell: &Shell) -> Result<()> {
    let trainer = Trainer::build(shell)?;
    ["faults", "faults --nominal 10080", "torture --breaths 20000"]
        .iter()
        .try_for_each(|line| trainer.run(line, &[]))
}

/// Removes one monitor after the other and demands that a row of the fault matrix fails each time: a monitor counts only if
/// something fails without it.
pub fn mutate_monitors(shell: &Shell) -> Result<()> {
    Trainer::build(shell)?.run("faults --mutate", &[]).context(
        "a monitor can be removed without a row of the fault matrix failing; the table above tells which",
    )
}
