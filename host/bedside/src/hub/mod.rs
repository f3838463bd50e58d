//! One thread for each watched device: takes its news, sends messages to the pages, and pages' requests to the device. It never
//! waits for a page.

pub mod watched;

use std::collections::VecDeque;
use std::fmt::Display;
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, Sender, channel};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

use shared::link::messages::{Event, Request};
use show::monitor::News;

use crate::metrics::Metrics;
use crate::record::{Recorder, Told};
use crate::source::{Source, Watch};
use crate::steer::{self, Wheel};
use crate::stream::{Answer, EventKind, FromPage, RecordingInfo, State, ToPage};
use crate::viewers::{Viewer, Viewers};
use watched::{Out, Watched};

/// Longest wait for news.
const PATIENCE: Duration = Duration::from_millis(10);
/// Most news between two looks at the pages' messages.
const NEWS_AT_ONCE: usize = 1000;
/// Interval between messages of samples.
const FRAME_EVERY: Duration = Duration::from_millis(20);
/// Shortest interval between states, and longest one, well below the second after which a page shows that it has no data.
const STATE_EVERY: (Duration, Duration) = (Duration::from_millis(100), Duration::from_millis(500));

/// A message to a hub.
pub enum Command {
    /// A page's message about its device.
    Message {
        /// The page.
        viewer: Arc<Viewer>,
        /// Its message.
        message: FromPage,
    },
    /// A page is closed.
    Gone {
        /// The page's number.
        viewer: u64,
    },
}

/// What a new page is told about a device.
#[derive(Clone, Debug, Default)]
pub struct Latest {
    /// The newest state.
    pub state: Option<Arc<str>>,
    /// The page that steers: number and name.
    pub steerer: Option<(u64, String)>,
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
        let (latest, stop) = (Arc::new(Mutex::default()), Arc::new(AtomicBool::new(false)));
        let mut worker = Worker {
            device,
            watched: Watched::new(device, &watch.name, watch.period_us),
            recorder: Recorder::new(folder, device, &watch.name, watch.period_us),
            source: watch.source,
            commands: received,
            viewers,
            metrics,
            latest: Arc::clone(&latest),
            wheel: Wheel::default(),
            waiting: VecDeque::new(),
            out: Vec::new(),
            framed: Instant::now(),
            shown: None,
        };
        let stopped = Arc::clone(&stop);
        let thread = thread::spawn(move || {
            while !stopped.load(Ordering::Relaxed) {
                worker.turn();
            }
            worker.source.leave();
        });
        Self { commands, latest, stop, thread: Some(thread) }
    }

    /// Sends a message to the hub.
    pub fn tell(&self, command: Command) {
        // The thread ends only with this.
        let _ = self.commands.send(command);
    }

    /// Makes it end soon, without waiting for that.
    pub fn stop(&self) {
        self.stop.store(true, Ordering::Relaxed);
    }

    /// What a new page is told.
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

/// Now, ms since 1970.
pub fn now_ms() -> u64 {
    let since = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
    since.as_millis().try_into().unwrap_or(u64::MAX)
}

/// A page's request that the device has not answered yet.
struct Waiting {
    viewer: Arc<Viewer>,
    id: u32,
    request: Request,
}

struct Worker {
    device: u8,
    watched: Watched,
    recorder: Recorder,
    source: Box<dyn Source>,
    commands: Receiver<Command>,
    viewers: Arc<Viewers>,
    metrics: Arc<Metrics>,
    latest: Arc<Mutex<Latest>>,
    wheel: Wheel,
    /// In the order in which they were sent.
    waiting: VecDeque<Waiting>,
    out: Vec<Out>,
    framed: Instant,
    /// The state that was shown last, and when.
    shown: Option<(State, Instant)>,
}

