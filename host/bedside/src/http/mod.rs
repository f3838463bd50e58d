//! The HTTP side: static files, `/api/state`, `/api/stream`, `/metrics`. Every request passes the guard.

mod connections;
mod page;
mod socket;

use std::sync::Arc;

use axum::body::Body;
use axum::extract::{Request, State, WebSocketUpgrade};
use axum::http::header::{
    AUTHORIZATION, CACHE_CONTROL, CONTENT_SECURITY_POLICY, CONTENT_TYPE, HOST, HeaderName, ORIGIN,
    REFERRER_POLICY, X_CONTENT_TYPE_OPTIONS,
};
use axum::http::{HeaderMap, HeaderValue, StatusCode};
use axum::middleware::{self, Next};
use axum::response::{IntoResponse, Response};
use axum::routing::get;
use axum::{Extension, Router};
use serde_json::json;
use tokio::sync::watch;

use crate::guard::{self, Guard, Refusal};
use crate::hub::Hub;
use crate::metrics::Metrics;
use crate::stream::{Hello, REQUEST_BYTES};
use crate::viewers::Viewers;

use connections::Place;
pub use connections::{CONNECTIONS_MAX, serve};

/// Headers of every response.
const HEADERS: [(HeaderName, &str); 5] = [
    (CONTENT_SECURITY_POLICY, guard::CONTENT_SECURITY_POLICY),
    (HeaderName::from_static("cross-origin-resource-policy"), "same-origin"),
    (X_CONTENT_TYPE_OPTIONS, "nosniff"),
    (REFERRER_POLICY, "no-referrer"),
    (CACHE_CONTROL, "no-store"),
];
/// From where a browser's request comes, and for what.
const FETCH_SITE: HeaderName = HeaderName::from_static("sec-fetch-site");
const FETCH_MODE: HeaderName = HeaderName::from_static("sec-fetch-mode");
/// Prefix of a token in the header Authorization.
const BEARER: &str = "Bearer ";

/// What all requests share.
pub struct Shared {
    /// The rules.
    pub guard: Guard,
    /// The greeting of every page, with the devices as they were at the start.
    pub greeting: Hello,
    /// The devices' hubs, in order.
    pub hubs: Vec<Hub>,
    /// The open pages.
    pub viewers: Arc<Viewers>,
    /// The numbers.
    pub metrics: Arc<Metrics>,
    /// True when the server ends.
    pub stopping: watch::Receiver<bool>,
}

impl Shared {
    /// The greeting of a page that opens now.
    pub fn hello(&self) -> Hello {
        let mut hello = self.greeting.clone();
        for (info, hub) in hello.devices.iter_mut().zip(&self.hubs) {
            if let Some((kind, period_us)) = hub.latest().device {
                (info.kind, info.period_us) = (kind, period_us);
            }
        }
        hello
    }
}

/// The routes.
pub fn router(shared: Arc<Shared>) -> Router {
    let files = page::FILES.iter().fold(Router::new(), |router, file| {
        router.route(file.path, get(move || async move { file.response() }))
    });
    files
        .route("/api/state", get(state))
        .route("/api/stream", get(stream))
        .route("/metrics", get(metrics))
        .fallback(|| async { (StatusCode::NOT_FOUND, "there is no such page here") })
        .layer(middleware::from_fn_with_state(Arc::clone(&shared), guarded))
        .with_state(shared)
}

/// Checks Host and Origin, and adds the headers to every response, also to a refusal.
async fn guarded(State(shared): State<Arc<Shared>>, request: Request<Body>, next: Next) -> Response {
    let mut response = match check(&shared, request.uri().path(), request.headers()) {
        Ok(()) => next.run(request).await,
        Err(refusal) => refuse(&shared, refusal),
    };
    for (name, value) in HEADERS {
        response.headers_mut().insert(name, HeaderValue::from_static(value));
    }
    response
}

fn check(shared: &Shared, path: &str, headers: &HeaderMap) -> Result<(), Refusal> {
    let text = |name: HeaderName| headers.get(name).map(|value| value.to_str().unwrap_or_default());
    // An Origin that is no text is not ours.
    shared.guard.check(text(HOST), text(ORIGIN))?;
    shared.guard.check_site(path, text(FETCH_SITE), text(FETCH_MODE))
}

fn refuse(shared: &Shared, refusal: Refusal) -> Response {
    shared.metrics.refuse(refusal);
    let status =
        if refusal == Refusal::Crowded { StatusCode::SERVICE_UNAVAILABLE } else { StatusCode::FORBIDDEN };
    (status, refusal.to_string()).into_response()
}

/// Checks the token of a request, if reading needs it.
fn may_read(shared: &Shared, headers: &HeaderMap) -> Result<(), Refusal> {
    if !shared.guard.reading_needs_token() {
        return Ok(());
    }
    let header = headers.get(AUTHORIZATION).and_then(|value| value.to_str().ok());
    shared.guard.check_token(header.and_then(|value| value.strip_prefix(BEARER)).unwrap_or_default())
}

async fn state(State(shared): State<Arc<Shared>>, headers: HeaderMap) -> Response {
    if let Err(refusal) = may_read(&shared, &headers) {
        return refuse(&shared, refusal);
    }
    let states: Vec<serde_json::Value> =
        shared.viewers.states().iter().filter_map(|state| serde_json::from_str(state).ok()).collect();
    let text = json!({ "hello": shared.hello(), "states": states }).to_string();
    ([(CONTENT_TYPE, "application/json")], text).into_response()
}

async fn metrics(State(shared): State<Arc<Shared>>, headers: HeaderMap) -> Response {
    if let Err(refusal) = may_read(&shared, &headers) {
        return refuse(&shared, refusal);
    }
    ([(CONTENT_TYPE, "text/plain; version=0.0.4")], shared.metrics.text()).into_response()
}

async fn stream(
    State(shared): State<Arc<Shared>>,
    Extension(place): Extension<Place>,
    upgrade: WebSocketUpgrade,
) -> Response {
    if shared.viewers.is_full() {
        return refuse(&shared, Refusal::Crowded);
    }
    upgrade
        .max_message_size(REQUEST_BYTES)
        .max_frame_size(REQUEST_BYTES)
        .on_upgrade(move |socket| socket::serve(shared, socket, place))
}
