//! `cargo xtask setup`: prepares the toolchain to build for the chip, and installs QEMU for the virtual board, the engines for the
//! tests of sharded commands, the compilers for those of the C export, cargo-deny for the papers, and for the bedside page node, Chromium
//! and the target of its demonstration.
//!
//! Scripts in `.ci/setup` do this, since they change the machine and not the project.

use anyhow::Result;
use xshell::{Shell, cmd};

use crate::{CHIP_TARGET, WEB_TARGET, mutants};

/// Arguments of `cargo xtask setup`.
#[derive(clap::Args)]
pub struct Arguments {
    /// Omit QEMU, the engines, the compilers, cargo-deny, node, Chromium and the target of the demonstration, which building the firmware does not need
    #[arg(long)]
    target_only: bool,
    /// Install cargo-mutants too, for `cargo xtask mutants`
    #[arg(long)]
    mutants: bool,
}

/// Installs the missing parts.
pub fn run(shell: &Shell, arguments: &Arguments) -> Result<()> {
    cmd!(shell, "bash .ci/setup/target {CHIP_TARGET}").quiet().run()?;
    if !arguments.target_only {
        cmd!(shell, "bash .ci/setup/target {WEB_TARGET}").quiet().run()?;
        for tool in ["qemu", "engines", "compilers", "deny", "node", "chromium"] {
            cmd!(shell, "bash .ci/setup/{tool}").quiet().run()?;
        }
    }
    if arguments.mutants {
        mutants::install(shell)?;
    }
    Ok(())
}

#[cfg(all(test, unix))]
mod tests {
    use super::*;

    /// Runs a function of the scripts on an input; returns its output.
    fn filtered(function: &str, input: &str) -> String {
        let shell = Shell::new().unwrap();
        shell.change_dir("..");
        let script = format!(". .ci/setup/debian.sh; {function}");
        cmd!(shell, "bash -euc {script}").stdin(input).quiet().read().unwrap()
    }

    #[test]
    fn the_mirror_is_taken_from_either_form_of_apts_files() {
        let modern =
            "Types: deb\n# http://old.example/debian\nURIs: http://mirror.example/debian\nSuites: stable\n";
        assert_eq!(filtered("mirror", modern), "http://mirror.example/debian");
        let classic = "deb [arch=amd64] https://mirror.example/debian/ stable main\n";
        assert_eq!(filtered("mirror", classic), "https://mirror.example/debian/");
    }

    #[test]
    fn archives_of_security_fixes_and_third_parties_are_no_mirror() {
        let others =
            "URIs: http://mirror.example/debian-security\ndeb https://tool.example/apt stable main\n";
        assert_eq!(filtered("mirror", others), "");
    }

    #[test]
    fn the_source_package_must_hold_the_toolchains_own_release() {
        let versions = "  rust-src | 1.96.0+dfsg1-1 | mirror sid/main\n  rust-src | 1.95.0+dfsg1-2 | mirror forky/main\n";
        assert_eq!(filtered("version_of_release 1.95.0", versions), "1.95.0+dfsg1-2");
        assert_eq!(filtered("version_of_release 1.9", versions), "");
    }

    #[test]
    fn the_suite_of_a_recent_version_is_taken_and_an_epoch_is_no_version() {
        let old =
            "qemu-system-arm | 1:7.2+dfsg-7 | http://mirror.example/debian bookworm/main amd64 Packages\n";
        let new = "qemu-system-arm | 1:10.0.2+ds-2~bpo12+1 | http://mirror.example/debian bookworm-backports/main amd64 Packages\n";
        assert_eq!(filtered("suite_from_version 10", &[old, new].concat()), "bookworm-backports");
        assert_eq!(filtered("suite_from_version 10", old), "");
    }
}
