//! `cargo xtask mutate-monitors`: a monitor counts only if something fails without it.

use anyhow::{Context, Result};
use xshell::{Shell, cmd};

/// Removes one monitor after the other and demands that a row of the fault matrix fails each time.
pub fn run(shell: &Shell) -> Result<()> {
    cmd!(shell, "cargo trainer faults --mutate").run().context(
        "a monitor can be removed without a row of the fault matrix failing; the table above tells which",
    )
}
