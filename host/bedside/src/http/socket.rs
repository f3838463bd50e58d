//! The WebSocket of one page: its messages to the hubs, its queue to the socket. A page that sends too much, or nothing that can be
//! read, is closed; one that takes nothing for long is closed, too.

use std::error::Error;
use std::sync::Arc;
use std::time::{Duration, Instant};

use axum::body::Bytes;
use axum::extract::ws::{CloseFrame, Message, Utf8Bytes, WebSocket, close_code};
use tokio::time::{MissedTickBehavior, timeout};
use tokio_tungstenite::tungstenite;

use super::Shared;
use super::connections::Place;
use crate::guard::Refusal;
use crate::hub::Command;
use crate::steer::SteerError;
use crate::stream::{Answer, FromPage, REQUESTS_PER_SECOND, ToPage};
use crate::viewers::{Outgoing, Viewer};

/// Longest time for the token, if it is needed.
const PATIENCE: Duration = Duration::from_secs(10);
/// Interval of the pings, which a browser answers by itself.
const PING_EVERY: Duration = Duration::from_secs(2);
/// Longest time that a page is silent, or takes no message: then its computer is gone, and it must not keep a device.
const SILENCE_MAX: Duration = Duration::from_secs(6);
/// Most messages of a page that cannot be read.
const MALFORMED_MAX: u32 = 10;

/// Why a page is closed.
enum End {
    /// The connection is gone.
    Gone,
    /// The server ends.
    Stopping,
    /// The page must start again.
    Outdated,
    /// The page broke a rule.
    Refused(Refusal),
}

/// Serves a page until it is closed.
pub async fn serve(shared: Arc<Shared>, mut socket: WebSocket, place: Place) {
    if shared.guard.reading_needs_token()
        && let Err(refusal) = wait_for_token(&shared, &mut socket).await
    {
        shared.metrics.refuse(refusal);
        close(&mut socket, close_code::POLICY, &refusal.to_string()).await;
        return;
    }
    let hello = ToPage::Hello(shared.hello()).to_json();
    let Ok(()) = send(&mut socket, Message::Text(hello.into())).await else { return };
    let Some(viewer) = shared.viewers.add(&place.from.ip().to_string(), shared.hubs.len() as u8) else {
        shared.metrics.refuse(Refusal::Crowded);
        close(&mut socket, close_code::AGAIN, &Refusal::Crowded.to_string()).await;
        return;
    };
    greet(&shared, &viewer);
    let mut page = Page::new(Arc::clone(&shared), Arc::clone(&viewer));
    let end = page.run(&mut socket).await;
    shared.viewers.remove(viewer.number);
    shared.hubs.iter().for_each(|hub| hub.send(Command::Gone { viewer: viewer.number }));
    match end {
        End::Gone => {}
        End::Outdated => {
            shared.metrics.refuse(Refusal::Outdated);
            close(&mut socket, close_code::AGAIN, &Refusal::Outdated.to_string()).await;
        }
        End::Stopping => close(&mut socket, close_code::AWAY, "the server ends").await,
        End::Refused(refusal) => {
            shared.metrics.refuse(refusal);
            close(&mut socket, close_code::POLICY, &refusal.to_string()).await;
        }
    }
}

/// Waits for the token as the first message.
async fn wait_for_token(shared: &Shared, socket: &mut WebSocket) -> Result<(), Refusal> {
    let Ok(Some(Ok(Message::Text(text)))) = timeout(PATIENCE, socket.recv()).await else {
        return Err(Refusal::Token);
    };
    match FromPage::parse(&text) {
        Ok(FromPage::Token { token }) => shared.guard.check_token(&token.0),
        _ => Err(Refusal::Token),
    }
}

/// Queues what is known about all devices beside their states.
fn greet(shared: &Shared, viewer: &Arc<Viewer>) {
    for (device, hub) in (0..).zip(&shared.hubs) {
        if let Some((_, who)) = hub.latest().steerer {
            viewer.send(ToPage::Steerer { device, who: Some(who), yours: false }.to_json().into());
        }
        hub.send(Command::Opened { viewer: Arc::clone(viewer) });
    }
}

/// A page that is served.
struct Page {
    shared: Arc<Shared>,
    viewer: Arc<Viewer>,
    /// Whether it has shown the token: then it may record, and steer if the server allows that.
    trusted: bool,
    malformed: u32,
    /// Start of the running second, and messages in it.
    second: Instant,
    messages: u32,
}

impl Page {
    fn new(shared: Arc<Shared>, viewer: Arc<Viewer>) -> Self {
        let trusted = shared.guard.reading_needs_token();
        Self { shared, viewer, trusted, malformed: 0, second: Instant::now(), messages: 0 }
    }

