//! A simulated device at a port of this computer. A host may vanish and another one connect; the device goes on, as a board does when
//! its cable is pulled.

use std::io::{self, ErrorKind};
use std::net::{TcpListener, TcpStream};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Sender, channel};
use std::thread;
use std::time::Duration;

use shared::recorder::RecorderMemory;
use shared::weights::IMAGE_BYTES;
use thiserror::Error;

use super::{Paced, PlantFault, Simulated};
use crate::port::{Address, Port};
use plant::bench::{BenchConfig, BenchError, BenchPlant};
use plant::{TickTruth, locked};
use virtual_chip::{Chip, TruthLog};

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

/// How a device is served.
#[derive(Clone, Debug)]
pub struct ServedConfig {
    /// It is at most this many times as fast as a chip.
    pub pace: u32,
    /// Weights in its first slot when it starts.
    pub weights: Option<Box<[u8; IMAGE_BYTES]>>,
    /// Whether it reads all sensors of the bench; otherwise the airway sensor alone, as a board on the plant link does.
    pub all_sensors: bool,
    /// Whether it keeps the true state of each tick for [`Served::truth`], which takes memory for as long as it ventilates.
    pub keeps_truth: bool,
}

/// A device that is served; ends when dropped.
pub struct Served {
    address: Address,
    truths: TruthLog,
    faults: Sender<PlantFault>,
    _device: Simulated,
}

impl Served {
    /// Serves a device on a bench, at most `pace` times as fast as a chip, at a free port.
    ///
    /// # Errors
    /// [`ServeError`].
    pub fn start(bench: &BenchConfig, pace: u32) -> Result<Self, ServeError> {
        Self::with(bench, ServedConfig { pace, weights: None, all_sensors: false, keeps_truth: true })
    }

    /// Serves a device on a bench at a free port.
    ///
    /// # Errors
    /// [`ServeError`].
    pub fn with(bench: &BenchConfig, config: ServedConfig) -> Result<Self, ServeError> {
        let bench = BenchPlant::new(bench)?;
        let listener = TcpListener::bind("127.0.0.1:0")?;
        listener.set_nonblocking(true)?;
        let address = Address::Tcp(listener.local_addr()?.to_string());
        let (stop, truths) = (Arc::new(AtomicBool::new(false)), TruthLog::default());
        let (stopped, log) = (Arc::clone(&stop), Arc::clone(&truths));
        let (faults, injected) = channel();
        let thread = thread::spawn(move || {
            let memory = Box::new(RecorderMemory::new());
            let mut chip = Chip::new(bench, &memory);
            if config.keeps_truth {
                chip.keep_truths(log);
            }
            if config.all_sensors {
                chip.read_all_sensors();
            }
            if let Some(weights) = config.weights {
                chip.boot_with(&weights);
            }
            let mut paced = Paced::new(chip, config.pace);
            paced.injected = Some(injected);
            paced.attend(&listener, &stopped);
        });
        Ok(Self { address, truths, faults, _device: Simulated { stop, thread: Some(thread) } })
    }

    /// Injects a fault into its plant or its sensor, within a few ticks.
    pub fn inject(&self, fault: PlantFault) {
        // The device lives as long as this; one that panicked has already reported it.
        let _ = self.faults.send(fault);
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

impl Paced<'_> {
    /// Does what was injected since the last call.
    pub(super) fn take_faults(&mut self) {
        let Some(injected) = &self.injected else { return };
        while let Ok(fault) = injected.try_recv() {
            self.chip.inject(fault);
        }
    }

    /// Runs ticks, and handles one host after the other.
    fn attend(&mut self, listener: &TcpListener, stop: &Arc<AtomicBool>) {
        while !stop.load(Ordering::Relaxed) {
            match listener.accept().and_then(|(stream, _)| port(stream)) {
                Ok(port) => {
                    self.run(port, stop);
                    // Nobody asks any more for the truth of that connection.
                    if let Some(truths) = self.chip.truths() {
                        locked(truths).clear();
                    }
                }
                Err(error) if error.kind() == ErrorKind::WouldBlock => {
                    let pause = self.ticks();
                    // Nobody hears it.
                    self.chip.out().clear();
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
