//! A real device at the page's computer: the page carries bytes between its port and here.
//!
//! The rules are those of a session of the server: read first and push nothing; a request without an answer is repeated with the same
//! sequence number; a request that changes the device acquires the lease; a stop overtakes what waits and cancels a start; a host that
//! steered must take control again after the line was lost.

use std::collections::VecDeque;

use bedside::steer::{self, Wheel};
use bedside::stream::{Answer, DeviceInfo, EventKind, FromPage, Kind, ToPage};
use bedside::watched::{Out, Watched};
use monitoring::{News, POLLED};
use shared::breath::DEFAULT_PERIOD_US;
use shared::link::PROTOCOL;
use shared::link::host_name::HostName;
use shared::link::messages::{Request, Response, ToHost};
use shared::link::refusal::Refusal;

use crate::line::Line;
use crate::page::{Message, Shown, VIEWER, hand_on, hello};

/// The only device's number, and the name of the page for other hosts.
const DEVICE: u8 = 0;
const PAGE: &str = "a page in a browser";
/// Longest time for an answer before the request is repeated, ms, and how often it is sent.
const ANSWER_MS: u64 = 1500;
const ATTEMPTS: u8 = 4;
/// Intervals between polls, and to the next one after the device was silent, ms.
const POLL_MS: u64 = 1000;
const TRY_MS: u64 = 500;
/// Interval between attempts to start while the self-test runs, ms, and their number.
const START_MS: u64 = 200;
const STARTS: u8 = 150;
/// Texts for the page.
const SILENT: &str =
    "the board does not answer: check its power and firmware, and that its port is the one you chose";
const UNPLUGGED: &str = "the board is unplugged: plug it in and press Connect a board";
const NOT_SENT: &str = "no connection: nothing was sent";
const CANCELLED: &str = "not started: a stop was requested after it";
const NO_FILES: &str =
    "a page without a server writes no files: run `cargo trainer serve --port PORT` to record";

/// A request that waits.
struct Asked {
    request: Request,
    /// Number of the page's message, if it has asked.
    id: Option<u32>,
    /// How often the device has put it off.
    tries: u8,
    /// The request for which this one acquires the lease.
    then: Option<Box<Asked>>,
}

impl Asked {
    fn own(request: Request) -> Self {
        Self { request, id: None, tries: 0, then: None }
    }
}

/// A request that was sent.
struct Sent {
    asked: Asked,
    sequence: u16,
    frame: Vec<u8>,
    at_ms: u64,
    times: u8,
}

/// A device at a port of the page's computer.
pub struct Board {
    line: Line,
    watched: Watched,
    wheel: Wheel,
    news: Vec<Out>,
    out: VecDeque<Message>,
    /// Bytes for the port.
    wire: Vec<u8>,
    queue: VecDeque<Asked>,
    sent: Option<Sent>,
    /// A start that waits for the self-test, and until when.
    start: Option<(Asked, u64)>,
    poll_at_ms: u64,
    shown: Shown,
    /// What the page was told that it is.
    info: DeviceInfo,
    /// Whether the line has ended: the port is gone, or the device speaks another protocol.
    ended: bool,
}

impl Board {
    /// A device of which nothing is known, for a port that was just opened. The token is the page's: if it has lost the line, the lease
    /// is still its own. The first sequence number is random each time.
    pub fn new(token: u32, first: u16) -> Self {
        let info =
            DeviceInfo { id: DEVICE, name: "board".into(), kind: Kind::Board, period_us: DEFAULT_PERIOD_US };
        let greeting = Message::text(&hello(false, vec![info.clone()]));
        Self {
            line: Line::new(token, first),
            watched: Watched::new(DEVICE, DEFAULT_PERIOD_US),
            wheel: Wheel::default(),
            news: Vec::new(),
            out: VecDeque::from([greeting]),
            wire: Vec::new(),
            queue: VecDeque::new(),
            sent: None,
            start: None,
            poll_at_ms: 0,
            shown: Shown::default(),
            info,
            ended: false,
        }
    }

    /// The next message to the page.
    pub fn take(&mut self) -> Option<Message> {
        self.out.pop_front()
    }

    /// Bytes to write to the port.
    pub fn wire(&mut self) -> Vec<u8> {
        std::mem::take(&mut self.wire)
    }

    /// Takes bytes of the port, at a time in ms since 1970.
    pub fn hear(&mut self, bytes: &[u8], now_ms: u64) {
        for byte in bytes {
            match self.line.hear(*byte).filter(|_| !self.ended) {
                Some(Ok(ToHost::Event(event))) => self.tell(&News::Event(event), now_ms),
                Some(Ok(ToHost::Response { sequence, response })) => {
                    if let Some(sent) = self.sent.take_if(|sent| sent.sequence == sequence) {
                        self.answered(sent.asked, response, now_ms);
                    }
                }
                Some(Err(protocol)) => {
                    self.end(
                        &format!(
                            "the board uses protocol {protocol}, this page {PROTOCOL}: update the older side"
                        ),
                        now_ms,
                    );
                }
                None => {}
            }
        }
        self.go_on(now_ms);
    }

