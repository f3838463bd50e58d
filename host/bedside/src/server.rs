//! A running server: its hubs, its sockets and its end.

use std::io;
use std::net::{IpAddr, Ipv4Addr, Ipv6Addr, SocketAddr};
use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;

use thiserror::Error;
use tokio::net::TcpListener;
use tokio::runtime::{Builder, Runtime};
use tokio::sync::watch;

use crate::guard::Guard;
use crate::http::{Shared, serve};
use crate::hub::Hub;
use crate::margins::choices;
use crate::metrics::Metrics;
use crate::source::Watch;
use crate::stream::{DeviceInfo, Hello, Limits, SettingInfo, VERSION};
use crate::viewers::Viewers;

/// Most devices: their number has one byte, and each takes threads.
pub const DEVICES_MAX: usize = 64;
/// Longest time for the pages to take leave.
const LEAVE_TIME: Duration = Duration::from_secs(1);

/// Why a server does not start.
#[derive(Debug, Error)]
pub enum ServerError {
    /// The address cannot be used.
    #[error("cannot listen at {0}: {1}; choose another address with --listen")]
    Listen(SocketAddr, io::Error),
    /// There is nothing to show.
    #[error(
        "there is nothing to show: name a device with --port or --bench or a file with --recording, or use --demo"
    )]
    Nothing,
    /// There are too many devices.
    #[error("{0} devices are too many for one page: at most {DEVICES_MAX}")]
    TooMany(usize),
}

/// How a server serves.
#[derive(Clone, Debug)]
pub struct Options {
    /// Where to listen.
    pub listen: SocketAddr,
    /// Whether pages may steer.
    pub steer: bool,
    /// Whether this is the demonstration.
    pub demo: bool,
    /// Folder for recordings.
    pub folder: PathBuf,
}

/// A running server; ends when dropped.
pub struct Server {
    address: SocketAddr,
    shared: Arc<Shared>,
    stop: watch::Sender<bool>,
    runtime: Option<Runtime>,
}

impl Server {
    /// Shows these devices.
    ///
    /// # Errors
    /// [`ServerError`].
    pub fn start(watches: Vec<Watch>, options: &Options) -> Result<Self, ServerError> {
        match watches.len() {
            0 => return Err(ServerError::Nothing),
            many if many > DEVICES_MAX => return Err(ServerError::TooMany(many)),
            _ => {}
        }
        let failed = |error| ServerError::Listen(options.listen, error);
        let runtime =
            Builder::new_multi_thread().worker_threads(1).thread_name("bedside").enable_all().build();
        let runtime = runtime.map_err(failed)?;
        let listener = runtime.block_on(TcpListener::bind(options.listen)).map_err(failed)?;
        let address = listener.local_addr().map_err(failed)?;
        let (stop, stopping) = watch::channel(false);
        let shared = Arc::new(share(watches, options, address, stopping));
        runtime.spawn(serve(listener, Arc::clone(&shared)));
        Ok(Self { address, shared, stop, runtime: Some(runtime) })
    }

    /// The address at which it listens.
    pub fn address(&self) -> SocketAddr {
        self.address
    }

    /// The address for a browser on this computer, with the token if there is one. A browser never sends the part after `#`.
    pub fn url(&self) -> String {
        let token = self.token().map_or_else(String::new, |token| format!("#token={token}"));
        // A server on all interfaces has no address of its own.
        let ip = match self.address.ip() {
            IpAddr::V4(ip) if ip.is_unspecified() => Ipv4Addr::LOCALHOST.into(),
            IpAddr::V6(ip) if ip.is_unspecified() => Ipv6Addr::LOCALHOST.into(),
            ip => ip,
        };
        format!("http://{}/{token}", SocketAddr::new(ip, self.address.port()))
    }

    /// Whether other computers can reach it, over a network on which nothing is encrypted.
    pub fn is_reachable(&self) -> bool {
        self.shared.guard.reading_needs_token()
    }

    /// The token, if there is one.
    pub fn token(&self) -> Option<&str> {
        self.shared.guard.token()
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        self.stop.send_replace(true);
        self.shared.hubs.iter().for_each(Hub::stop);
        if let Some(runtime) = self.runtime.take() {
            runtime.block_on(async {
                let gone = async {
                    while !self.shared.viewers.is_empty() {
                        tokio::time::sleep(Duration::from_millis(10)).await;
                    }
                };
                let _ = tokio::time::timeout(LEAVE_TIME, gone).await;
            });
            runtime.shutdown_timeout(LEAVE_TIME);
        }
    }
}

fn share(
    watches: Vec<Watch>,
    options: &Options,
    address: SocketAddr,
    stopping: watch::Receiver<bool>,
) -> Shared {
    let info = |(id, watch): (u8, &Watch)| DeviceInfo {
        id,
        name: watch.name.clone(),
        kind: watch.kind,
        period_us: watch.period_us,
    };
    let devices: Vec<DeviceInfo> = (0..).zip(&watches).map(info).collect();
    let metrics = Arc::new(Metrics::new(&devices));
    let viewers = Arc::new(Viewers::new(Arc::clone(&metrics)));
    let hub =
        |(id, watch)| Hub::start(id, watch, &options.folder, Arc::clone(&viewers), Arc::clone(&metrics));
    let hubs = (0..).zip(watches).map(hub).collect();
    let Options { steer, demo, .. } = *options;
    let (settings, limits) = (SettingInfo::all(), Limits::default());
    let guard = Guard::new(address, steer);
    let (record, measure) = (guard.token().is_some(), Some(choices()));
    let greeting = Hello { version: VERSION, steer, record, demo, settings, limits, measure, devices };
    Shared { guard, greeting, hubs, viewers, metrics, stopping }
}
