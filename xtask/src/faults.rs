//! `cargo xtask faults` and `cargo xtask mutate-monitors`: they check SAFETY.md's claims about the monitors.

use anyhow::{Context, Result};
use xshell::Shell;

use crate::trainer::Trainer;

/// Runs the fault matrix, once also at the highest pressure limit, ten thousand breaths without a fault, and short torture
/// tests.
pub fn faults(shell: &Shell) -> Result<()> {
    let trainer = Trainer::build(shell)?;
    [
        "faults",
        "faults --limit 70 --seeds 1",
        "faults --nominal 10080",
        "torture --breaths 20000",
        "torture --breaths 2000 --limit 70",
    ]
    .iter()
    .try_for_each(|line| trainer.lab(line, &[]))
}

/// Removes the monitors and responses one by one and requires that a row of the fault matrix fails each time, which proves
/// that each one is needed. The first such row ends a search.
pub fn mutate_monitors(shell: &Shell) -> Result<()> {
    Trainer::build(shell)?.lab("faults --mutate", &[]).context(
        "a monitor or a response can be removed without a failing row of the fault matrix; the table above shows which one",
    )
}