    /// Goes on until a time in ms since 1970: call it many times a second.
    pub fn advance(&mut self, now_ms: u64) {
        if self.sent.as_ref().is_some_and(|sent| now_ms.saturating_sub(sent.at_ms) > ANSWER_MS) {
            self.repeat(now_ms);
        }
        if let Some((asked, _)) = self.start.take_if(|(_, at_ms)| now_ms >= *at_ms) {
            self.queue.push_front(asked);
        }
        if now_ms >= self.poll_at_ms && self.sent.is_none() && self.queue.is_empty() && !self.ended {
            self.poll_at_ms = now_ms + POLL_MS;
            self.queue.extend(POLLED.map(Asked::own));
            self.tell(&News::Traffic(self.line.counters()), now_ms);
        }
        self.go_on(now_ms);
        self.watched.flush(&mut self.news);
        hand_on(&mut self.news, true, &mut self.out);
        let state = || self.watched.state(now_ms, self.wheel.who(), None, None);
        self.shown.update(now_ms, state, &mut self.out);
    }

    /// The port is gone.
    pub fn unplugged(&mut self, now_ms: u64) {
        self.end(UNPLUGGED, now_ms);
    }

    /// Gives the lease back and switches the telemetry off: the last bytes for the port.
    pub fn leave(&mut self) -> Vec<u8> {
        let frames = [Request::ReleaseLease, Request::Telemetry { on: false }];
        frames
            .into_iter()
            .filter_map(|request| self.line.frame(request))
            .flat_map(|(_, frame)| frame)
            .collect()
    }

    /// Takes a message of the page.
    pub fn receive(&mut self, text: &str, now_ms: u64) {
        match FromPage::parse(text) {
            Err(why) => self.queue_text(&ToPage::Answer(Answer::refused(None, why.to_string()))),
            Ok(FromPage::Take { take_over, .. }) => {
                // There is no other page.
                let _ = self.wheel.take(VIEWER, PAGE, false);
                if take_over {
                    // The page's user has confirmed it.
                    self.queue.push_back(Asked::own(acquire(true)));
                }
                self.show_steerer();
            }
            Ok(FromPage::Release { .. }) => self.release(),
            Ok(message) => {
                if let Some(id) = message.id()
                    && let Some(answer) = self.carry_out(id, &message, now_ms)
                {
                    self.queue_text(&ToPage::Answer(answer));
                }
            }
        }
        self.go_on(now_ms);
    }

    /// Queues a request of the page; its answer, if there is one already.
    fn carry_out(&mut self, id: u32, message: &FromPage, now_ms: u64) -> Option<Answer> {
        let refused = |why: &str| Some(Answer::refused(Some(id), why));
        if let FromPage::Mark { text, .. } = message {
            let (kind, tick) = (EventKind::Marker, self.watched.newest_tick());
            let event = ToPage::Event { device: DEVICE, time_ms: now_ms, kind, text: text.clone(), tick };
            self.news.push(Out::Message(event));
            return Some(Answer::done(id, "marked"));
        }
        if self.ended {
            return refused(NOT_SENT);
        }
        if let Err(why) = self.wheel.check(VIEWER) {
            return refused(&why.to_string());
        }
        let request = match steer::request(message, self.watched.settings()) {
            Ok(Some(request)) => request,
            Ok(None) => return refused(NO_FILES),
            Err(why) => return refused(&why.to_string()),
        };
        let stops = request == Request::Stop;
        let asked = Asked { id: Some(id), ..Asked::own(request) };
        if stops {
            self.cancel_starts(now_ms);
            self.queue.push_front(asked);
        } else {
            self.queue.push_back(asked);
        }
        None
    }

    fn cancel_starts(&mut self, now_ms: u64) {
        let (starts, others): (VecDeque<_>, _) =
            std::mem::take(&mut self.queue).into_iter().partition(|asked| asked.request == Request::Start);
        self.queue = others;
        let delayed = self.start.take().map(|(asked, _)| asked);
        for asked in starts.into_iter().chain(delayed) {
            self.finish(asked, Err(CANCELLED.to_owned()), now_ms);
        }
    }

