//! Runs the tests on a mutant.

use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::thread::sleep;
use std::time::{Duration, Instant};

use anyhow::{Context, Result, ensure};

use super::graft::VARIABLE;

/// Tests that take seconds: only what nothing else catches meets them.
const SLOW: [&str; 2] =
    ["a_cut_at_any_byte_leaves_the_old_or_the_new_weights", "every_flipped_bit_is_refused"];
/// Cases of a property test.
const CASES: &str = "16";
/// Shortest time after which a run counts as endless, and by how many times it must exceed that without a mutation.
const PATIENCE: Duration = Duration::from_secs(10);
const TIMES: u32 = 10;
/// Longest time of the tests without a mutation.
const BASELINE: Duration = Duration::from_mins(5);
/// Address space of a test program, KiB, so that a mutant without an end does not take the computer's memory.
const MEMORY: &str = "8000000";
/// Interval of the looks at a running program.
const LOOK: Duration = Duration::from_millis(5);

/// A program with tests.
pub struct Trial {
    program: PathBuf,
    folder: PathBuf,
    /// For the quick tests and for the slow ones.
    patience: [Duration; 2],
}

impl Trial {
    /// A program whose tests pass in a folder.
    pub fn new(program: PathBuf, folder: PathBuf) -> Result<Self> {
        let mut trial = Self { program, folder, patience: [BASELINE; 2] };
        for (tests, slow) in [(quick(), 0), (SLOW.to_vec(), 1)] {
            let begun = Instant::now();
            let pass = trial.pass(0, &tests, BASELINE)?;
            ensure!(pass, "the tests of shared fail without a mutation; run: cargo test --package shared");
            trial.patience[slow] = PATIENCE.max(TIMES * begun.elapsed());
        }
        Ok(trial)
    }

    /// Whether a test fails on a mutant, or does not end. The tests of its own module come first.
    pub fn catches(&self, mutant: u32, file: &str) -> Result<bool> {
        let (quick, module) = (quick(), module(file));
        let own: Vec<&str> = [module.as_str()].into_iter().chain(quick.iter().copied()).collect();
        let [patience, for_slow] = self.patience;
        let passes = self.pass(mutant, &own, patience)?
            && self.pass(mutant, &quick, patience)?
            && self.pass(mutant, &SLOW, for_slow)?;
        Ok(!passes)
    }

    /// Whether these tests pass in time.
    fn pass(&self, mutant: u32, arguments: &[&str], patience: Duration) -> Result<bool> {
        let mut command = Command::new("sh");
        command.args(["-c", "ulimit -v $0 && exec \"$@\"", MEMORY]).arg(&self.program).args(arguments);
        command.current_dir(&self.folder).stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::null());
        command.env(VARIABLE, mutant.to_string()).env("RUST_BACKTRACE", "0").env("RUST_TEST_THREADS", "1");
        command.env("PROPTEST_CASES", CASES).env("PROPTEST_MAX_SHRINK_ITERS", "0");
        command.env("PROPTEST_DISABLE_FAILURE_PERSISTENCE", "1");
        let mut running = command.spawn().context("cannot run the tests")?;
        let begun = Instant::now();
        loop {
            match running.try_wait()? {
                Some(status) => return Ok(status.success()),
                None if begun.elapsed() < patience => sleep(LOOK),
                None => {
                    running.kill()?;
                    running.wait()?;
                    return Ok(false);
                }
            }
        }
    }
}

/// Arguments that select all tests but [`SLOW`].
fn quick() -> Vec<&'static str> {
    SLOW.iter().flat_map(|test| ["--skip", test]).collect()
}

/// Path of a file's module, as it begins the names of its tests.
fn module(file: &str) -> String {
    let path = Path::new(file).strip_prefix("shared/src").unwrap_or(Path::new(file)).with_extension("");
    let path = if path.ends_with("mod") { path.parent().unwrap_or(&path) } else { &path };
    path.iter().flat_map(|part| [&*part.to_string_lossy(), "::"].map(str::to_owned)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_module_of_a_file_begins_the_names_of_its_tests() {
        assert_eq!(module("shared/src/safety/backup.rs"), "safety::backup::");
        assert_eq!(module("shared/src/control/mod.rs"), "control::");
        assert_eq!(module("shared/src/ventilator.rs"), "ventilator::");
    }

    /// A program for which the variable decides.
    fn trial(script: &str) -> (tempfile::TempDir, Trial) {
        use std::os::unix::fs::PermissionsExt;
        let folder = tempfile::tempdir().unwrap();
        let program = folder.path().join("tests");
        std::fs::write(&program, format!("#!/bin/sh\n{script}\n")).unwrap();
        std::fs::set_permissions(&program, std::fs::Permissions::from_mode(0o755)).unwrap();
        let trial = Trial::new(program, folder.path().to_owned()).unwrap();
        (folder, trial)
    }

    #[test]
    fn a_mutant_is_caught_by_a_failing_test_or_by_one_that_does_not_end() {
        let (_folder, trial) =
            trial(&format!("[ ${VARIABLE} = 3 ] && exec sleep 60; exit $((${VARIABLE} == 2))"));
        let hasty = Trial { patience: [Duration::from_millis(200); 2], ..trial };
        assert_eq!(
            [1, 2, 3].map(|mutant| hasty.catches(mutant, "shared/src/math.rs").unwrap()),
            [false, true, true]
        );
    }
}
