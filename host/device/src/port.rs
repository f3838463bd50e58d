//! The line to a device: a serial port, a pseudo-terminal or a TCP connection, as two halves.

use std::fmt;
use std::io::{self, Read, Write};
use std::net::TcpStream;
use std::path::Path;
use std::str::FromStr;
use std::time::Duration;

use plant::line::tcp_address;
use thiserror::Error;

/// Speed of the device's link, baud.
pub const BAUD: u32 = 1_000_000;
/// Time that a read waits before it checks whether to stop.
const PATIENCE: Duration = Duration::from_millis(50);

/// The address of a device.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Address {
    /// A serial port or a pseudo-terminal, at a speed in baud.
    Serial {
        /// The port's name, such as `/dev/ttyACM0` or `COM3`.
        name: String,
        /// Speed, baud.
        baud: u32,
    },
    /// `host:port`.
    Tcp(String),
}

/// The address is not valid.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
#[error("'{0}' is not a device's address: write /dev/ttyACM0, COM3, serial:NAME?baud=N or tcp:HOST:PORT")]
pub struct AddressError(String);

impl FromStr for Address {
    type Err = AddressError;

    fn from_str(text: &str) -> Result<Self, AddressError> {
        let wrong = || AddressError(text.to_owned());
        if let Some(address) = tcp_address(text) {
            return address.map(Self::Tcp).map_err(|_| wrong());
        }
        let text = text.strip_prefix("serial:").unwrap_or(text);
        let (name, baud) = match text.split_once("?baud=") {
            Some((name, baud)) => (name, baud.parse().map_err(|_| wrong())?),
            None => (text, BAUD),
        };
        if name.is_empty() { Err(wrong()) } else { Ok(Self::Serial { name: name.to_owned(), baud }) }
    }
}

impl fmt::Display for Address {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Serial { name, baud: BAUD } => write!(f, "{name}"),
            Self::Serial { name, baud } => write!(f, "serial:{name}?baud={baud}"),
            Self::Tcp(address) => write!(f, "tcp:{address}"),
        }
    }
}

/// Why a port cannot be opened.
#[derive(Debug, Error)]
#[expect(missing_docs, reason = "the message names every field")]
pub enum PortError {
    /// The port does not exist.
    #[error("there is no port {name}; {available}")]
    Missing { name: String, available: String },
    /// Another program uses the port.
    #[error("{0} is in use by another program: end that program first")]
    Busy(String),
    /// The user lacks permission.
    #[error(
        "no permission to open {0}: on Linux, join the group that owns it, usually dialout, and log in again"
    )]
    Permission(String),
    /// No program listens at the address.
    #[error("cannot connect to {address}: {reason}; check that the device or `trainer qemu` is running")]
    Connect { address: String, reason: io::Error },
    /// Any other error.
    #[error("cannot open {name}: {reason}")]
    Open { name: String, reason: String },
}

/// An open line. Reads end with [`io::ErrorKind::TimedOut`] or [`io::ErrorKind::WouldBlock`] after a short silence.
pub struct Port {
    /// Bytes from the device.
    pub reader: Box<dyn Read + Send>,
    /// Bytes to the device.
    pub writer: Box<dyn Write + Send>,
}

impl Port {
    /// Opens a line.
    ///
    /// # Errors
    /// [`PortError`], with advice.
    pub fn open(address: &Address) -> Result<Self, PortError> {
        match address {
            Address::Serial { name, baud } => serial(name, *baud),
            Address::Tcp(address) => {
                tcp(address).map_err(|reason| PortError::Connect { address: address.clone(), reason })
            }
        }
    }
}

fn serial(name: &str, baud: u32) -> Result<Port, PortError> {
    let failed = |error: &serialport::Error| match error.kind {
        serialport::ErrorKind::NoDevice if Path::new(name).exists() => PortError::Busy(name.to_owned()),
        serialport::ErrorKind::NoDevice | serialport::ErrorKind::Io(io::ErrorKind::NotFound) => {
            PortError::Missing { name: name.to_owned(), available: available() }
        }
        serialport::ErrorKind::Io(io::ErrorKind::PermissionDenied) => PortError::Permission(name.to_owned()),
        _ => PortError::Open { name: name.to_owned(), reason: error.to_string() },
    };
    let port = serialport::new(name, baud).timeout(PATIENCE).open().map_err(|error| failed(&error))?;
    let reader = port.try_clone().map_err(|error| failed(&error))?;
    Ok(Port { reader: Box::new(reader), writer: Box::new(port) })
}

/// The serial ports of this computer, as a clause of an error message.
fn available() -> String {
    let names: Vec<String> =
        serialport::available_ports().unwrap_or_default().into_iter().map(|port| port.port_name).collect();
    if names.is_empty() {
        "this computer has no serial port: check that the device is plugged in".to_owned()
    } else {
        format!("available ports: {}", names.join(", "))
    }
}

fn tcp(address: &str) -> io::Result<Port> {
    let stream = TcpStream::connect(address)?;
    stream.set_nodelay(true)?;
    stream.set_read_timeout(Some(PATIENCE))?;
    Ok(Port { reader: Box::new(stream.try_clone()?), writer: Box::new(stream) })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn addresses_are_read_as_they_are_printed() {
        for text in ["/dev/ttyACM0", "COM3", "tcp:localhost:5555", "serial:/dev/ttyUSB0?baud=115200"] {
            assert_eq!(text.parse::<Address>().unwrap().to_string(), text);
        }
        assert_eq!("serial:COM3".parse::<Address>(), "COM3".parse());
        for wrong in ["", "tcp:", "tcp:host", "tcp:host:notaport", "tcp::5", "serial:x?baud=fast"] {
            assert!(wrong.parse::<Address>().unwrap_err().to_string().contains("tcp:HOST:PORT"), "{wrong}");
        }
    }

    #[test]
    fn a_port_that_is_not_there_is_refused_with_those_that_are() {
        let error = Port::open(&"/dev/no-such-port".parse().unwrap()).err().unwrap();
        assert!(matches!(error, PortError::Missing { .. }), "{error}");
    }

    #[test]
    fn an_address_where_nobody_listens_is_refused() {
        let listener = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
        let address = Address::Tcp(listener.local_addr().unwrap().to_string());
        drop(listener);
        assert!(matches!(Port::open(&address), Err(PortError::Connect { .. })));
    }
}
