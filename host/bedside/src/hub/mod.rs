//! One thread for each watched device: takes its news, sends messages to the pages, and pages' requests to the device. It never
//! waits for a page.

mod measure;
mod reader;

use std::collections::VecDeque;
use std::fmt::Display;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, SendError, Sender, channel};
use std::sync::{Arc, Mutex, OnceLock, PoisonError};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

use shared::link::messages::{Request, Response};
use show::monitor::News;

use crate::metrics::Metrics;
use crate::record::{Notice, Recorder};
use crate::source::{Source, Watch};
use crate::steer::{self, Wheel};
use crate::stream::{
    Answer, EventKind, FromPage, Kind, Missing, RecordingInfo, STATE_EVERY_MS, State, ToPage,
};
use crate::trends::Trends;
use crate::viewers::{Viewer, Viewers};
use crate::watched::{DeviceNumbers, Out, Watched};
use measure::{Measured, RUNS};
use reader::RecorderReader;

/// Longest wait for news.
const PATIENCE: Duration = Duration::from_millis(10);
/// Most news between two looks at the pages' messages.
const NEWS_AT_ONCE: usize = 1000;
/// Interval between messages of samples.
const FRAME_EVERY: Duration = Duration::from_millis(20);
/// [`STATE_EVERY_MS`].
const STATE_EVERY: (Duration, Duration) =
    (Duration::from_millis(STATE_EVERY_MS.0), Duration::from_millis(STATE_EVERY_MS.1));

/// Why a device is not watched any more.
const FAILED: &str = "the server's part for this device has failed: start the server again";

/// Most events that a new page gets.
const EVENTS_MAX: usize = 50;

/// A message to a hub.
pub enum Command {
    /// A page's message about its device.
    Message {
        /// The page.
        viewer: Arc<Viewer>,
        /// Its message.
        message: FromPage,
    },
    /// A page is open.
    Opened {
        /// The page.
        viewer: Arc<Viewer>,
    },
    /// A page is closed.
    Gone {
        /// The page's number.
        viewer: u64,
    },
}

/// What a new page gets about a device.
#[derive(Clone, Debug, Default)]
pub struct Latest {
    /// The page that steers: number and name.
    pub steerer: Option<(u64, String)>,
    /// The kind of the device and its control period, microseconds, once it has answered.
    pub device: Option<(Kind, u32)>,
}

