//! A simulated device at a port of this computer. A host may vanish and another one connect; the device goes on, as a board does when
//! its cable is pulled.

use std::io::{self, ErrorKind};
use std::net::{TcpListener, TcpStream};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;
use std::time::Duration;

use shared::recorder::RecorderMemory;
use thiserror::Error;

use super::{Chip, Simulated, TruthLog};
use crate::port::{Address, Port};
use plant::bench::{BenchConfig, BenchError, BenchPlant};
use plant::{TickTruth, locked};

/// Longest wait for bytes from the host.
const PATIENCE: Duration = Duration::from_millis(50);

/// Why a device cannot be served.
#[derive(Debug, Error)]
pub enum ServeError {
    /// The bench cannot be built.
    #[error(transparent)]
    Bench(#[from] BenchError),
    /// This computer gives no port.
    #[error("cannot open a port for a simulated device: {0}")]
    Port(#[from] io::Error),
}

/// A device that is served; ends when dropped.
pub struct Served {
    address: Address,
    truths: TruthLog,
    _device: Simulated,
}

impl Served {
    /// Serves a device on a bench, at most `pace` times as fast as a chip, at a free port.
    ///
    /// # Errors
    /// [`ServeError`].
    pub fn start(bench: &BenchConfig, pace: u32) -> Result<Self, ServeError> {
        let bench = BenchPlant::new(bench)?;
        let listener = TcpListener::bind("127.0.0.1:0")?;
        listener.set_nonblocking(true)?;
        let address = Address::Tcp(listener.local_addr()?.to_string());
        let (stop, truths) = (Arc::new(AtomicBool::new(false)), TruthLog::default());
        let (stopped, log) = (Arc::clone(&stop), Arc::clone(&truths));
        let thread = thread::spawn(move || {
            let memory = Box::new(RecorderMemory::new());
            let mut chip = Chip::new(bench, &memory, pace);
            chip.truths = log;
            chip.attend(&listener, &stopped);
        });
        Ok(Self { address, truths, _device: Simulated { stop, thread: Some(thread) } })
    }

    /// Its address.
    pub fn address(&self) -> &Address {
        &self.address
    }

    /// The true state of its plant at a tick, counted from the start of ventilation after the last restart of the plant.
    pub fn truth(&self) -> impl FnMut(usize) -> Option<TickTruth> + Send + use<> {
        let truths = Arc::clone(&self.truths);
        move |tick| locked(&truths).get(tick).copied()
    }
}

impl Chip<'_> {
    /// Runs ticks, and handles one host after the other.
    fn attend(&mut self, listener: &TcpListener, stop: &Arc<AtomicBool>) {
        while !stop.load(Ordering::Relaxed) {
            match listener.accept().and_then(|(stream, _)| port(stream)) {
                Ok(port) => {
                    self.run(port, stop);
                    // Nobody asks any more for the truth of that connection.
                    locked(&self.truths).clear();
                }
                Err(error) if error.kind() == ErrorKind::WouldBlock => {
                    let pause = self.ticks();
                    // Nobody hears it.
                    self.out.clear();
                    thread::sleep(pause);
                }
                Err(error) => {
                    tracing::warn!(%error, "a host could not connect to the simulated device");
                    thread::sleep(PATIENCE);
                }
            }
        }
    }
}

fn port(stream: TcpStream) -> io::Result<Port> {
    // On some systems a connection inherits this from its listener.
    stream.set_nonblocking(false)?;
    stream.set_nodelay(true)?;
    stream.set_read_timeout(Some(PATIENCE))?;
    Ok(Port { reader: Box::new(stream.try_clone()?), writer: Box::new(stream) })
}
