//! The connections of the server: a bounded number, none of which may take its time with its request.

use std::convert::Infallible;
use std::net::SocketAddr;
use std::sync::Arc;
use std::time::Duration;

use axum::{Extension, Router};
use hyper::server::conn::http1;
use hyper_util::rt::{TokioIo, TokioTimer};
use hyper_util::service::TowerToHyperService;
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::{OwnedSemaphorePermit, Semaphore};

use super::{Shared, router};
use crate::guard::Refusal;

/// Most connections: each page has one, and a few more for files.
pub const CONNECTIONS_MAX: usize = 128;
/// Longest time for the head of a request, also of the next one on an idle connection.
const HEAD_TIME: Duration = Duration::from_secs(5);
/// Pause after a connection could not be accepted, as if the program has too many files open.
const PAUSE: Duration = Duration::from_millis(100);

/// A connection's place among all, which it keeps until it ends, also as a WebSocket.
#[derive(Clone, Debug)]
pub struct Place {
    /// The other end.
    pub from: SocketAddr,
    _permit: Arc<OwnedSemaphorePermit>,
}

/// Accepts connections until the server ends.
pub async fn serve(listener: TcpListener, shared: Arc<Shared>) -> Infallible {
    let places = Arc::new(Semaphore::new(CONNECTIONS_MAX));
    let service = router(Arc::clone(&shared));
    loop {
        let (stream, from) = match listener.accept().await {
            Ok(accepted) => accepted,
            Err(error) => {
                tracing::debug!(%error, "a connection could not be accepted");
                tokio::time::sleep(PAUSE).await;
                continue;
            }
        };
        if let Ok(permit) = Arc::clone(&places).try_acquire_owned() {
            let place = Place { from, _permit: Arc::new(permit) };
            tokio::spawn(talk(stream, place, service.clone()));
        } else {
            // One that is too many is closed at once.
            shared.metrics.refuse(Refusal::Crowded);
        }
    }
}

/// Serves a connection.
async fn talk(stream: TcpStream, place: Place, service: Router) {
    // Samples are small and must not wait for the acknowledgement of earlier ones.
    if let Err(error) = stream.set_nodelay(true) {
        tracing::debug!(%error, "a connection may be slow");
    }
    let service = TowerToHyperService::new(service.layer(Extension(place)));
    let connection = http1::Builder::new()
        .timer(TokioTimer::new())
        .header_read_timeout(HEAD_TIME)
        .serve_connection(TokioIo::new(stream), service)
        .with_upgrades();
    if let Err(error) = connection.await {
        tracing::debug!(%error, "a connection has ended");
    }
}