/// A running hub; ends when dropped.
pub struct Hub {
    commands: Sender<Command>,
    latest: Arc<Mutex<Latest>>,
    stop: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl Hub {
    /// Watches a device for these pages; recordings go into a folder.
    pub fn start(
        device: u8,
        watch: Watch,
        folder: &Path,
        viewers: Arc<Viewers>,
        metrics: Arc<Metrics>,
    ) -> Self {
        let (commands, received) = channel();
        let stop = Arc::new(AtomicBool::new(false));
        let mut worker = Worker::new(device, watch, folder, received, viewers, metrics);
        let latest = Arc::clone(&worker.latest);
        let stopped = Arc::clone(&stop);
        let thread = thread::spawn(move || {
            let watching = catch_unwind(AssertUnwindSafe(|| {
                while !stopped.load(Ordering::Relaxed) {
                    worker.turn();
                }
            }));
            if watching.is_err() {
                // Nobody may take the last state for that of a device which is watched.
                worker.fail();
            }
            worker.source.leave();
        });
        Self { commands, latest, stop, thread: Some(thread) }
    }

    /// Sends a message to the hub.
    pub fn send(&self, command: Command) {
        // A thread that has failed takes nothing any more.
        if let Err(SendError(Command::Message { viewer, message })) = self.commands.send(command)
            && let Some(id) = message.id()
        {
            send(&viewer, &ToPage::Answer(Answer::refused(Some(id), FAILED)));
        }
    }

    /// Makes it end soon, without waiting for that.
    pub fn stop(&self) {
        self.stop.store(true, Ordering::Relaxed);
    }

    /// What a new page gets.
    pub fn latest(&self) -> Latest {
        self.latest.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }
}

impl Drop for Hub {
    fn drop(&mut self) {
        self.stop();
        if let Some(thread) = self.thread.take() {
            // A thread that panicked has already reported it.
            let _ = thread.join();
        }
    }
}

/// Now, ms since 1970, by the clock of the computer when this was first called, and from then on by one that nobody sets: a step of the
/// clock would hide that a device is silent, or claim it.
pub fn now_ms() -> u64 {
    static START: OnceLock<(Duration, Instant)> = OnceLock::new();
    let (since, start) = START
        .get_or_init(|| (SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default(), Instant::now()));
    (*since + start.elapsed()).as_millis().try_into().unwrap_or(u64::MAX)
}

/// A page's request that the device has not answered yet.
struct Waiting {
    viewer: Arc<Viewer>,
    id: u32,
    request: Request,
}

struct Worker {
    device: u8,
    /// As the pages know it.
    kind: Kind,
    period_us: u32,
    watched: Watched,
    recorder: Recorder,
    trends: Trends,
    /// What every new page gets, and after it the newest events.
    enclosed: Vec<Arc<str>>,
    events: VecDeque<Arc<str>>,
    /// The flight recorder that is being read.
    reading: Option<RecorderReader>,
    source: Box<dyn Source>,
    commands: Receiver<Command>,
    viewers: Arc<Viewers>,
    metrics: Arc<Metrics>,
    latest: Arc<Mutex<Latest>>,
    wheel: Wheel,
    /// The page that has started the recording.
    records: Option<u64>,
    /// The requests to start a recording, and those to end it, that the writer has not answered yet.
    starting: Vec<(Arc<Viewer>, u32)>,
    stopping: Vec<(Arc<Viewer>, u32)>,
    measured: Measured,
    /// In the order in which they were sent.
    waiting: VecDeque<Waiting>,
    out: Vec<Out>,
    framed: Instant,
    /// The state that was shown last, and when.
    shown: Option<(State, Instant)>,
}

impl Worker {
    fn new(
        device: u8,
        watch: Watch,
        folder: &Path,
        commands: Receiver<Command>,
        viewers: Arc<Viewers>,
        metrics: Arc<Metrics>,
    ) -> Self {
        let Watch { name, period_us, source, verdict, recorder, kind } = watch;
        let verdict = verdict.map(|verdict| ToPage::Verdict { device, verdict });
        let recorded = recorder.map(|recorder| ToPage::Recorder { device, recorder: Box::new(recorder) });
        Self {
            device,
            period_us,
            kind,
            watched: Watched::new(device, period_us).replaying(kind == Kind::Recording),
            recorder: Recorder::new(folder, device, &name, period_us),
            trends: Trends::default(),
            enclosed: verdict.iter().chain(&recorded).map(|message| message.to_json().into()).collect(),
            events: VecDeque::new(),
            reading: None,
            source,
            commands,
            viewers,
            metrics,
            latest: Arc::default(),
            wheel: Wheel::default(),
            records: None,
            starting: Vec::new(),
            stopping: Vec::new(),
            measured: Measured::default(),
            waiting: VecDeque::new(),
            out: Vec::new(),
            framed: Instant::now(),
            shown: None,
        }
    }

    /// Shows that the device is not watched any more.
    fn fail(&mut self) {
        let state = State {
            device: self.device,
            lost: Some(FAILED.to_owned()),
            missing: Some(Missing::Line),
            ..State::default()
        };
        self.metrics.device(self.device, DeviceNumbers::default());
        self.publish(state);
    }

    fn turn(&mut self) {
        let mut next = self.source.next(PATIENCE);
        for _ in 0..NEWS_AT_ONCE {
            let Some(news) = next else { break };
            self.take(&news);
            next = self.source.next(Duration::ZERO);
        }
        while let Ok(command) = self.commands.try_recv() {
            match command {
                Command::Message { viewer, message } => self.obey(&viewer, &message),
                Command::Opened { viewer } => self.welcome(&viewer),
                Command::Gone { viewer } => self.release(viewer),
            }
        }
        self.pass_notices();
        self.send_margins();
        if self.framed.elapsed() >= FRAME_EVERY {
            self.framed = Instant::now();
            self.watched.flush(&mut self.out);
        }
        self.send();
        self.show();
    }