    async fn run(&mut self, socket: &mut WebSocket) -> End {
        let mut stopping = self.shared.stopping.clone();
        let stop = async move { _ = stopping.wait_for(|stopping| *stopping).await };
        tokio::pin!(stop);
        let (mut pings, mut heard) = (tokio::time::interval(PING_EVERY), Instant::now());
        pings.set_missed_tick_behavior(MissedTickBehavior::Delay);
        loop {
            // In this order: a pong that waits must be seen before the silence is judged. A page that floods is closed.
            tokio::select! {
                biased;
                () = &mut stop => return End::Stopping,
                received = socket.recv() => {
                    heard = Instant::now();
                    if let Err(end) = self.received(received) {
                        return end;
                    }
                }
                _ = pings.tick() => {
                    if heard.elapsed() > SILENCE_MAX || send(socket, Message::Ping(Bytes::new())).await.is_err() {
                        return End::Gone;
                    }
                }
                outgoing = self.viewer.next() => {
                    let message = match outgoing {
                        Some(Outgoing::Text(text)) => Message::Text(Utf8Bytes::from(text.as_ref())),
                        Some(Outgoing::Binary(bytes)) => Message::Binary(bytes.into()),
                        None => return End::Outdated,
                    };
                    if send(socket, message).await.is_err() {
                        return End::Gone;
                    }
                }
            }
        }
    }

    fn received(&mut self, received: Option<Result<Message, axum::Error>>) -> Result<(), End> {
        match received {
            Some(Ok(message)) => self.take(&message),
            Some(Err(error)) if is_malformed(&error) => Err(End::Refused(Refusal::Malformed)),
            Some(Err(_)) | None => Err(End::Gone),
        }
    }

    /// Takes a message of the page.
    fn take(&mut self, message: &Message) -> Result<(), End> {
        self.count()?;
        match message {
            Message::Text(text) => match FromPage::parse(text) {
                Ok(message) => self.obey(message),
                Err(_) => self.complain(),
            },
            Message::Binary(_) => self.complain(),
            Message::Close(_) => Err(End::Gone),
            Message::Ping(_) | Message::Pong(_) => Ok(()),
        }
    }

    /// Counts a message against the rate.
    fn count(&mut self) -> Result<(), End> {
        if self.second.elapsed() >= Duration::from_secs(1) {
            (self.second, self.messages) = (Instant::now(), 0);
        }
        self.messages += 1;
        if self.messages > REQUESTS_PER_SECOND { Err(End::Refused(Refusal::Flood)) } else { Ok(()) }
    }

    /// Answers a message that cannot be read.
    fn complain(&mut self) -> Result<(), End> {
        self.malformed += 1;
        if self.malformed >= MALFORMED_MAX {
            return Err(End::Refused(Refusal::Malformed));
        }
        self.shared.metrics.refuse(Refusal::Malformed);
        self.answer(Answer::refused(None, Refusal::Malformed.to_string()));
        Ok(())
    }

    fn obey(&mut self, message: FromPage) -> Result<(), End> {
        match &message {
            FromPage::Token { token } => return self.token(&token.0),
            FromPage::Watch { devices } => {
                self.viewer.watch(devices.iter().copied());
                return Ok(());
            }
            _ => {}
        }
        let hub = message.device().and_then(|device| self.shared.hubs.get(usize::from(device)));
        let Some(hub) = hub else {
            self.answer(Answer::refused(message.id(), "there is no such device"));
            return Ok(());
        };
        if !self.may(&message) {
            self.answer(Answer::refused(message.id(), SteerError::ReadOnly.to_string()));
            return Ok(());
        }
        hub.send(Command::Message { viewer: Arc::clone(&self.viewer), message });
        Ok(())
    }

    /// Whether a page like this may ask for that.
    fn may(&self, message: &FromPage) -> bool {
        match message {
            FromPage::Drawn { .. } => true,
            // The device does not notice.
            FromPage::Mark { .. }
            | FromPage::Record { .. }
            | FromPage::Capture { .. }
            | FromPage::Recorder { .. } => self.trusted,
            _ => self.trusted && self.shared.guard.steer(),
        }
    }

    fn token(&mut self, token: &str) -> Result<(), End> {
        self.shared.guard.check_token(token).map_err(End::Refused)?;
        self.trusted = true;
        Ok(())
    }

    fn answer(&self, answer: Answer) {
        self.viewer.send(ToPage::Answer(answer).to_json().into());
    }
}

/// Whether the page has sent what no page may send: a message that is too long, or no text.
fn is_malformed(error: &axum::Error) -> bool {
    matches!(
        error.source().and_then(|cause| cause.downcast_ref()),
        Some(tungstenite::Error::Capacity(_) | tungstenite::Error::Utf8(_))
    )
}

/// Sends a message; an error if the page does not take it.
async fn send(socket: &mut WebSocket, message: Message) -> Result<(), End> {
    match timeout(SILENCE_MAX, socket.send(message)).await {
        Ok(Ok(())) => Ok(()),
        _ => Err(End::Gone),
    }
}

/// Says why, if the page still listens.
async fn close(socket: &mut WebSocket, code: u16, reason: &str) {
    let frame = CloseFrame { code, reason: reason.into() };
    let _ = timeout(PATIENCE, socket.send(Message::Close(Some(frame)))).await;
}
