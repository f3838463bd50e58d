//! The plant line between shim and host: two pipes in the board's folder, and the thread that answers.
//!
//! Each message is a length (u16, little endian) and that number of bytes. Every request gets one answer; an empty one
//! means silence. The shim's first request is empty and reports that the shim has started; later empty ones let the host set
//! the pace of a board without a plant.

use std::fs::{self, File};
use std::io::{self, Read, Write};
use std::path::{Path, PathBuf};
use std::sync::mpsc::{Receiver, Sender, channel};
use std::thread::JoinHandle;
use std::time::Duration;

use nix::sys::stat::Mode;

use crate::lockstep::PlantEnd;

/// The thread that answers the board.
#[derive(Debug)]
pub(super) struct PlantThread {
    started: Receiver<()>,
    thread: Option<JoinHandle<()>>,
    /// Both pipes, held open until QEMU has opened them, so that neither side blocks while opening.
    held: Vec<File>,
}

impl PlantThread {
    /// Creates the pipes and starts to answer.
    pub(super) fn start(folder: &Path, plant: impl PlantEnd + Send + 'static) -> io::Result<Self> {
        let pipes = [shim::REQUEST_PIPE, shim::ANSWER_PIPE].map(|pipe| folder.join(name(pipe)));
        let held = pipes.iter().map(make).collect::<io::Result<_>>()?;
        let requests = File::open(&pipes[0])?;
        let answers = File::options().write(true).open(&pipes[1])?;
        let (sender, started) = channel();
        let thread = std::thread::Builder::new()
            .name("plant".into())
            // The line ends when QEMU does, which its owner reports.
            .spawn(move || drop(serve(requests, answers, plant, sender)))?;
        Ok(Self { started, thread: Some(thread), held })
    }

    /// Waits for the shim to start; false after `patience`.
    pub(super) fn started(&self, patience: Duration) -> bool {
        self.started.recv_timeout(patience).is_ok()
    }

    /// Releases the pipes: from now on the line ends when either side does.
    pub(super) fn release(&mut self) {
        self.held.clear();
    }

    /// Waits for the thread, after QEMU has ended.
    pub(super) fn end(&mut self) {
        self.release();
        if let Some(thread) = self.thread.take() {
            // A plant that panicked has already reported it.
            let _ = thread.join();
        }
    }
}

/// Creates a pipe in place of any leftover of an earlier board, and holds it open.
fn make(path: &PathBuf) -> io::Result<File> {
    match fs::remove_file(path) {
        Err(error) if error.kind() != io::ErrorKind::NotFound => return Err(error),
        _ => {}
    }
    nix::unistd::mkfifo(path, Mode::S_IRUSR | Mode::S_IWUSR)?;
    // Opened for both directions, so that this does not wait for the other end.
    File::options().read(true).write(true).open(path)
}

/// Answers until the line ends.
fn serve(
    mut requests: impl Read,
    mut answers: impl Write,
    mut plant: impl PlantEnd,
    started: Sender<()>,
) -> io::Result<()> {
    let mut started = Some(started);
    let mut frame = Vec::new();
    loop {
        let mut length = [0; 2];
        requests.read_exact(&mut length)?;
        let mut request = vec![0; u16::from_le_bytes(length).into()];
        requests.read_exact(&mut request)?;
        if let Some(started) = started.take() {
            // The receiver may have gone.
            let _ = started.send(());
        }
        let answer = plant.answer(&request);
        let length = u16::try_from(answer.len()).unwrap_or(u16::MAX);
        frame.clear();
        frame.extend(length.to_le_bytes());
        frame.extend(&answer[..length.into()]);
        answers.write_all(&frame)?;
    }
}

/// A file's name as the shim defines it.
pub(crate) fn name(name: &std::ffi::CStr) -> &Path {
    use std::os::unix::ffi::OsStrExt;
    Path::new(std::ffi::OsStr::from_bytes(name.to_bytes()))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Answers with the request, twice.
    struct Echo;

    impl PlantEnd for Echo {
        fn answer(&mut self, request: &[u8]) -> Vec<u8> {
            request.repeat(2)
        }
    }

    #[test]
    fn each_request_is_answered_in_a_frame() {
        let (sender, started) = channel();
        let mut answers = Vec::new();
        let requests: &[u8] = b"\x00\x00\x03\x00abc\x01\x00d\x05\x00to";
        assert!(serve(requests, &mut answers, Echo, sender).is_err(), "the last request is torn");
        assert_eq!(answers, b"\x00\x00\x06\x00abcabc\x02\x00dd");
        assert!(started.try_recv().is_ok());
    }

    #[test]
    fn the_thread_ends_when_the_board_does() {
        let folder = tempfile::tempdir().unwrap();
        let mut thread = PlantThread::start(folder.path(), Echo).unwrap();
        let board = File::options().write(true).open(folder.path().join(name(shim::REQUEST_PIPE))).unwrap();
        thread.release();
        drop(board);
        thread.end();
    }

    #[test]
    fn a_board_that_never_opened_the_pipes_leaves_no_thread() {
        let folder = tempfile::tempdir().unwrap();
        PlantThread::start(folder.path(), Echo).unwrap().end();
    }
}
