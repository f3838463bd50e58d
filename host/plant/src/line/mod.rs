//! A line in lockstep to a program in any language: a TCP connection, or the standard input and output of a command started here.
//! The plant link runs over it, and so does the link to a policy.

mod address;

use std::collections::VecDeque;
use std::io::{self, ErrorKind, Read, Write};
use std::net::{TcpStream, ToSocketAddrs};
use std::process::{Child, ChildStdin, Command, Stdio};
use std::sync::mpsc::{Receiver, RecvTimeoutError, sync_channel};
use std::thread;
use std::time::{Duration, Instant};

use thiserror::Error;

pub use address::{Address, AddressError, tcp_address};

/// Longest time for a command to end after its input is closed.
const FAREWELL: Duration = Duration::from_secs(1);
/// Largest number of unread pieces of output; a program in lockstep never has more than one.
const PIECES: usize = 16;
/// Largest length of a piece, bytes: more than a frame of any link.
const PIECE_BYTES: usize = 64;

/// Why a line cannot be opened, or why an answer is missing.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum LineError {
    /// No program listens at the address.
    #[error("cannot connect to {address}: {reason}; start the program that listens there first")]
    Connect {
        /// The address.
        address: String,
        /// The reason.
        reason: String,
    },
    /// The command cannot be started.
    #[error("cannot start `{command}`: {reason}; check the command")]
    Start {
        /// The command.
        command: String,
        /// The reason.
        reason: String,
    },
    /// The answer did not arrive in time.
    #[error("{bytes} of {wanted} bytes arrived in {seconds} s")]
    Late {
        /// Number of bytes received.
        bytes: usize,
        /// Length of an answer, bytes.
        wanted: usize,
        /// The time limit, s.
        seconds: f64,
    },
    /// The line is closed.
    #[error("the other end has closed the line{status}")]
    Gone {
        /// How the program ended, if known.
        status: String,
    },
    /// The line failed in another way.
    #[error("the line failed: {0}")]
    Failed(String),
}

/// An open line.
pub struct Line {
    ends: Ends,
    patience: Duration,
}

enum Ends {
    Tcp(TcpStream),
    Pipe(Box<Pipe>),
}

impl Line {
    /// Connects to a program, or starts it; every answer may take up to `patience`.
    ///
    /// # Errors
    /// An address at which nothing listens, or a command that cannot be started.
    pub fn open(address: &Address, patience: Duration) -> Result<Self, LineError> {
        let ends = match address {
            Address::Tcp(name) => connect(name, patience).map(Ends::Tcp).map_err(|reason| {
                LineError::Connect { address: address.to_string(), reason: reason.to_string() }
            }),
            Address::Pipe(words) => Pipe::start(words)
                .map(|pipe| Ends::Pipe(Box::new(pipe)))
                .map_err(|reason| LineError::Start { command: words.join(" "), reason: reason.to_string() }),
        };
        Ok(Self { ends: ends?, patience })
    }

    /// Sends a frame, and waits for an answer of the same length.
    ///
    /// # Errors
    /// An answer that is late, or a line that is closed.
    pub fn exchange<const N: usize>(&mut self, request: &[u8; N]) -> Result<[u8; N], LineError> {
        let mut answer = [0; N];
        let mut bytes = 0;
        self.talk(request, &mut answer, &mut bytes).map_err(|error| match error.kind() {
            ErrorKind::TimedOut | ErrorKind::WouldBlock => {
                LineError::Late { bytes, wanted: N, seconds: self.patience.as_secs_f64() }
            }
            ErrorKind::UnexpectedEof
            | ErrorKind::BrokenPipe
            | ErrorKind::ConnectionReset
            | ErrorKind::ConnectionAborted => LineError::Gone { status: self.status() },
            _ => LineError::Failed(error.to_string()),
        })?;
        Ok(answer)
    }