impl Worker {
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
                Command::Gone { viewer } => self.release(viewer),
            }
        }
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
        let News::Answer { request, result } = news else { return };
        // The session also asks by itself, for other things.
        if self.waiting.front().is_some_and(|waiting| waiting.request == *request)
            && let Some(Waiting { viewer, id, .. }) = self.waiting.pop_front()
        {
            tell(&viewer, &ToPage::Answer(steer::answer(id, result)));
        }
    }

    /// Passes news, and the messages that they have become, to the recorder.
    fn record(&mut self, news: &News, before: usize, now: u64) {
        let mut told: Vec<Told> = self.recorder.news(news, now).into_iter().collect();
        if let News::Event(Event::Telemetry(batch)) = news {
            let settings = self.watched.known().in_force;
            for sample in &batch.samples {
                told.extend(self.recorder.sample(&sample.unpack(), settings, now));
            }
        }
        for out in &self.out[before..] {
            told.extend(match out {
                Out::Message(ToPage::Event { kind: EventKind::Alarm, text, .. }) => {
                    self.recorder.alarm(text, now)
                }
                Out::Message(ToPage::Breath { figures, .. }) => self.recorder.breath(figures, now),
                _ => None,
            });
        }
        for Told(text) in told {
            self.event(EventKind::Capture, text);
        }
    }

    fn event(&mut self, kind: EventKind, text: String) {
        let event = ToPage::Event { device: self.device, time_ms: now_ms(), kind, text };
        self.out.push(Out::Message(event));
    }

    /// Sends what has been made.
    fn send(&mut self) {
        for out in self.out.drain(..) {
            match out {
                Out::Frame(frame) => self.viewers.samples(&Arc::new(frame)),
                Out::Message(message) => self.viewers.tell(&message.to_json().into()),
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
        let state = self.watched.state(now, self.wheel.who(), self.recorder.info());
        let unchanged = self.shown.as_ref().is_some_and(|(shown, _)| *shown == state);
        if unchanged && elapsed.is_some_and(|elapsed| elapsed < STATE_EVERY.1) {
            return;
        }
        self.metrics.device(self.device, self.watched.numbers(now));
        let text: Arc<str> = ToPage::State(Box::new(state.clone())).to_json().into();
        self.viewers.state(self.device, &text);
        self.latest.lock().unwrap_or_else(PoisonError::into_inner).state = Some(text);
        self.shown = Some((state, Instant::now()));
    }

    /// Does what a page asks for.
    fn obey(&mut self, viewer: &Arc<Viewer>, message: &FromPage) {
        match message {
            FromPage::Take { .. } => match self.wheel.take(viewer.number, &viewer.who) {
                Ok(_) => self.tell_steerer(),
                // It is told who steers.
                Err(_) => tell(viewer, &self.steerer(viewer)),
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
                    tell(viewer, &ToPage::Answer(answer));
                }
            }
        }
    }

    /// Carries out a request; none if the device will answer it.
    fn carry_out(&mut self, viewer: &Arc<Viewer>, id: u32, message: &FromPage) -> Option<Answer> {
        let refused = |why: &dyn Display| Some(Answer::refused(Some(id), why.to_string()));
        match message {
            FromPage::Mark { text, .. } => return Some(self.mark(id, text)),
            FromPage::Record { on, .. } => return Some(self.switch_recording(id, *on)),
            FromPage::Capture { triggers, .. } => {
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
        match steer::request(message, self.watched.settings()) {
            Ok(request) => request.and_then(|request| self.ask(viewer, id, request)),
            Err(why) => refused(&why),
        }
    }

    fn mark(&mut self, id: u32, text: &str) -> Answer {
        self.recorder.mark(text);
        self.event(EventKind::Marker, text.to_owned());
        Answer::done(id, "marked")
    }

    fn switch_recording(&mut self, id: u32, on: bool) -> Answer {
        let done = if on {
            let started = self.recorder.start(now_ms(), self.watched.known().identity);
            started.map(|path| format!("recording to {}", path.display()))
        } else {
            let stopped = self.recorder.stop();
            stopped.map(|info| match info {
                Some(RecordingInfo { file, samples }) => format!("{samples} samples written to {file}"),
                None => "nothing was being recorded".to_owned(),
            })
        };
        done.map_or_else(|why| Answer::refused(Some(id), why.to_string()), |text| Answer::done(id, text))
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
            let _ = self.source.ask(Request::ReleaseLease);
            self.tell_steerer();
        }
    }

    fn tell_steerer(&mut self) {
        self.latest.lock().unwrap_or_else(PoisonError::into_inner).steerer = self.wheel.holder().cloned();
        self.viewers.tell_each(|viewer| self.steerer(viewer).to_json().into());
        // The state names the page too.
        self.shown = None;
    }

    fn steerer(&self, viewer: &Viewer) -> ToPage {
        let who = self.wheel.who().map(str::to_owned);
        ToPage::Steerer { device: self.device, who, yours: self.wheel.is_with(viewer.number) }
    }
}

fn tell(viewer: &Viewer, message: &ToPage) {
    viewer.tell(message.to_json().into());
}
