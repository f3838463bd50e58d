//! A session with a device: a thread that owns the connection, forwards news, sends requests, and polls the device once
//! a second.
//!
//! By itself it only reads (which also renews the lease if a request has acquired it), and repeatedly switches telemetry on, because a restarted device has it off. If the line
//! breaks, the thread reopens it; requests meanwhile are answered as not sent, so that none reaches a device late.
//! Events are forwarded also while an answer is awaited, so that a lost frame delays no waveform and no alarm. A stop overtakes
//! the requests that wait, and cancels a start among them.

use std::collections::VecDeque;
use std::convert::Infallible;
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, channel};
use std::thread;
use std::time::{Duration, Instant};

use monitoring::POLLED;
use shared::link::messages::Request;

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
/// Why there are no news if the thread has ended by itself.
const ENDED: &str = "the session with the device has failed; start this program again";
/// Answer to a start that a stop has overtaken.
const CANCELLED: &str = "not started: a stop was requested after it";
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
        let (reports, news) = channel();
        thread::spawn(move || Watcher { device, requested, queue: VecDeque::new(), news: reports }.run());
        Self { requests, news }
    }

    /// Sends a request to the device; the answer arrives as news.
    pub fn ask(&self, request: Request) {
        // The thread lives as long as this end.
        let _ = self.requests.send(request);
    }

    /// Waits for the next piece of news; says so if the session has failed.
    pub fn next(&self, patience: Duration) -> Option<News> {
        match self.news.recv_timeout(patience) {
            Ok(news) => Some(news),
            Err(RecvTimeoutError::Timeout) => None,
            Err(RecvTimeoutError::Disconnected) => {
                // A panic has ended the thread; a reader that waits for news must neither spin nor believe that all is well.
                thread::sleep(patience);
                (!patience.is_zero()).then(|| News::Lost(ENDED.to_owned()))
            }
        }
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
    /// Requests that wait for their turn.
    queue: VecDeque<Request>,
    news: Sender<News>,
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

    /// Refuses waiting requests, because a request from before the reconnection referred to the state at that time, and
    /// tries until the line is open again.
    fn reopen(&mut self, reason: &DeviceError) -> Result<(), End> {
        self.queue.extend(self.requested.try_iter());
        for request in std::mem::take(&mut self.queue) {
            self.refuse(request)?;
        }
        self.report(News::Lost(reason.to_string()))?;
        loop {
            self.wait_without_line()?;
            match self.device.reconnect() {
                Ok(()) => return Ok(()),
                Err(reason) => self.report(News::Lost(reason.to_string()))?,
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
        self.report(News::Answer { request, result: Err("no connection: nothing was sent".to_owned()) })
    }

    fn watch_line(&mut self) -> Result<Infallible, End> {
        let mut next_poll = Instant::now();
        loop {
            if Instant::now() >= next_poll {
                next_poll = Instant::now() + POLL_EVERY;
                for request in POLLED {
                    self.ask(request)?;
                    // A line that loses frames makes a poll slow.
                    self.ask_queued()?;
                }
                self.report(News::Traffic(self.device.counters()))?;
            }
            self.pass_events()?;
            match self.requested.recv_timeout(PASS_EVERY) {
                Ok(request) => {
                    self.queue.push_back(request);
                    self.ask_queued()?;
                }
                Err(RecvTimeoutError::Timeout) => {}
                Err(RecvTimeoutError::Disconnected) => return Err(End::Gone),
            }
        }
    }

    /// Sends the requests that wait.
    fn ask_queued(&mut self) -> Result<(), End> {
        loop {
            self.queue.extend(self.requested.try_iter());
            let (next, cancelled) = next_request(&mut self.queue);
            for request in cancelled {
                self.report(News::Answer { request, result: Err(CANCELLED.to_owned()) })?;
            }
            let Some(request) = next else { return Ok(()) };
            self.ask(request)?;
        }
    }

    /// Sends a request, once, and forwards the answer.
    fn ask(&mut self, request: Request) -> Result<(), End> {
        let news = &self.news;
        // A monitor that has ended is noticed with the answer.
        let answer = self.device.request_passing(&request, &mut |event| _ = news.send(News::Event(event)));
        let result = answer.as_ref().cloned().map_err(ToString::to_string);
        self.report(News::Answer { request, result })?;
        // After the answer, which may be older than an alarm that arrived in the meantime.
        self.pass_events()?;
        match answer {
            Ok(_)
            | Err(
                DeviceError::Refused(_)
                | DeviceError::Unknown(_)
                | DeviceError::Unexpected { .. }
                | DeviceError::Settings(_),
            ) => Ok(()),
            Err(broken) => Err(End::Broken(broken)),
        }
    }

    fn pass_events(&mut self) -> Result<(), End> {
        for _ in 0..EVENTS_AT_ONCE {
            let Some(event) = self.device.next_event() else { break };
            self.report(News::Event(event))?;
        }
        Ok(())
    }

    fn report(&self, news: News) -> Result<(), End> {
        self.news.send(news).map_err(|_| End::Gone)
    }
}

/// The next request, and the starts that it cancels: a stop overtakes all others.
fn next_request(queue: &mut VecDeque<Request>) -> (Option<Request>, Vec<Request>) {
    let Some(stop) = queue.iter().position(|request| *request == Request::Stop) else {
        return (queue.pop_front(), Vec::new());
    };
    let (cancelled, earlier): (Vec<_>, Vec<_>) =
        queue.drain(..stop).partition(|request| *request == Request::Start);
    let next = queue.pop_front();
    earlier.into_iter().rev().for_each(|request| queue.push_front(request));
    (next, cancelled)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn queue(requests: &[Request]) -> VecDeque<Request> {
        requests.iter().cloned().collect()
    }

    #[test]
    fn a_stop_overtakes_the_requests_that_wait_and_cancels_the_starts_before_it() {
        let mut waiting =
            queue(&[Request::Start, Request::GetAlarms, Request::Stop, Request::Start, Request::GetAudio]);
        assert_eq!(next_request(&mut waiting), (Some(Request::Stop), vec![Request::Start]));
        assert_eq!(waiting, queue(&[Request::GetAlarms, Request::Start, Request::GetAudio]));
        assert_eq!(next_request(&mut waiting), (Some(Request::GetAlarms), vec![]));
    }

    #[test]
    fn a_session_whose_thread_has_ended_says_so_and_does_not_spin() {
        let (reports, news) = channel();
        drop(reports);
        let session = Session { requests: channel().0, news };
        let (patience, before) = (Duration::from_millis(20), Instant::now());
        assert_eq!(session.next(patience), Some(News::Lost(ENDED.to_owned())));
        assert!(before.elapsed() >= patience);
        assert_eq!(session.next(Duration::ZERO), None);
    }
}
