//! Tests of a hub whose disk hangs, and of the lease.

use super::*;
use crate::record::WAITING_MAX;
use crate::source::Unable;
use crate::stream::DeviceInfo;
use crate::viewers::Outgoing;
use data::recording::Recording;
use serde_json::Value;
use shared::breath::Phase;
use shared::link::messages::Event;
use shared::link::telemetry::{BATCH_SAMPLES, Counters, PackedSample, TelemetryBatch};
use shared::settings::Settings;
use shared::ventilator::Sample;
use tokio::runtime::{Builder, Runtime};

/// Longest time that a test waits for anything.
const LONG: Duration = Duration::from_mins(1);

/// News from a test, and the requests to the device.
struct Fed {
    news: Receiver<News>,
    asked: Sender<Request>,
}

impl Source for Fed {
    fn next(&mut self, _patience: Duration) -> Option<News> {
        self.news.try_recv().ok()
    }

    fn ask(&mut self, request: Request) -> Result<(), Unable> {
        // A test that looks at no request has dropped the other end.
        let _ = self.asked.send(request);
        Ok(())
    }

    fn leave(self: Box<Self>) {}
}

/// A hub in the test's thread.
struct Rig {
    worker: Worker,
    news: Sender<News>,
    asked: Receiver<Request>,
    runtime: Runtime,
    tick: u64,
}

impl Rig {
    fn new(folder: &Path) -> Self {
        let info = DeviceInfo { id: 0, name: "a lung".to_owned(), kind: Kind::Board, period_us: 1000 };
        let metrics = Arc::new(Metrics::new(std::slice::from_ref(&info)));
        let viewers = Arc::new(Viewers::new(Arc::clone(&metrics)));
        let (news, fed) = channel();
        let (ask, asked) = channel();
        let source = Box::new(Fed { news: fed, asked: ask });
        let DeviceInfo { name, kind, period_us, .. } = info;
        let watch = Watch { name, kind, period_us, source, verdict: None, recorder: None };
        let worker = Worker::new(0, watch, folder, channel().1, viewers, metrics);
        let (in_force, pending) = (Settings::default(), None);
        let result = Ok(Response::Settings { in_force, pending });
        news.send(News::Answer { request: Request::GetSettings, result }).unwrap();
        let runtime = Builder::new_current_thread().enable_all().build().unwrap();
        Self { worker, news, asked, runtime, tick: 0 }
    }

    fn page(&self) -> Arc<Viewer> {
        self.worker.viewers.add("here", 1).unwrap()
    }

    /// Feeds a batch of samples.
    fn feed(&mut self) {
        let sample = |tick: u64| Sample {
            breath: 0,
            tick: tick as u32,
            phase: Phase::Inspiration,
            target: 20.0,
            pressure: 20.0,
            u_in: 30.0,
            u_out: false,
            explore: 0.0,
            learned: 0.0,
            flow: None,
        };
        let first_tick = self.tick;
        self.tick += BATCH_SAMPLES as u64;
        let samples = (first_tick..self.tick).map(|tick| PackedSample::pack(&sample(tick))).collect();
        let batch = TelemetryBatch { sequence: 0, first_tick, counters: Counters::default(), samples };
        self.news.send(News::Event(Event::Telemetry(batch))).unwrap();
        self.worker.turn();
    }

    /// What waits for a page: the number of samples, and the texts.
    fn read(&self, page: &Viewer) -> (u64, Vec<Value>) {
        let (mut samples, mut texts) = (0, Vec::new());
        let next = || async { tokio::time::timeout(Duration::ZERO, page.next()).await };
        while let Ok(message) = self.runtime.block_on(next()) {
            match message.expect("the page is up to date") {
                Outgoing::Binary(bytes) => {
                    assert_eq!(bytes[4..8], [0; 4], "nothing is lost on the way to the page");
                    samples += u64::from(u16::from_le_bytes([bytes[2], bytes[3]]));
                }
                Outgoing::Text(text) => texts.push(serde_json::from_str(&text).unwrap()),
            }
        }
        (samples, texts)
    }