    /// Sends the next request, if none is on its way.
    fn go_on(&mut self, now_ms: u64) {
        if self.sent.is_some() || self.ended {
            return;
        }
        let Some(asked) = self.queue.pop_front() else { return };
        // Everything that a page can ask for fits into a frame.
        let Some((sequence, frame)) = self.line.frame(asked.request.clone()) else { return };
        self.wire.extend(&frame);
        self.sent = Some(Sent { asked, sequence, frame, at_ms: now_ms, times: 1 });
    }

    fn repeat(&mut self, now_ms: u64) {
        let Some(sent) = &mut self.sent else { return };
        if sent.times < ATTEMPTS {
            self.wire.extend(&sent.frame);
            (sent.at_ms, sent.times) = (now_ms, sent.times + 1);
            return;
        }
        self.lose(SILENT, now_ms);
        self.poll_at_ms = now_ms + TRY_MS;
    }

    /// Refuses what waits, because it referred to the state before.
    fn lose(&mut self, why: &str, now_ms: u64) {
        let sent = self.sent.take().map(|sent| sent.asked);
        let start = self.start.take().map(|(asked, _)| asked);
        for asked in sent.into_iter().chain(start).chain(std::mem::take(&mut self.queue)) {
            self.finish(asked, Err(why.to_owned()), now_ms);
        }
        self.tell(&News::Lost(why.to_owned()), now_ms);
    }

    fn end(&mut self, why: &str, now_ms: u64) {
        if !self.ended {
            self.lose(why, now_ms);
            self.ended = true;
        }
    }

    fn answered(&mut self, mut asked: Asked, response: Response, now_ms: u64) {
        let put_off = asked.request.changes() && asked.tries < STARTS;
        match response {
            Response::Refused(Refusal::NoLease) if put_off && asked.tries < ATTEMPTS => {
                asked.tries += 1;
                let then = Some(Box::new(asked));
                self.queue.push_front(Asked { then, ..Asked::own(acquire(false)) });
            }
            Response::Refused(Refusal::SelfTestRuns) if put_off => {
                asked.tries += 1;
                self.start = Some((asked, now_ms + START_MS));
            }
            Response::Refused(Refusal::UnknownRequest) => {
                self.finish(
                    asked,
                    Err("the device does not know this request: update its firmware".into()),
                    now_ms,
                );
            }
            Response::Refused(refusal) => {
                self.finish(asked, Err(format!("the device refused: {refusal}")), now_ms);
            }
            response => self.finish(asked, Ok(response), now_ms),
        }
    }

    /// The end of a request. One that was to acquire the lease goes on with the request that needs it, or ends it too.
    fn finish(&mut self, asked: Asked, result: Result<Response, String>, now_ms: u64) {
        if let Some(then) = asked.then {
            match &result {
                Ok(_) => self.queue.push_front(*then),
                Err(_) => self.finish(*then, result.clone(), now_ms),
            }
        }
        if let Some(id) = asked.id {
            self.queue_text(&ToPage::Answer(steer::answer(id, &result)));
        }
        let stale =
            matches!(&result, Ok(Response::Lease(lease)) if lease.yours) && self.wheel.who().is_none();
        self.tell(&News::Answer { request: asked.request, result }, now_ms);
        if stale {
            // An earlier release was lost with the line.
            self.queue.push_back(Asked::own(Request::ReleaseLease));
        }
        self.introduce();
    }

    fn tell(&mut self, news: &News, now_ms: u64) {
        let before = self.news.len();
        self.watched.take(news, now_ms, &mut self.news);
        let gone = |out: &Out| {
            matches!(out, Out::Message(ToPage::Event { kind: EventKind::Lost | EventKind::Restarted, .. }))
        };
        if self.news[before..].iter().any(gone) {
            // The page's form shows settings from before: an apply would restore them.
            self.release();
        }
    }

    fn release(&mut self) {
        if self.wheel.free() {
            if !self.ended {
                self.queue.push_back(Asked::own(Request::ReleaseLease));
            }
            self.show_steerer();
        }
    }

    /// Greets the page again once the device has said what it is.
    fn introduce(&mut self) {
        let Some(identity) = &self.watched.reported().identity else { return };
        let info = DeviceInfo {
            kind: Kind::of(identity.device),
            period_us: identity.period_us,
            ..self.info.clone()
        };
        if info != self.info {
            self.info = info.clone();
            self.queue_text(&hello(false, vec![info]));
            self.shown.forget();
        }
    }

    fn show_steerer(&mut self) {
        let who = self.wheel.who().map(str::to_owned);
        let yours = who.is_some();
        self.queue_text(&ToPage::Steerer { device: DEVICE, who, yours });
        self.shown.forget();
    }

    fn queue_text(&mut self, message: &ToPage) {
        self.out.push_back(Message::text(message));
    }
}

fn acquire(take_over: bool) -> Request {
    Request::AcquireLease { name: HostName::new(PAGE), take_over }
}
