//! A minimal client of the GDB remote protocol that accesses memory and registers of the board in QEMU, for tests that
//! inject faults.
//!
//! Changes to the program in flash survive a reset of the board.

use std::io::{self, BufRead, BufReader, Read, Write};
use std::net::{SocketAddr, TcpStream};
use std::path::Path;
use std::time::Duration;

use object::{Object, ObjectSymbol};
use shim::record::{self, Record};
use thiserror::Error;

/// Longest wait for an answer of QEMU.
const PATIENCE: Duration = Duration::from_secs(30);
/// Most bytes of memory in one packet.
const PIECE: usize = 1024;
/// Number of core registers in a packet: r0 to r12, stack pointer, link register, program counter, status.
pub const REGISTERS: usize = 17;

/// Reason why a debugger's operation failed.
#[derive(Debug, Error)]
pub enum DebuggerError {
    /// The connection failed.
    #[error("connection to QEMU's debugger port failed: {0}")]
    Io(#[from] io::Error),
    /// QEMU refused a request.
    #[error("QEMU answered {answer:?} to the debugger's request {request:?}")]
    Refused {
        /// The request.
        request: String,
        /// The answer.
        answer: String,
    },
    /// The image cannot be read.
    #[error("{path} is not an image with symbols: {reason}")]
    Image {
        /// Path of the image.
        path: String,
        /// Reason.
        reason: String,
    },
    /// No symbol or several symbols have the name.
    #[error(
        "{count} symbols are named {name}, expected one; if 0, the function may be inlined; if several, give more of its path"
    )]
    Symbol {
        /// The name.
        name: String,
        /// Number of symbols with that name.
        count: usize,
    },
    /// No shim has run.
    #[error("the board's memory contains no record of the shim; start the board with the shim")]
    NoRecord,
}

/// A connection to a halted board.
#[derive(Debug)]
pub struct Debugger {
    input: BufReader<TcpStream>,
    output: TcpStream,
}

impl Debugger {
    /// Connects; the board halts.
    ///
    /// # Errors
    /// There is no debugger port at the address.
    pub fn connect(address: SocketAddr) -> Result<Self, DebuggerError> {
        let output = TcpStream::connect(address)?;
        output.set_nodelay(true)?;
        output.set_read_timeout(Some(PATIENCE))?;
        let mut debugger = Self { input: BufReader::new(output.try_clone()?), output };
        // The answer also confirms that the board has halted.
        debugger.ask("?")?;
        Ok(debugger)
    }

    /// Reads memory.
    ///
    /// # Errors
    /// There is no memory at the address, or it is protected: only the shim can read the parts that it models.
    pub fn read(&mut self, address: u32, length: usize) -> Result<Vec<u8>, DebuggerError> {
        let mut bytes = Vec::with_capacity(length);
        while bytes.len() < length {
            let (at, piece) = (address + bytes.len() as u32, PIECE.min(length - bytes.len()));
            let request = format!("m{at:x},{piece:x}");
            let answer = self.ask(&request)?;
            let read = from_hex(&answer).filter(|read| read.len() == piece);
            bytes.extend(read.ok_or(DebuggerError::Refused { request, answer })?);
        }
        Ok(bytes)
    }

    /// Writes memory, flash included.
    ///
    /// # Errors
    /// There is no memory at the address.
    pub fn write(&mut self, address: u32, bytes: &[u8]) -> Result<(), DebuggerError> {
        for (piece, at) in bytes.chunks(PIECE).zip((address..).step_by(PIECE)) {
            self.command(&format!("M{at:x},{:x}:{}", piece.len(), to_hex(piece)))?;
        }
        Ok(())
    }

    /// The core's registers: r0 to r12, stack pointer, link register, program counter, status.
    ///
    /// # Errors
    /// The board is running, or the connection failed.
    pub fn registers(&mut self) -> Result<[u32; REGISTERS], DebuggerError> {
        let answer = self.ask("g")?;
        let words = from_hex(&answer).map(|bytes| words(&bytes));
        let registers = words.and_then(|words| words.first_chunk().copied());
        registers.ok_or(DebuggerError::Refused { request: "g".into(), answer })
    }

    /// The shim's record: counters and pins.
    ///
    /// # Errors
    /// No shim has run, or the connection failed.
    pub fn record(&mut self) -> Result<Record, DebuggerError> {
        let words = words(&self.read(record::ADDRESS, 4 * record::WORDS)?);
        words.first_chunk().and_then(Record::from_words).ok_or(DebuggerError::NoRecord)
    }

    /// Lets the shim cut the power after this number of flash operations, counted from power-on, and detaches.
    ///
    /// # Errors
    /// The connection failed.
    pub fn cut_power_at(mut self, flash_operation: u32) -> Result<(), DebuggerError> {
        self.write(record::POWER_CUT_ADDRESS, &flash_operation.to_le_bytes())?;
        self.detach()
    }

    /// Sets the adverse conditions of the board, such as [`record::NO_CRYSTAL`], and detaches.
    ///
    /// # Errors
    /// The connection failed.
    pub fn suffer(mut self, conditions: u32) -> Result<(), DebuggerError> {
        self.write(record::CONDITIONS_ADDRESS, &conditions.to_le_bytes())?;
        self.detach()
    }