    /// Turns until a page has a text.
    fn text(&mut self, page: &Viewer, expected: impl Fn(&Value) -> bool) -> Value {
        let deadline = Instant::now() + LONG;
        loop {
            self.worker.turn();
            if let Some(text) = self.read(page).1.into_iter().find(&expected) {
                return text;
            }
            assert!(Instant::now() < deadline, "the text does not come");
            thread::sleep(Duration::from_millis(1));
        }
    }

    fn record(&mut self, page: &Arc<Viewer>, id: u32, on: bool) {
        self.worker.obey(page, &FromPage::Record { id, device: 0, on });
    }
}

fn is_answer(text: &Value) -> bool {
    text["type"] == "answer"
}

fn a_hub_goes_on(folder: &Path) {
    let mut rig = Rig::new(folder);
    let (page, other) = (rig.page(), rig.page());
    rig.worker.turn();
    rig.record(&page, 1, true);
    let started = rig.text(&page, is_answer);
    assert!(started["text"].as_str().unwrap().starts_with("recording to "), "{started}");
    let goes_on = rig.worker.recorder.hang();
    let (mut seen, mut texts) = (0, Vec::new());
    while rig.tick < WAITING_MAX as u64 + 5000 {
        rig.feed();
        let (samples, more) = rig.read(&other);
        seen += samples;
        texts.extend(more);
    }
    rig.worker.watched.flush(&mut rig.worker.out);
    rig.worker.send();
    assert_eq!(seen + rig.read(&other).0, rig.tick, "the other page has seen all of them");
    let slow = |text: &&Value| text["type"] == "event" && text["text"].as_str().unwrap().contains("too slow");
    assert_eq!(texts.iter().filter(slow).count(), 1, "reported once");
    let state = rig.text(&other, |text| text["type"] == "state");
    let lost = state["recording"]["lost"].as_u64().unwrap();
    assert!((4500..=5500).contains(&lost), "{state}");
    let fed = rig.tick;
    // The page's request waits for the disk; the hub does not.
    rig.record(&page, 2, false);
    rig.feed();
    assert!(!rig.read(&page).1.iter().any(is_answer));
    drop(goes_on);
    let stopped = rig.text(&page, is_answer);
    assert_eq!((&stopped["id"], &stopped["ok"]), (&2.into(), &true.into()), "{stopped}");
    assert!(stopped["text"].as_str().unwrap().contains(&format!("lost: {lost} samples")), "{stopped}");
    let file = std::fs::read_dir(folder).unwrap().next().unwrap().unwrap().path();
    let recording = Recording::load(file).unwrap();
    assert!(recording.tick.is_sorted());
    assert_eq!(recording.len() as u64 + lost, fed);
}

#[test]
fn a_disk_that_hangs_delays_no_page_and_what_it_loses_is_reported() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().to_owned();
    let (done, waits) = channel();
    let test = thread::spawn(move || {
        a_hub_goes_on(&path);
        let _ = done.send(());
    });
    assert_ne!(
        waits.recv_timeout(2 * LONG),
        Err(std::sync::mpsc::RecvTimeoutError::Timeout),
        "the hub hangs"
    );
    test.join().unwrap();
}

#[test]
fn only_a_confirmed_take_over_takes_the_lease_from_another_program() {
    let folder = tempfile::tempdir().unwrap();
    let mut rig = Rig::new(folder.path());
    let page = rig.page();
    let take = |take_over| FromPage::Take { device: 0, take_over };
    rig.worker.obey(&page, &take(false));
    assert_eq!(rig.asked.try_iter().count(), 0);
    rig.worker.obey(&page, &take(true));
    let asked: Vec<Request> = rig.asked.try_iter().collect();
    assert_eq!(asked, [Request::AcquireLease { name: device::host_name(), take_over: true }]);
}