    fn take(&mut self, news: &News) {
        let (now, before) = (now_ms(), self.out.len());
        self.watched.take(news, now, &mut self.out);
        self.record(news, before, now);
        self.measure_on(news);
        let gone = |out: &Out| {
            matches!(out, Out::Message(ToPage::Event { kind: EventKind::Lost | EventKind::Restarted, .. }))
        };
        if self.out[before..].iter().any(gone) {
            self.leave_measuring();
            if self.wheel.free() {
                // The form on that page shows settings from before: an apply would restore them.
                self.give_lease_back();
            }
        }
        let News::Answer { request, result } = news else { return };
        self.meet();
        self.read_on(request, result);
        if let (Request::GetLease, Ok(Response::Lease(lease))) = (request, result)
            && lease.yours
            && self.wheel.who().is_none()
        {
            // An earlier release was lost with the line.
            let _ = self.source.ask(Request::ReleaseLease);
        }
        // The session also asks by itself, for other things; and a stop overtakes other requests.
        if let Some(place) = self.waiting.iter().position(|waiting| waiting.request == *request)
            && let Some(Waiting { viewer, id, .. }) = self.waiting.remove(place)
        {
            send(&viewer, &ToPage::Answer(steer::answer(id, result)));
        }
    }

    /// Looks whether another kind of device is there than the pages know; then they start again.
    fn meet(&mut self) {
        let kind = match &self.watched.reported().identity {
            Some(identity) if self.kind != Kind::Recording => Kind::of(identity.device),
            _ => self.kind,
        };
        let period_us = self.watched.period_us();
        if (kind, period_us) == (self.kind, self.period_us) {
            return;
        }
        self.recorder.set_period(period_us);
        (self.kind, self.period_us) = (kind, period_us);
        self.latest.lock().unwrap_or_else(PoisonError::into_inner).device = Some((kind, period_us));
        self.viewers.restart();
    }

    /// Passes news, and the messages that they have become, to the recorder.
    fn record(&mut self, news: &News, before: usize, now: u64) {
        self.recorder.take(news, self.watched.reported().in_force.as_ref(), now);
        for out in &self.out[before..] {
            match out {
                Out::Message(ToPage::Event { kind: EventKind::Alarm, text, .. }) => {
                    self.recorder.alarm(text, now);
                }
                Out::Message(ToPage::Breath { figures, .. }) => {
                    self.trends.add(now, figures);
                    self.recorder.breath(figures, now);
                }
                _ => {}
            }
        }
    }

    /// Passes the recorder's notices to the pages.
    fn pass_notices(&mut self) {
        for notice in self.recorder.notices() {
            match notice {
                Notice::Event(text) => self.event(EventKind::Capture, text),
                Notice::Started(result) => answer_all(&mut self.starting, &result),
                Notice::Stopped(Err(why)) if self.stopping.is_empty() => {
                    self.event(EventKind::Capture, format!("the recording could not be finished: {why}"));
                }
                Notice::Stopped(result) => answer_all(&mut self.stopping, &result),
            }
        }
    }

    fn event(&mut self, kind: EventKind, text: String) {
        let tick = self.watched.newest_tick();
        let event = ToPage::Event { device: self.device, time_ms: now_ms(), kind, text, tick };
        self.out.push(Out::Message(event));
    }

    /// Sends a new page what was before it.
    fn welcome(&mut self, viewer: &Viewer) {
        // The breaths that are in the trends must not come after them.
        self.send();
        if let Some(history) = self.trends.history() {
            send(viewer, &ToPage::History { device: self.device, history });
        }
        let known = self.enclosed.iter().chain(&self.measured.newest).chain(&self.events);
        known.for_each(|message| viewer.send(Arc::clone(message)));
    }

