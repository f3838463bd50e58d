//! QEMU never outlives the process that started it, however that ends.
//!
//! A shell waits at a pipe whose other end this process holds. A line in it means that QEMU has ended; the end of the pipe
//! means that this process has, without having ended QEMU: then the shell does it.

use std::io::{self, Write};
use std::os::unix::process::CommandExt;
use std::process::{Child, Command, Stdio};

const SCRIPT: &str = r#"read line || kill -KILL "$1""#;

/// The shell.
#[derive(Debug)]
pub(super) struct Guardian {
    shell: Child,
}

impl Guardian {
    /// Guards a process.
    pub(super) fn of(process: &Child) -> io::Result<Self> {
        let shell = Command::new("sh")
            .args(["-c", SCRIPT, "guardian", &process.id().to_string()])
            .stdin(Stdio::piped())
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            // Ctrl-C must not reach it before it has done its work.
            .process_group(0)
            .spawn()?;
        Ok(Self { shell })
    }

    /// The process has ended and been waited for.
    pub(super) fn dismiss(&mut self) {
        if let Some(mut pipe) = self.shell.stdin.take() {
            // A shell that has ended needs no word.
            let _ = pipe.write_all(b"\n");
        }
        let _ = self.shell.wait();
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::os::unix::process::ExitStatusExt;

    fn sleeper() -> Child {
        Command::new("sleep").arg("1000").spawn().unwrap()
    }

    #[test]
    fn the_end_of_the_pipe_ends_the_process() {
        let mut process = sleeper();
        let mut guardian = Guardian::of(&process).unwrap();
        drop(guardian.shell.stdin.take());
        assert_eq!(process.wait().unwrap().signal(), Some(9));
        guardian.dismiss();
    }

    #[test]
    fn a_dismissed_guardian_does_nothing() {
        let mut process = sleeper();
        Guardian::of(&process).unwrap().dismiss();
        assert!(process.try_wait().unwrap().is_none(), "it still runs");
        process.kill().unwrap();
        process.wait().unwrap();
    }
}
