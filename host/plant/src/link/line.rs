//! The line to a plant: a TCP connection, or the standard input and output of a command that is started here.

use std::io::{self, ErrorKind, Read, Write};
use std::net::{TcpStream, ToSocketAddrs};
use std::process::{Child, ChildStdin, Command, Stdio};
use std::sync::mpsc::{Receiver, RecvTimeoutError, sync_channel};
use std::thread;
use std::time::{Duration, Instant};

use shared::link::plant_link::FRAME_BYTES;

use super::{PlantAddress, PlantError};

/// How long a plant's command may take to end once its input is closed.
const FAREWELL: Duration = Duration::from_secs(1);
/// Pieces of output that may wait to be read; a plant in lockstep never has more than one.
const PIECES: usize = 16;

/// What can go wrong on a line.
#[derive(Debug)]
pub(super) enum Trouble {
    /// Too few bytes in time.
    Late {
        /// How many came.
        bytes: usize,
    },
    /// The other end is closed.
    Gone,
    /// Anything else.
    Failed(String),
}

/// An open line.
pub(super) struct Line {
    ends: Ends,
    patience: Duration,
}

enum Ends {
    Tcp(TcpStream),
    Pipe(Box<Pipe>),
}

impl Line {
    pub(super) fn open(address: &PlantAddress, patience: Duration) -> Result<Self, PlantError> {
        let ends = match address {
            PlantAddress::Tcp(name) => {
                let failed = |reason: io::Error| PlantError::Connect {
                    address: address.to_string(),
                    reason: reason.to_string(),
                };
                Ends::Tcp(connect(name, patience).map_err(failed)?)
            }
            PlantAddress::Pipe(words) => {
                let failed = |reason: io::Error| PlantError::Start {
                    command: words.join(" "),
                    reason: reason.to_string(),
                };
                Ends::Pipe(Box::new(Pipe::start(words).map_err(failed)?))
            }
        };
        Ok(Self { ends, patience })
    }

    /// How long an answer may take.
    pub(super) fn patience(&self) -> Duration {
        self.patience
    }

    /// How the plant ended, where that can be known.
    pub(super) fn status(&mut self) -> String {
        match &mut self.ends {
            Ends::Tcp(_) => String::new(),
            Ends::Pipe(pipe) => pipe.status(),
        }
    }

    /// Sends a frame and waits for as many bytes.
    pub(super) fn exchange(
        &mut self,
        request: &[u8; FRAME_BYTES],
        answer: &mut [u8; FRAME_BYTES],
    ) -> Result<(), Trouble> {
        let deadline = Instant::now() + self.patience;
        let mut bytes = 0;
        let outcome = match &mut self.ends {
            Ends::Tcp(stream) => exchange_tcp(stream, request, answer, deadline, &mut bytes),
            Ends::Pipe(pipe) => pipe.exchange(request, answer, deadline, &mut bytes),
        };
        outcome.map_err(|error| match error.kind() {
            ErrorKind::TimedOut | ErrorKind::WouldBlock => Trouble::Late { bytes },
            ErrorKind::UnexpectedEof
            | ErrorKind::BrokenPipe
            | ErrorKind::ConnectionReset
            | ErrorKind::ConnectionAborted => Trouble::Gone,
            _ => Trouble::Failed(error.to_string()),
        })
    }
}

/// Tries every address of a name.
fn connect(name: &str, patience: Duration) -> io::Result<TcpStream> {
    let mut failure = io::Error::new(ErrorKind::NotFound, "the name has no address");
    for address in name.to_socket_addrs()? {
        match TcpStream::connect_timeout(&address, patience) {
            Ok(stream) => {
                stream.set_nodelay(true)?;
                stream.set_write_timeout(Some(patience))?;
                return Ok(stream);
            }
            Err(error) => failure = error,
        }
    }
    Err(failure)
}

