//! What is watched: a device at a port, or a simulated one in this process. Each gives news and takes requests.

use std::time::Duration;

use shared::breath::DEFAULT_PERIOD_US;
use shared::link::messages::{DeviceIdentity, Request};
use show::monitor::News;
use show::monitor::session::Session;
use thiserror::Error;

use crate::stream::{DemoFault, FlightRecorder, Kind, Verdict};
use device::port::Address;
use device::simulated::{ServeError, Served, ServedConfig};
use device::{Device, DeviceError};
use plant::bench::BenchConfig;

/// Why something cannot be watched.
#[derive(Debug, Error)]
pub enum SourceError {
    /// The device does not answer.
    #[error(transparent)]
    Device(#[from] DeviceError),
    /// A simulated device cannot start.
    #[error(transparent)]
    Simulated(#[from] ServeError),
}

/// Why a request does not reach a source.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
pub enum Unable {
    /// A replay does what was recorded.
    #[error("a replay cannot be steered")]
    Replay,
    /// Faults are for simulated devices.
    #[error("faults can be injected only into the simulated devices of `--demo` and `--bench`")]
    NoFaults,
}

/// A source of news.
pub trait Source: Send {
    /// Waits for the next piece of news.
    fn next(&mut self, patience: Duration) -> Option<News>;

    /// Sends a request; the answer arrives as news.
    ///
    /// # Errors
    /// [`Unable::Replay`].
    fn ask(&mut self, request: Request) -> Result<(), Unable>;

    /// Injects a fault.
    ///
    /// # Errors
    /// [`Unable`].
    fn fault(&mut self, _fault: DemoFault) -> Result<(), Unable> {
        Err(Unable::NoFaults)
    }

    /// Ends; a device goes on as it is.
    fn leave(self: Box<Self>);
}

/// A source with what pages show of it.
pub struct Watch {
    /// Name to show.
    pub name: String,
    /// What it is.
    pub kind: Kind,
    /// Control period, microseconds.
    pub period_us: u32,
    /// The source.
    pub source: Box<dyn Source>,
    /// The verdict on a recording.
    pub verdict: Option<Verdict>,
    /// The content of a flight recorder.
    pub recorder: Option<FlightRecorder>,
}

impl Watch {
    /// Watches the device at a port; also returns its identity, or why it does not answer now. One that does not, or that is lost
    /// later, is tried again: the other devices on the page do not wait for it.
    pub fn port(address: &Address) -> (Self, Result<DeviceIdentity, DeviceError>) {
        let mut device = Device::at(address);
        let identity = device.reconnect().and_then(|()| device.identify());
        let known = identity.as_ref().ok();
        let watch = Self {
            name: address.to_string(),
            // A device that answers later says what it is.
            kind: known.map_or(Kind::Board, |identity| Kind::of(identity.device)),
            period_us: known.map_or(DEFAULT_PERIOD_US, |identity| identity.period_us),
            source: Box::new(Connected(Session::start(device))),
            verdict: None,
            recorder: None,
        };
        (watch, identity)
    }

    /// Watches a simulated device on this bench, which runs as fast as a chip.
    ///
    /// # Errors
    /// [`SourceError`].
    pub fn bench(name: impl Into<String>, bench: &BenchConfig) -> Result<Self, SourceError> {
        let config = ServedConfig { pace: 1, weights: None, all_sensors: true, keeps_truth: false };
        let served = Served::with(bench, config)?;
        let device = Device::connect(served.address())?;
        Ok(Self::simulated(name, served, device))
    }

    /// Watches a simulated device that is connected.
    pub(crate) fn simulated(name: impl Into<String>, served: Served, device: Device) -> Self {
        let source = Box::new(Simulated { session: Session::start(device), served });
        let (kind, period_us) = (Kind::Simulated, DEFAULT_PERIOD_US);
        Self { name: name.into(), kind, period_us, source, verdict: None, recorder: None }
    }
}

/// A device at a port.
struct Connected(Session);

impl Source for Connected {
    fn next(&mut self, patience: Duration) -> Option<News> {
        self.0.next(patience)
    }

    fn ask(&mut self, request: Request) -> Result<(), Unable> {
        self.0.ask(request);
        Ok(())
    }

    fn leave(self: Box<Self>) {
        self.0.leave();
    }
}

/// A simulated device of this process, behind the same link as a board.
struct Simulated {
    session: Session,
    served: Served,
}

impl Source for Simulated {
    fn next(&mut self, patience: Duration) -> Option<News> {
        self.session.next(patience)
    }

    fn ask(&mut self, request: Request) -> Result<(), Unable> {
        self.session.ask(request);
        Ok(())
    }

    fn fault(&mut self, fault: DemoFault) -> Result<(), Unable> {
        self.served.inject(fault.into());
        Ok(())
    }

    fn leave(self: Box<Self>) {
        self.session.leave();
    }
}