    /// Runs the board until it is about to execute the instruction at an address.
    ///
    /// # Errors
    /// It does not reach the address within 30 s, or the connection failed.
    pub fn run_to(&mut self, address: u32) -> Result<(), DebuggerError> {
        self.command(&format!("Z0,{address:x},2"))?;
        self.ask("c")?;
        self.command(&format!("z0,{address:x},2"))
    }

    /// Sets the program counter of a halted board.
    ///
    /// # Errors
    /// The connection failed.
    pub fn jump(&mut self, address: u32) -> Result<(), DebuggerError> {
        const PROGRAM_COUNTER: u32 = 15;
        self.command(&format!("P{PROGRAM_COUNTER:x}={}", to_hex(&address.to_le_bytes())))
    }

    /// Detaches; the board continues.
    ///
    /// # Errors
    /// The connection failed.
    pub fn detach(mut self) -> Result<(), DebuggerError> {
        self.command("D")
    }

    fn command(&mut self, request: &str) -> Result<(), DebuggerError> {
        match self.ask(request)?.as_str() {
            "OK" => Ok(()),
            answer => Err(DebuggerError::Refused { request: request.into(), answer: answer.into() }),
        }
    }

    fn ask(&mut self, request: &str) -> Result<String, DebuggerError> {
        self.send(request)?;
        self.receive()
    }

    fn send(&mut self, request: &str) -> Result<(), DebuggerError> {
        self.output.write_all(packet(request).as_bytes())?;
        Ok(())
    }

    /// Receives the next packet. TCP loses no bytes, so acknowledgements are ignored.
    fn receive(&mut self) -> Result<String, DebuggerError> {
        let mut text = Vec::new();
        self.input.read_until(b'$', &mut text)?;
        text.clear();
        self.input.read_until(b'#', &mut text)?;
        let mut checksum = [0; 2];
        self.input.read_exact(&mut checksum)?;
        self.output.write_all(b"+")?;
        text.pop();
        Ok(String::from_utf8_lossy(&text).into_owned())
    }
}

fn packet(text: &str) -> String {
    let checksum = text.bytes().fold(0_u8, u8::wrapping_add);
    format!("${text}#{checksum:02x}")
}

fn to_hex(bytes: &[u8]) -> String {
    let digits = bytes.iter().flat_map(|byte| [byte >> 4, byte & 15]);
    digits.filter_map(|digit| char::from_digit(digit.into(), 16)).collect()
}

fn from_hex(text: &str) -> Option<Vec<u8>> {
    let pairs = text.as_bytes().chunks(2);
    pairs.map(|pair| u8::from_str_radix(std::str::from_utf8(pair).ok()?, 16).ok()).collect()
}

fn words(bytes: &[u8]) -> Vec<u32> {
    let (words, _) = bytes.as_chunks();
    words.iter().copied().map(u32::from_le_bytes).collect()
}

/// Address of the symbol of an image whose name or path ends in `name` (`task::run` for `firmware::chip::task::run`). For a
/// function it is the address of the first instruction.
///
/// # Errors
/// The image cannot be read, or the number of such symbols is not one.
pub fn symbol(image: &Path, name: &str) -> Result<u32, DebuggerError> {
    let wrong = |reason: String| DebuggerError::Image { path: image.display().to_string(), reason };
    let bytes = std::fs::read(image).map_err(|error| wrong(error.to_string()))?;
    let file = object::File::parse(bytes.as_slice()).map_err(|error| wrong(error.to_string()))?;
    let called = file.symbols().filter(|symbol| symbol.name().is_ok_and(|symbol| is_called(symbol, name)));
    let addresses: Vec<u64> = called.map(|symbol| symbol.address()).collect();
    match addresses[..] {
        // The lowest bit only marks a Thumb function.
        [address] => Ok(address as u32 & !1),
        _ => Err(DebuggerError::Symbol { name: name.into(), count: addresses.len() }),
    }
}

/// Whether `name` is a symbol's name or the end of its path.
fn is_called(symbol: &str, name: &str) -> bool {
    // The alternate format omits the hash.
    let path = format!("{:#}", rustc_demangle::demangle(symbol));
    symbol == name || path == name || path.strip_suffix(name).is_some_and(|before| before.ends_with("::"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn packets_carry_their_checksum() {
        assert_eq!(packet("m0,4"), "$m0,4#fd");
    }

    #[test]
    fn bytes_survive_the_way_to_hex_and_back() {
        let bytes: Vec<u8> = (0..=255).collect();
        assert_eq!(from_hex(&to_hex(&bytes)), Some(bytes));
        assert_eq!(from_hex("E0x"), None);
    }

    #[test]
    fn words_are_little_endian() {
        assert_eq!(words(&[1, 2, 3, 4, 5, 0, 0, 0, 9]), [0x0403_0201, 5]);
    }

    #[test]
    fn a_symbol_is_found_by_the_end_of_its_path() {
        let symbol = "_ZN4shim4chip5start17h60d89ef3420e74d4E";
        for name in ["start", "chip::start", "shim::chip::start", symbol] {
            assert!(is_called(symbol, name), "{name}");
        }
        for name in ["art", "hip::start", "chip"] {
            assert!(!is_called(symbol, name), "{name}");
        }
    }
}