fn exchange_tcp(
    stream: &mut TcpStream,
    request: &[u8],
    answer: &mut [u8],
    deadline: Instant,
    bytes: &mut usize,
) -> io::Result<()> {
    stream.write_all(request)?;
    while *bytes < answer.len() {
        stream.set_read_timeout(Some(left(deadline)?))?;
        match stream.read(&mut answer[*bytes..]) {
            Ok(0) => return Err(ErrorKind::UnexpectedEof.into()),
            Ok(count) => *bytes += count,
            Err(error) if error.kind() == ErrorKind::Interrupted => {}
            Err(error) => return Err(error),
        }
    }
    Ok(())
}

/// Time that is left, if any is.
fn left(deadline: Instant) -> io::Result<Duration> {
    let left = deadline.saturating_duration_since(Instant::now());
    if left.is_zero() { Err(ErrorKind::TimedOut.into()) } else { Ok(left) }
}

/// A plant's process. What it writes to standard error appears on ours.
struct Pipe {
    child: Child,
    /// None once it is closed, which tells the plant to end.
    input: Option<ChildStdin>,
    output: Receiver<Vec<u8>>,
    /// What was read beyond an answer.
    rest: Vec<u8>,
}

impl Pipe {
    fn start(words: &[String]) -> io::Result<Self> {
        let (program, arguments) = words.split_first().ok_or(ErrorKind::InvalidInput)?;
        let mut command = Command::new(program);
        command.args(arguments).stdin(Stdio::piped()).stdout(Stdio::piped());
        // A Ctrl-C is for the trainer, which ends the plant once it is done with it.
        #[cfg(unix)]
        std::os::unix::process::CommandExt::process_group(&mut command, 0);
        let mut child = command.spawn()?;
        let input = child.stdin.take();
        let mut stdout = child.stdout.take().ok_or(ErrorKind::BrokenPipe)?;
        let (pieces, output) = sync_channel(PIECES);
        // A pipe's reads know no time limit, a channel's do.
        thread::spawn(move || {
            let mut buffer = [0; 4 * FRAME_BYTES];
            while let Ok(count @ 1..) = stdout.read(&mut buffer) {
                if pieces.send(buffer[..count].to_vec()).is_err() {
                    break;
                }
            }
        });
        Ok(Self { child, input, output, rest: Vec::new() })
    }

    fn exchange(
        &mut self,
        request: &[u8],
        answer: &mut [u8],
        deadline: Instant,
        bytes: &mut usize,
    ) -> io::Result<()> {
        let input = self.input.as_mut().ok_or(ErrorKind::BrokenPipe)?;
        input.write_all(request)?;
        input.flush()?;
        while self.rest.len() < answer.len() {
            *bytes = self.rest.len();
            match self.output.recv_timeout(left(deadline)?) {
                Ok(piece) => self.rest.extend(piece),
                Err(RecvTimeoutError::Timeout) => return Err(ErrorKind::TimedOut.into()),
                Err(RecvTimeoutError::Disconnected) => return Err(ErrorKind::UnexpectedEof.into()),
            }
        }
        answer.copy_from_slice(&self.rest[..answer.len()]);
        self.rest.drain(..answer.len());
        Ok(())
    }

    /// Closes its input and waits for a moment, so that it can end by itself.
    fn farewell(&mut self) -> Option<std::process::ExitStatus> {
        self.input = None;
        let deadline = Instant::now() + FAREWELL;
        loop {
            match self.child.try_wait() {
                Ok(None) if Instant::now() < deadline => thread::sleep(Duration::from_millis(5)),
                ended => return ended.ok().flatten(),
            }
        }
    }

    fn status(&mut self) -> String {
        self.farewell().map_or_else(String::new, |status| format!(" ({status})"))
    }
}

impl Drop for Pipe {
    fn drop(&mut self) {
        if self.farewell().is_none() {
            let _ = self.child.kill();
            let _ = self.child.wait();
        }
    }
}
