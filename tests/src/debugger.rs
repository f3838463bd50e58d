//! A minimal client of the GDB remote protocol: memory and registers of the board in QEMU, for tests that inject faults.
//!
//! Changes to the program in flash outlive a reset of the board.

use std::io::{self, BufRead, BufReader, Read, Write};
use std::net::{SocketAddr, TcpStream};
use std::path::Path;
use std::time::Duration;

use object::{Object, ObjectSymbol};
use shim::record::{self, Record};
use thiserror::Error;

/// Longest time that QEMU may take for an answer.
const PATIENCE: Duration = Duration::from_secs(30);
/// Bytes of memory in one packet.
const PIECE: usize = 1024;
/// Core registers in a packet: r0 to r12, stack pointer, link register, program counter, status.
pub const REGISTERS: usize = 17;

/// Why the debugger could not do what it was asked for.
#[derive(Debug, Error)]
pub enum DebuggerError {
    /// The connection failed.
    #[error("the debugger's connection failed: {0}")]
    Io(#[from] io::Error),
    /// QEMU refused.
    #[error("QEMU answered {answer:?} to the debugger's {request:?}")]
    Refused {
        /// The request.
        request: String,
        /// The answer.
        answer: String,
    },
    /// The image cannot be read.
    #[error("{path} is no image with symbols: {reason}")]
    Image {
        /// The image.
        path: String,
        /// Why.
        reason: String,
    },
    /// Not exactly one symbol has the name.
    #[error(
        "{count} symbols are called {name}, one was expected; it may have been inlined, or give more of its path"
    )]
    Symbol {
        /// The name.
        name: String,
        /// Symbols of that name.
        count: usize,
    },
    /// No shim has run.
    #[error("the shim has left no record: is this board started with it?")]
    NoRecord,
}

/// A connection to a board, which stands still until it is resumed.
#[derive(Debug)]
pub struct Debugger {
    input: BufReader<TcpStream>,
    output: TcpStream,
}

impl Debugger {
    /// Connects; the board halts.
    ///
    /// # Errors
    /// No debugger may connect there.
    pub fn connect(address: SocketAddr) -> Result<Self, DebuggerError> {
        let output = TcpStream::connect(address)?;
        output.set_nodelay(true)?;
        output.set_read_timeout(Some(PATIENCE))?;
        let mut debugger = Self { input: BufReader::new(output.try_clone()?), output };
        // The answer to this also says that the board stands still.
        debugger.ask("?")?;
        Ok(debugger)
    }

    /// Reads memory.
    ///
    /// # Errors
    /// There is none at the address, or the protection forbids it: of the parts that the shim models only the shim knows.
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
    /// There is none at the address.
    pub fn write(&mut self, address: u32, bytes: &[u8]) -> Result<(), DebuggerError> {
        for (piece, at) in bytes.chunks(PIECE).zip((address..).step_by(PIECE)) {
            self.command(&format!("M{at:x},{:x}:{}", piece.len(), to_hex(piece)))?;
        }
        Ok(())
    }

    /// The core's registers: r0 to r12, stack pointer, link register, program counter, status.
    ///
    /// # Errors
    /// The board runs, or the connection failed.
    pub fn registers(&mut self) -> Result<[u32; REGISTERS], DebuggerError> {
        let answer = self.ask("g")?;
        let words = from_hex(&answer).map(|bytes| words(&bytes));
        let registers = words.and_then(|words| words.first_chunk().copied());
        registers.ok_or(DebuggerError::Refused { request: "g".into(), answer })
    }

    /// What the shim has counted, and the pins.
    ///
    /// # Errors
    /// No shim has run, or the connection failed.
    pub fn record(&mut self) -> Result<Record, DebuggerError> {
        let words = words(&self.read(record::ADDRESS, 4 * record::WORDS)?);
        words.first_chunk().and_then(Record::from_words).ok_or(DebuggerError::NoRecord)
    }

    /// Lets the power be cut right after one of the changes of the flash, counted from power-on.
    ///
    /// # Errors
    /// The connection failed.
    pub fn cut_power_at(mut self, flash_operation: u32) -> Result<(), DebuggerError> {
        self.write(record::POWER_CUT_ADDRESS, &flash_operation.to_le_bytes())?;
        self.detach()
    }

    /// Lets the board run until it is about to execute the instruction at an address.
    ///
    /// # Errors
    /// It does not get there in half a minute, or the connection failed.
    pub fn run_to(&mut self, address: u32) -> Result<(), DebuggerError> {
        self.command(&format!("Z0,{address:x},2"))?;
        self.ask("c")?;
        self.command(&format!("z0,{address:x},2"))
    }

    /// Leaves; the board runs on.
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

    /// The next packet. TCP loses nothing, so acknowledgements are passed over.
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

/// Address of the one symbol of an image that has this name, or whose path ends in it (`task::run` for
/// `firmware::chip::task::run`). Of a function, the address of its first instruction.
///
/// # Errors
/// The image cannot be read, or not exactly one symbol is called so.
pub fn symbol(image: &Path, name: &str) -> Result<u32, DebuggerError> {
    let wrong = |reason: String| DebuggerError::Image { path: image.display().to_string(), reason };
    let bytes = std::fs::read(image).map_err(|error| wrong(error.to_string()))?;
    let file = object::File::parse(bytes.as_slice()).map_err(|error| wrong(error.to_string()))?;
    let called = file.symbols().filter(|symbol| symbol.name().is_ok_and(|symbol| is_called(symbol, name)));
    let addresses: Vec<u64> = called.map(|symbol| symbol.address()).collect();
    match addresses[..] {
        // The lowest bit only says that it is a Thumb function.
        [address] => Ok(address as u32 & !1),
        _ => Err(DebuggerError::Symbol { name: name.into(), count: addresses.len() }),
    }
}

/// Whether a symbol has a name, or its path ends in it.
fn is_called(symbol: &str, name: &str) -> bool {
    // Without the hash.
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
