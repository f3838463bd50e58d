//! Ensures that QEMU never outlives the process that started it, however that process ends.
//!
//! A shell starts QEMU and waits for it. In parallel it waits at a pipe whose other end only this process holds. The
//! pipe closes when this process ends or wants QEMU to end; then the shell kills QEMU. The pipe exists before QEMU, so
//! QEMU is never unguarded.

use std::fs::File;
use std::io::{self, PipeWriter, Write};
use std::net::TcpListener;
use std::os::fd::OwnedFd;
use std::os::unix::process::CommandExt;
use std::path::Path;
use std::process::{Child, Command, ExitStatus, Stdio};

use crate::processor;

/// Arguments: the log, the processor, the program, its arguments. The pipe is passed as standard error, because no other descriptor
/// number can be chosen. A line in it means that the program has already ended. Where the system has the commands, the program
/// stays on the processor, in batches: a thread that wakes does not interrupt the one that runs.
const SCRIPT: &str = r#"
log=$1
processor=$2
shift 2
if taskset -c "$processor" chrt --batch 0 true 2>/dev/null; then
  set -- taskset -c "$processor" chrt --batch 0 "$@"
fi
exec 3<&0
"$@" <&3 3<&- 2>"$log" &
program=$!
exec </dev/null >/dev/null 3<&-
{ read -r line || kill -KILL "$program"; } <&2 &
wait "$program"
"#;

/// A running program, its guard, and this process's end of the pipe.
#[derive(Debug)]
pub(super) struct Guarded {
    shell: Child,
    pipe: Option<PipeWriter>,
}

/// The environment of a guarded program.
#[derive(Debug)]
pub(super) struct Surroundings<'a> {
    /// Its working directory.
    pub(super) folder: &'a Path,
    /// File for its standard error; relative to the working directory, unless the path is absolute.
    pub(super) log: &'a Path,
    /// Its standard input.
    pub(super) input: Option<TcpListener>,
    /// Its standard output.
    pub(super) output: Option<TcpListener>,
}

impl Guarded {
    /// Starts a program with its arguments.
    pub(super) fn start(program: &Command, surroundings: Surroundings) -> io::Result<Self> {
        // Create the log first, so that it exists for any reader.
        File::create(surroundings.folder.join(surroundings.log))?;
        let (theirs, ours) = io::pipe()?;
        let port =
            |port: Option<TcpListener>| port.map_or_else(Stdio::null, |port| OwnedFd::from(port).into());
        let shell = Command::new("sh")
            .args(["-c", SCRIPT, "guardian"])
            .arg(surroundings.log)
            .arg(processor::next().to_string())
            .arg(program.get_program())
            .args(program.get_args())
            .current_dir(surroundings.folder)
            .stdin(port(surroundings.input))
            .stdout(port(surroundings.output))
            .stderr(theirs)
            // Ctrl-C is meant for the starting program, which may want to shut down in order.
            .process_group(0)
            .spawn()?;
        Ok(Self { shell, pipe: Some(ours) })
    }

    /// How the program ended; `None` while it runs. A terminating signal counts as 128 plus its number.
    pub(super) fn exit_status(&mut self) -> io::Result<Option<ExitStatus>> {
        let status = self.shell.try_wait()?;
        if status.is_some() {
            self.dismiss();
        }
        Ok(status)
    }

    /// Waits until the program ends by itself.
    pub(super) fn wait(&mut self) -> io::Result<ExitStatus> {
        let status = self.shell.wait()?;
        self.dismiss();
        Ok(status)
    }

    /// Releases the guard after the program has ended, so that it cannot kill a new process with the same id.
    fn dismiss(&mut self) {
        if let Some(mut pipe) = self.pipe.take() {
            // A guard that has ended needs no message.
            let _ = pipe.write_all(b"\n");
        }
    }

    /// Kills the program and waits until it has ended. Further calls have no effect.
    pub(super) fn kill(&mut self) {
        if let Ok(None) = self.exit_status() {
            drop(self.pipe.take());
        }
        // This fails only if there is nothing to wait for.
        let _ = self.shell.wait();
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::fs;

    /// Runs a shell script under guard.
    fn start(folder: &Path, script: &str) -> Guarded {
        let mut program = Command::new("sh");
        program.args(["-c", script]);
        let log = folder.join("log");
        Guarded::start(&program, Surroundings { folder, log: &log, input: None, output: None }).unwrap()
    }

    #[test]
    fn the_end_of_the_pipe_kills_the_program_at_whatever_instant() {
        for delay_ms in [0, 1, 3, 10, 100] {
            let folder = tempfile::tempdir().unwrap();
            let mut program = start(folder.path(), "exec sleep 1000");
            std::thread::sleep(std::time::Duration::from_millis(delay_ms));
            drop(program.pipe.take());
            assert_eq!(program.wait().unwrap().code(), Some(128 + 9));
        }
    }

    #[test]
    fn a_program_that_ends_by_itself_tells_how() {
        let folder = tempfile::tempdir().unwrap();
        let mut program = start(folder.path(), "echo reason >&2; exit 7");
        assert_eq!(program.wait().unwrap().code(), Some(7));
        assert_eq!(fs::read_to_string(folder.path().join("log")).unwrap(), "reason\n");
        program.kill();
        assert_eq!(program.exit_status().unwrap().and_then(|status| status.code()), Some(7));
    }

    #[test]
    fn a_running_program_is_left_alone() {
        let folder = tempfile::tempdir().unwrap();
        let mut program = start(folder.path(), "exec sleep 1000");
        std::thread::sleep(std::time::Duration::from_millis(50));
        assert!(program.exit_status().unwrap().is_none());
        program.kill();
    }
}
