//! The connections of the server: a bounded number, also from one computer, none of which may take its time with its request.

use std::collections::BTreeMap;
use std::convert::Infallible;
use std::net::{IpAddr, SocketAddr};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use axum::{Extension, Router};
use hyper::server::conn::http1;
use hyper_util::rt::{TokioIo, TokioTimer};
use hyper_util::service::TowerToHyperService;
use tokio::net::{TcpListener, TcpStream};

use super::{Shared, router};
use crate::guard::Refusal;

/// Most connections: each page has one, and a few more for files.
pub const CONNECTIONS_MAX: usize = 128;
/// Most connections from another computer, so that one without the token cannot take the places of all others.
const PER_ADDRESS_MAX: usize = 32;
/// Longest time for the head of a request, also of the next one on an idle connection.
const HEAD_TIME: Duration = Duration::from_secs(5);
/// Pause after a connection could not be accepted, as if the program has too many files open.
const PAUSE: Duration = Duration::from_millis(100);

/// A connection's place among all, which it keeps until it ends, also as a WebSocket.
#[derive(Clone, Debug)]
pub struct Place {
    /// The other end.
    pub from: SocketAddr,
    _taken: Arc<Taken>,
}

/// The places that are taken, by address.
#[derive(Clone, Debug, Default)]
struct Places(Arc<Mutex<BTreeMap<IpAddr, usize>>>);

/// A place that is free again when this is dropped.
#[derive(Debug)]
struct Taken {
    places: Places,
    address: IpAddr,
}

impl Places {
    /// Takes a place for a connection from there; none if there is none.
    fn take(&self, from: SocketAddr) -> Option<Place> {
        let address = from.ip();
        let mut taken = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let own = taken.get(&address).copied().unwrap_or_default();
        let most = if address.is_loopback() { CONNECTIONS_MAX } else { PER_ADDRESS_MAX };
        if own >= most || taken.values().sum::<usize>() >= CONNECTIONS_MAX {
            return None;
        }
        taken.insert(address, own + 1);
        Some(Place { from, _taken: Arc::new(Taken { places: self.clone(), address }) })
    }
}

impl Drop for Taken {
    fn drop(&mut self) {
        let mut taken = self.places.0.lock().unwrap_or_else(PoisonError::into_inner);
        match taken.get_mut(&self.address) {
            Some(own) if *own > 1 => *own -= 1,
            _ => _ = taken.remove(&self.address),
        }
    }
}

/// Accepts connections until the server ends.
pub async fn serve(listener: TcpListener, shared: Arc<Shared>) -> Infallible {
    let places = Places::default();
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
        if let Some(place) = places.take(from) {
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

#[cfg(test)]
mod tests {
    use super::*;

    fn places(places: &Places, address: &str, count: usize) -> Vec<Place> {
        (0..count).map_while(|_| places.take(format!("{address}:4000").parse().unwrap())).collect()
    }

    #[test]
    fn another_computer_gets_some_places_and_this_one_all_that_are_left() {
        let all = Places::default();
        let one = places(&all, "192.0.2.1", 200);
        let other = places(&all, "192.0.2.2", 200);
        let own = places(&all, "127.0.0.1", 200);
        assert_eq!([&one, &other, &own].map(Vec::len), [32, 32, CONNECTIONS_MAX - 64]);
        assert!(places(&all, "192.0.2.3", 1).is_empty(), "all are taken");
        drop(one);
        assert_eq!(
            places(&all, "192.0.2.3", 200).len(),
            32,
            "a place is free again when its connection ends"
        );
        assert!(places(&all, "192.0.2.2", 1).is_empty());
    }
}
