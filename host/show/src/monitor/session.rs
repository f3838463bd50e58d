//! A device that is watched: a thread that owns the connection, passes on what comes, asks what it is told to, and looks
//! at the device once a second.
//!
//! It only reads and switches telemetry on, again and again, since a device that was restarted has it off. When the line
//! breaks it opens it again; requests from the meantime are answered as not sent, so that nothing late reaches a device.

use std::convert::Infallible;
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, channel};
use std::thread;
use std::time::{Duration, Instant};

use shared::link::messages::Request;

use super::News;
use device::{Device, DeviceError};

/// How often the device is looked at.
const POLL_EVERY: Duration = Duration::from_secs(1);
/// How often what came is passed on.
const PASS_EVERY: Duration = Duration::from_millis(10);
/// How often a broken line is tried again.
const TRY_EVERY: Duration = Duration::from_millis(500);
/// How long an operator who leaves waits for the telemetry to be switched off.
const LEAVE_TIME: Duration = Duration::from_secs(1);
/// Most events passed on between two looks at the requests.
const EVENTS_AT_ONCE: usize = 1000;
/// What a look at the device asks. Its answers tell of restarts too; the greeting comes first and names the cause.
const POLLED: [Request; 4] = [
    Request::Identify,
    Request::Telemetry { on: true },
    Request::GetSettings,
    Request::GetTiming { clear: false },
];

/// The watching side's end.
#[derive(Debug)]
pub struct Session {
    requests: Sender<Request>,
    news: Receiver<News>,
}

impl Session {
    /// Watches a device from a thread of its own.
    pub fn start(device: Device) -> Self {
        let (requests, requested) = channel();
        let (told, news) = channel();
        thread::spawn(move || Watcher { device, requested, told }.run());
        Self { requests, news }
    }

    /// Has the device asked; the answer comes as news.
    pub fn ask(&self, request: Request) {
        // The thread lives as long as this end does.
        let _ = self.requests.send(request);
    }

    /// What came so far.
    pub fn news(&self) -> impl Iterator<Item = News> + '_ {
        self.news.try_iter()
    }

    /// Waits for the next piece of news.
    pub fn next(&self, patience: Duration) -> Option<News> {
        self.news.recv_timeout(patience).ok()
    }

    /// Switches the telemetry off, if the device answers at once, and nothing else.
    pub fn leave(self) {
        let Self { requests, news } = self;
        drop(requests);
        let deadline = Instant::now() + LEAVE_TIME;
        // The thread ends by letting go of its end of the channel.
        while news.recv_timeout(deadline.saturating_duration_since(Instant::now())).is_ok() {}
    }
}

/// Why a line is watched no longer.
enum End {
    /// The monitor has gone.
    Gone,
    /// The line must be opened again.
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
        // If it does not answer, it goes on sending to nobody, which does it no harm.
        let _ = self.device.telemetry(false);
    }

    /// Refuses the requests that were waiting, since a key pressed before the reconnection referred to the state at that
    /// time, and tries until the line is open again.
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

    /// Refuses requests for a moment.
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

    /// Asks and tells the answer.
    fn ask(&mut self, request: Request) -> Result<(), End> {
        let answer = self.device.request(&request);
        let result = answer.as_ref().cloned().map_err(ToString::to_string);
        self.tell(News::Answer { request, result })?;
        // After the answer, which may be older than an alarm that came meanwhile.
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