    /// Sends what has been made.
    fn send(&mut self) {
        for out in self.out.drain(..) {
            match out {
                Out::Frame(frame) => self.viewers.samples(&Arc::new(frame)),
                Out::Message(message) => {
                    let text: Arc<str> = message.to_json().into();
                    self.viewers.send(&text);
                    if matches!(message, ToPage::Event { .. }) {
                        self.events.push_back(text);
                    }
                    if self.events.len() > EVENTS_MAX {
                        self.events.pop_front();
                    }
                }
            }
        }
    }

    /// Shows the state if it has changed, or if the pages would think that there is no data.
    fn show(&mut self) {
        let elapsed = self.shown.as_ref().map(|(_, at)| at.elapsed());
        if elapsed.is_some_and(|elapsed| elapsed < STATE_EVERY.0) {
            return;
        }
        let now = now_ms();
        let state = self.watched.state(now, self.wheel.who(), self.recorder.info(), self.recorder.triggers());
        let state = State { measuring: self.measured.info(), ..state };
        let unchanged = self.shown.as_ref().is_some_and(|(shown, _)| *shown == state);
        if unchanged && elapsed.is_some_and(|elapsed| elapsed < STATE_EVERY.1) {
            return;
        }
        self.metrics.device(self.device, self.watched.numbers(now));
        self.publish(state);
    }

    fn publish(&mut self, state: State) {
        let text: Arc<str> = ToPage::State(Box::new(state.clone())).to_json().into();
        self.viewers.state(self.device, &text);
        self.shown = Some((state, Instant::now()));
    }

    /// Does what a page asks for.
    fn obey(&mut self, viewer: &Arc<Viewer>, message: &FromPage) {
        match message {
            FromPage::Take { take_over, .. } => match self.wheel.take(viewer.number, &viewer.who, *take_over)
            {
                Ok(()) => {
                    if !self.measured.is_of(viewer.number) {
                        // Its page does not steer any more.
                        self.stop_measuring();
                    }
                    if *take_over {
                        // The page's user has confirmed it, also if another program steers past all pages.
                        let name = device::host_name();
                        let _ = self.source.ask(Request::AcquireLease { name, take_over: true });
                    }
                    self.show_steerer();
                }
                // The page learns who steers.
                Err(_) => send(viewer, &self.steerer(viewer)),
            },
            FromPage::Release { .. } => self.release(viewer.number),
            FromPage::Drawn { tick, .. } => {
                if let Some(latency) = self.watched.latency_ms(*tick, now_ms()) {
                    self.metrics.latencies.add(latency);
                }
            }
            _ => {
                if let Some(id) = message.id()
                    && let Some(answer) = self.carry_out(viewer, id, message)
                {
                    send(viewer, &ToPage::Answer(answer));
                }
            }
        }
    }

    /// Carries out a request; none if the device will answer it.
    fn carry_out(&mut self, viewer: &Arc<Viewer>, id: u32, message: &FromPage) -> Option<Answer> {
        let refused = |why: &dyn Display| Some(Answer::refused(Some(id), why.to_string()));
        match message {
            FromPage::Mark { text, .. } => return Some(self.mark(id, text)),
            FromPage::Record { on, .. } => return self.switch_recording(viewer, id, *on),
            FromPage::Recorder { .. } => return self.read_recorder(viewer, id),
            FromPage::Capture { triggers, .. } => {
                if let Err(why) = triggers.check() {
                    return refused(&why);
                }
                self.recorder.arm(*triggers);
                return Some(Answer::done(id, if triggers.is_armed() { "armed" } else { "disarmed" }));
            }
            _ => {}
        }
        if let Err(why) = self.wheel.check(viewer.number) {
            return refused(&why);
        }
        if let FromPage::Fault { fault, .. } = message {
            let done = self.source.fault(*fault);
            return done.map_or_else(|why| refused(&why), |()| Some(Answer::done(id, "done")));
        }
        match message {
            FromPage::Measure { test_lung: false, .. } => {
                return refused(&"confirm first that a test lung is connected, and no patient");
            }
            FromPage::Measure { sines, .. } => {
                return self.measure(viewer, id, *sines).err().and_then(|why| refused(&why));
            }
            FromPage::StopMeasuring { .. } => {
                self.stop_measuring();
                return Some(Answer::done(id, "stopped"));
            }
            FromPage::Apply { .. } if self.measured.is_running() => return refused(&RUNS),
            _ => {}
        }
        // A change that waits for its answer must not be undone by the next one.
        let asked = self.waiting.iter().rev().find_map(|waiting| match &waiting.request {
            Request::ApplySettings(settings) => Some(settings),
            _ => None,
        });
        match steer::request(message, asked.or(self.watched.settings())) {
            Ok(request) => request.and_then(|request| self.ask(viewer, id, request)),
            Err(why) => refused(&why),
        }
    }