    /// Sends a request and reads the answer; `bytes` counts the bytes received.
    fn talk(&mut self, request: &[u8], answer: &mut [u8], bytes: &mut usize) -> io::Result<()> {
        let deadline = Instant::now() + self.patience;
        self.ends.send(request)?;
        while *bytes < answer.len() {
            let left = deadline.saturating_duration_since(Instant::now());
            if left.is_zero() {
                return Err(ErrorKind::TimedOut.into());
            }
            *bytes += self.ends.receive(&mut answer[*bytes..], left)?;
        }
        Ok(())
    }

    /// How the program ended, if known.
    fn status(&mut self) -> String {
        match &mut self.ends {
            Ends::Tcp(_) => String::new(),
            Ends::Pipe(pipe) => pipe.farewell().map_or_else(String::new, |status| format!(" ({status})")),
        }
    }
}

impl Ends {
    fn send(&mut self, request: &[u8]) -> io::Result<()> {
        match self {
            Self::Tcp(stream) => stream.write_all(request),
            Self::Pipe(pipe) => {
                let input = pipe.input.as_mut().ok_or(ErrorKind::BrokenPipe)?;
                input.write_all(request)?;
                input.flush()
            }
        }
    }

    /// Waits for bytes for at most `time`, reads those that fit, and returns their number.
    fn receive(&mut self, buffer: &mut [u8], time: Duration) -> io::Result<usize> {
        match self {
            Self::Tcp(stream) => {
                stream.set_read_timeout(Some(time))?;
                match stream.read(buffer) {
                    Ok(0) => Err(ErrorKind::UnexpectedEof.into()),
                    Err(error) if error.kind() == ErrorKind::Interrupted => Ok(0),
                    outcome => outcome,
                }
            }
            Self::Pipe(pipe) => {
                if pipe.rest.is_empty() {
                    let piece = pipe.output.recv_timeout(time).map_err(|error| match error {
                        RecvTimeoutError::Timeout => ErrorKind::TimedOut,
                        RecvTimeoutError::Disconnected => ErrorKind::UnexpectedEof,
                    })?;
                    pipe.rest.extend(piece);
                }
                pipe.rest.read(buffer)
            }
        }
    }
}

/// Tries every address of a host name.
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

/// The process of a command. Its standard error is passed through.
struct Pipe {
    child: Child,
    /// `None` once it is closed, which makes the program end.
    input: Option<ChildStdin>,
    output: Receiver<Vec<u8>>,
    /// Bytes received but not yet read.
    rest: VecDeque<u8>,
}

impl Pipe {
    fn start(words: &[String]) -> io::Result<Self> {
        let (program, arguments) = words.split_first().ok_or(ErrorKind::InvalidInput)?;
        let mut command = Command::new(program);
        command.args(arguments).stdin(Stdio::piped()).stdout(Stdio::piped());
        // A Ctrl-C is meant for the trainer, which ends the program when it no longer needs it.
        #[cfg(unix)]
        std::os::unix::process::CommandExt::process_group(&mut command, 0);
        let mut child = command.spawn()?;
        let input = child.stdin.take();
        let mut stdout = child.stdout.take().ok_or(ErrorKind::BrokenPipe)?;
        let (pieces, output) = sync_channel(PIECES);
        // Reads from a pipe have no timeout; reads from a channel do.
        thread::spawn(move || {
            let mut buffer = [0; PIECE_BYTES];
            while let Ok(count @ 1..) = stdout.read(&mut buffer) {
                if pieces.send(buffer[..count].to_vec()).is_err() {
                    break;
                }
            }
        });
        Ok(Self { child, input, output, rest: VecDeque::new() })
    }

    /// Closes its input and waits briefly, so that it can end by itself.
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
}

impl Drop for Pipe {
    fn drop(&mut self) {
        if self.farewell().is_none() {
            let _ = self.child.kill();
            let _ = self.child.wait();
        }
    }
}
