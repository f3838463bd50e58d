//! A session with a device: a thread that owns the connection, forwards news, sends requests, and polls the device once
//! a second.
//!
//! By itself it only reads (which also renews the lease if a key has acquired it), and repeatedly switches telemetry on, because a restarted device has it off. If the line
//! breaks, the thread reopens it; requests meanwhile are answered as not sent, so that none reaches a device late.

use std::convert::Infallible;
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, channel};
use std::thread;
use std::time::{Duration, Instant};

use shared::link::messages::{Request, Response};

use super::News;
use device::{Device, DeviceError};

/// Interval between polls of the device.
const POLL_EVERY: Duration = Duration::from_secs(1);
/// Interval at which news are forwarded.
const PASS_EVERY: Duration = Duration::from_millis(10);
/// Interval between attempts to reopen a broken line.
const TRY_EVERY: Duration = Duration::from_millis(500);
/// Longest time that quitting waits for the telemetry to be switched off.
const LEAVE_TIME: Duration = Duration::from_secs(1);
/// Largest number of events forwarded between two checks for requests.
const EVENTS_AT_ONCE: usize = 1000;
/// Requests of a poll. Their answers also reveal restarts; the greeting comes first and gives the cause.
const POLLED: [Request; 7] = [
    Request::Identify,
    Request::Telemetry { on: true },
    Request::GetSettings,
    Request::GetAlarms,
    Request::GetAudio,
    Request::GetLease,
    Request::GetTiming { clear: false },
];

/// The monitor's end of a session.
#[derive(Debug)]
pub struct Session {
    requests: Sender<Request>,
    news: Receiver<News>,
}

impl Session {
    /// Starts a session with a device in its own thread.
    pub fn start(device: Device) -> Self {
        let (requests, requested) = channel();
        let (told, news) = channel();
        thread::spawn(move || Watcher { device, requested, told }.run());
        Self { requests, news }
    }

    /// Sends a request to the device; the answer arrives as news.
    pub fn ask(&self, request: Request) {
        // The thread lives as long as this end.
        let _ = self.requests.send(request);
    }

    /// The news received so far.
    pub fn news(&self) -> impl Iterator<Item = News> + '_ {
        self.news.try_iter()
    }

    /// Waits for the next piece of news.
    pub fn next(&self, patience: Duration) -> Option<News> {
        self.news.recv_timeout(patience).ok()
    }

    /// Switches the telemetry off, if the device answers immediately, and changes nothing else.
    pub fn leave(self) {
        let Self { requests, news } = self;
        drop(requests);
        let deadline = Instant::now() + LEAVE_TIME;
        // The thread ends by dropping its end of the channel.
        while news.recv_timeout(deadline.saturating_duration_since(Instant::now())).is_ok() {}
    }
}

/// Why a session's line is no longer used.
enum End {
    /// The monitor has ended.
    Gone,
    /// The line must be reopened.
    Broken(DeviceError),
}

struct Watcher {
    device: Device,
    requested: Receiver<Request>,
    told: Sender<News>,
}

impl Watcher {
    fn run(mut self) {
        loop {
            let Err(end) = self.watch_line();
            match end {
                End::Broken(reason) if self.reopen(&reason).is_ok() => {}
                _ => break,
            }
        }
        // If the device does not answer, it keeps sending telemetry without a reader, which is harmless.
        let _ = self.device.telemetry(false);
    }

    /// Refuses waiting requests, because a key pressed before the reconnection referred to the state at that time, and
    /// tries until the line is open again.
    fn reopen(&mut self, reason: &DeviceError) -> Result<(), End> {
        while let Ok(request) = self.requested.try_recv() {
            self.refuse(request)?;
        }
        self.tell(News::Lost(reason.to_string()))?;
        loop {
            self.wait_without_line()?;
            match self.device.reconnect() {
                Ok(()) => return Ok(()),
                Err(reason) => self.tell(News::Lost(reason.to_string()))?,
            }
        }
    }

    /// Refuses requests for one retry interval.
    fn wait_without_line(&mut self) -> Result<(), End> {
        let deadline = Instant::now() + TRY_EVERY;
        loop {
            match self.requested.recv_timeout(deadline.saturating_duration_since(Instant::now())) {
                Ok(request) => self.refuse(request)?,
                Err(RecvTimeoutError::Timeout) => return Ok(()),
                Err(RecvTimeoutError::Disconnected) => return Err(End::Gone),
            }
        }
    }

    fn refuse(&self, request: Request) -> Result<(), End> {
        self.tell(News::Answer { request, result: Err("no connection: nothing was sent".to_owned()) })
    }

    fn watch_line(&mut self) -> Result<Infallible, End> {
        let mut next_poll = Instant::now();
        loop {
            if Instant::now() >= next_poll {
                next_poll = Instant::now() + POLL_EVERY;
                POLLED.into_iter().try_for_each(|request| self.ask(request))?;
                self.tell(News::Traffic(self.device.counters()))?;
            }
            self.pass_events()?;
            match self.requested.recv_timeout(PASS_EVERY) {
                Ok(request) => self.ask(request)?,
                Err(RecvTimeoutError::Timeout) => {}
                Err(RecvTimeoutError::Disconnected) => return Err(End::Gone),
            }
        }
    }

    /// Sends a request and forwards the answer.
    fn ask(&mut self, request: Request) -> Result<(), End> {
        let answer = match request {
            // A key pressed soon after the device's start waits for its self-test.
            Request::Start => self.device.start().map(Response::Mode),
            _ => self.device.request(&request),
        };
        let result = answer.as_ref().cloned().map_err(ToString::to_string);
        self.tell(News::Answer { request, result })?;
        // After the answer, which may be older than an alarm that arrived in the meantime.
        self.pass_events()?;
        match answer {
            Ok(_) | Err(DeviceError::Refused(_) | DeviceError::Unexpected) => Ok(()),
            Err(broken) => Err(End::Broken(broken)),
        }
    }

    fn pass_events(&self) -> Result<(), End> {
        self.device
            .events()
            .try_iter()
            .take(EVENTS_AT_ONCE)
            .try_for_each(|event| self.tell(News::Event(event)))
    }

    fn tell(&self, news: News) -> Result<(), End> {
        self.told.send(news).map_err(|_| End::Gone)
    }
}