    fn mark(&mut self, id: u32, text: &str) -> Answer {
        self.event(EventKind::Marker, text.to_owned());
        let recorded = self.recorder.mark(text, now_ms());
        Answer::done(
            id,
            if recorded { "marked" } else { "marked, but not in the recording: the disk is too slow" },
        )
    }

    /// Starts or ends a recording; an answer if that is not possible. The writer's report answers otherwise.
    fn switch_recording(&mut self, viewer: &Arc<Viewer>, id: u32, on: bool) -> Option<Answer> {
        let running = self.recorder.info();
        if on {
            if let Err(why) =
                self.recorder.start(now_ms(), self.watched.reported().identity.as_ref(), &viewer.who)
            {
                return Some(Answer::refused(Some(id), why));
            }
            if running.is_none() {
                self.records = Some(viewer.number);
            }
            self.starting.push((Arc::clone(viewer), id));
            return None;
        }
        let others = self.records.is_some_and(|page| page != viewer.number && self.viewers.is_open(page));
        if let Some(RecordingInfo { by, .. }) = running
            && others
            && !self.wheel.is_with(viewer.number)
        {
            let why = format!("{by} records this device: end it there, or steer the device");
            return Some(Answer::refused(Some(id), why));
        }
        if !self.recorder.stop() {
            return Some(Answer::done(id, "nothing was being recorded"));
        }
        self.stopping.push((Arc::clone(viewer), id));
        None
    }

    /// Sends a request to the device, which will answer it; an answer if it cannot be sent.
    fn ask(&mut self, viewer: &Arc<Viewer>, id: u32, request: Request) -> Option<Answer> {
        let sent = self.source.ask(request.clone());
        if sent.is_ok() {
            self.waiting.push_back(Waiting { viewer: Arc::clone(viewer), id, request });
        }
        sent.err().map(|why| Answer::refused(Some(id), why.to_string()))
    }

    /// A page steers no longer; the device may be steered by another program then.
    fn release(&mut self, viewer: u64) {
        if self.wheel.release(viewer) {
            self.stop_measuring();
            self.give_lease_back();
        }
    }

    fn give_lease_back(&mut self) {
        let _ = self.source.ask(Request::ReleaseLease);
        self.show_steerer();
    }

    fn show_steerer(&mut self) {
        self.latest.lock().unwrap_or_else(PoisonError::into_inner).steerer = self.wheel.holder().cloned();
        self.viewers.send_each(|viewer| self.steerer(viewer).to_json().into());
        // The state names the page too.
        self.shown = None;
    }

    fn steerer(&self, viewer: &Viewer) -> ToPage {
        let who = self.wheel.who().map(str::to_owned);
        ToPage::Steerer { device: self.device, who, yours: self.wheel.is_with(viewer.number) }
    }
}

fn send(viewer: &Viewer, message: &ToPage) {
    viewer.send(message.to_json().into());
}

/// Answers requests that have waited.
fn answer_all(waiting: &mut Vec<(Arc<Viewer>, u32)>, result: &Result<String, String>) {
    for (viewer, id) in waiting.drain(..) {
        let answer = match result {
            Ok(text) => Answer::done(id, text),
            Err(why) => Answer::refused(Some(id), why),
        };
        send(&viewer, &ToPage::Answer(answer));
    }
}

#[cfg(test)]
mod tests;
