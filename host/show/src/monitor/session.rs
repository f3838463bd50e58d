//! A device that is watched: a thread that owns the connection, passes on what comes, asks what it is told to, and looks
//! at the device once a second.
//!
//! It only reads and switches telemetry on, again and again, since a device that was restarted has it off. When the line
//! breaks it opens it again; requests from the meantime are answered as not sent, so that nothing late reaches a device.

use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, TryRecvError, channel};
use std::thread;
use std::time::{Duration, Instant};

use shared::link::messages::Request;

use super::news::News;
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

/// The monitor has gone.
struct Gone;

struct Watcher {
    device: Device,
    requested: Receiver<Request>,
    told: Sender<News>,
}

impl Watcher {
    fn run(mut self) {
        while self.watch().is_ok() {}
        // If it does not answer, it goes on sending to nobody, which does it no harm.
        let _ = self.device.telemetry(false);
    }

    /// Watches until the line breaks, and opens it again.
    fn watch(&mut self) -> Result<(), Gone> {
        let reason = self.watch_line()?;
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
    fn wait_without_line(&mut self) -> Result<(), Gone> {
        let deadline = Instant::now() + TRY_EVERY;
        loop {
            match self.requested.recv_timeout(deadline.saturating_duration_since(Instant::now())) {
                Ok(request) => self.refuse(request)?,
                Err(RecvTimeoutError::Timeout) => return Ok(()),
                Err(RecvTimeoutError::Disconnected) => return Err(Gone),
            }
        }
    }

    fn refuse(&self, request: Request) -> Result<(), Gone> {
        self.tell(News::Answer { request, result: Err("no connection: nothing was sent".to_owned()) })
    }

    /// Gives the reason why the line can be used no longer.
    fn watch_line(&mut self) -> Result<DeviceError, Gone> {
        let mut next_poll = Instant::now();
        loop {
            if Instant::now() >= next_poll {
                next_poll = Instant::now() + POLL_EVERY;
                for request in POLLED {
                    if let Some(broken) = self.ask(request)? {
                        return self.give_up(broken);
                    }
                }
                self.tell(News::Traffic(self.device.counters()))?;
            }
            self.pass_events()?;
            match self.requested.recv_timeout(PASS_EVERY) {
                Ok(request) => {
                    if let Some(broken) = self.ask(request)? {
                        return self.give_up(broken);
                    }
                }
                Err(RecvTimeoutError::Timeout) => {}
                Err(RecvTimeoutError::Disconnected) => return Err(Gone),
            }
        }
    }

    /// Refuses the requests that were waiting: a key pressed before the reconnection referred to the state at that time.
    fn give_up(&mut self, reason: DeviceError) -> Result<DeviceError, Gone> {
        loop {
            match self.requested.try_recv() {
                Ok(request) => self.refuse(request)?,
                Err(TryRecvError::Empty) => return Ok(reason),
                Err(TryRecvError::Disconnected) => return Err(Gone),
            }
        }
    }

    /// Asks and tells the answer; gives the error after which the line must be opened anew.
    fn ask(&mut self, request: Request) -> Result<Option<DeviceError>, Gone> {
        let (result, broken) = match self.device.request(&request) {
            Ok(response) => (Ok(response), None),
            Err(error @ (DeviceError::Refused(_) | DeviceError::Unexpected)) => {
                (Err(error.to_string()), None)
            }
            Err(error) => (Err(error.to_string()), Some(error)),
        };
        self.tell(News::Answer { request, result })?;
        // After the answer, which may be older than an alarm that came meanwhile.
        self.pass_events()?;
        Ok(broken)
    }

    fn pass_events(&self) -> Result<(), Gone> {
        self.device
            .events()
            .try_iter()
            .take(EVENTS_AT_ONCE)
            .try_for_each(|event| self.tell(News::Event(event)))
    }

    fn tell(&self, news: News) -> Result<(), Gone> {
        self.told.send(news).map_err(|_| Gone)
    }
}
