//! The open pages, each with a bounded queue: a slow page loses samples, which are counted, and never slows a device or another
//! page.

use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use tokio::sync::Notify;

use crate::metrics::Metrics;
use crate::stream::frame::Frame;

/// Most pages.
pub const VIEWERS_MAX: usize = 32;
/// Most waiting sample messages of a page, if it watches few devices; five seconds of one device.
const FRAMES_MAX: usize = 256;
/// Most waiting sample messages for each watched device.
const FRAMES_PER_DEVICE: usize = 32;
/// Most waiting texts that are not states: what a new page gets for as many devices as a server has fits.
const TEXTS_MAX: usize = 4096;

/// A message to a page.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Outgoing {
    /// JSON.
    Text(Arc<str>),
    /// Samples.
    Binary(Vec<u8>),
}

/// What waits for a page.
#[derive(Debug, Default)]
struct Queue {
    texts: VecDeque<Arc<str>>,
    /// The newest state of each device.
    states: BTreeMap<u8, Arc<str>>,
    frames: VecDeque<Arc<Frame>>,
    /// Samples that were lost, device by device.
    dropped: BTreeMap<u8, u32>,
    watched: BTreeSet<u8>,
    /// Whether the page must start again: it has taken nothing for so long that a text was lost, or its greeting is out of date.
    outdated: bool,
}

impl Queue {
    /// Adds samples; returns those that a full queue loses for them, the oldest ones.
    fn add(&mut self, frame: &Arc<Frame>) -> Option<Arc<Frame>> {
        if !self.watched.contains(&frame.device()) {
            return None;
        }
        self.frames.push_back(Arc::clone(frame));
        if self.frames.len() <= FRAMES_MAX.max(FRAMES_PER_DEVICE * self.watched.len()) {
            return None;
        }
        let lost = self.frames.pop_front()?;
        let dropped = self.dropped.entry(lost.device()).or_default();
        *dropped = dropped.saturating_add(lost.samples());
        Some(lost)
    }

    fn next(&mut self) -> Option<Outgoing> {
        if let Some(text) = self.texts.pop_front() {
            return Some(Outgoing::Text(text));
        }
        if let Some((_, state)) = self.states.pop_first() {
            return Some(Outgoing::Text(state));
        }
        let frame = self.frames.pop_front()?;
        let dropped = self.dropped.get(&frame.device()).copied().unwrap_or_default();
        Some(Outgoing::Binary(frame.bytes(dropped)))
    }
}

/// An open page.
#[derive(Debug)]
pub struct Viewer {
    /// Its number, which no other page gets.
    pub number: u64,
    /// Where it is, in words for other pages.
    pub who: String,
    queue: Mutex<Queue>,
    ready: Notify,
}

impl Viewer {
    /// Chooses the devices whose samples the page gets.
    pub fn watch(&self, devices: impl IntoIterator<Item = u8>) {
        let mut queue = self.queue();
        queue.watched = devices.into_iter().collect();
        let Queue { frames, watched, .. } = &mut *queue;
        frames.retain(|frame| watched.contains(&frame.device()));
    }

    /// Queues a text. If it does not fit, the page takes nothing at all: it must start again, and learns everything then.
    pub fn send(&self, text: Arc<str>) {
        let mut queue = self.queue();
        if queue.texts.len() < TEXTS_MAX {
            queue.texts.push_back(text);
        } else {
            queue.outdated = true;
        }
        drop(queue);
        self.ready.notify_one();
    }

    /// The next message to the page; none if it must start again.
    pub async fn next(&self) -> Option<Outgoing> {
        loop {
            let ready = self.ready.notified();
            let (next, outdated) = {
                let mut queue = self.queue();
                (queue.next(), queue.outdated)
            };
            match next {
                _ if outdated => return None,
                Some(message) => return Some(message),
                None => ready.await,
            }
        }
    }

    fn queue(&self) -> MutexGuard<'_, Queue> {
        self.queue.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// All open pages.
#[derive(Debug)]
pub struct Viewers {
    list: Mutex<Vec<Arc<Viewer>>>,
    /// The newest state of each device, for pages that open; changed only while the list is locked, so that no page misses one.
    states: Mutex<BTreeMap<u8, Arc<str>>>,
    numbers: AtomicU64,
    metrics: Arc<Metrics>,
}

impl Viewers {
    /// No pages yet.
    pub fn new(metrics: Arc<Metrics>) -> Self {
        Self { list: Mutex::default(), states: Mutex::default(), numbers: AtomicU64::new(1), metrics }
    }

    /// Whether no further page is fed.
    pub fn is_full(&self) -> bool {
        self.list().len() >= VIEWERS_MAX
    }

    /// Whether this page is open.
    pub fn is_open(&self, number: u64) -> bool {
        self.list().iter().any(|viewer| viewer.number == number)
    }

    /// Makes all pages start again, because their greeting is out of date.
    pub fn restart(&self) {
        for viewer in self.list().iter() {
            viewer.queue().outdated = true;
            viewer.ready.notify_one();
        }
    }

    /// Whether no page is open.
    pub fn is_empty(&self) -> bool {
        self.list().is_empty()
    }

    /// Adds a page at an address, which watches all of `devices` devices and gets their states; none if there are too many.
    pub fn add(&self, address: &str, devices: u8) -> Option<Arc<Viewer>> {
        let mut list = self.list();
        if list.len() >= VIEWERS_MAX {
            return None;
        }
        let number = self.numbers.fetch_add(1, Ordering::Relaxed);
        let who = format!("page {number} at {address}");
        let queue = Mutex::new(Queue { states: self.newest().clone(), ..Queue::default() });
        let ready = Notify::new();
        let viewer = Arc::new(Viewer { number, who, queue, ready });
        viewer.watch(0..devices);
        list.push(Arc::clone(&viewer));
        self.metrics.viewers(list.len());
        Some(viewer)
    }

    /// A page is closed.
    pub fn remove(&self, number: u64) {
        let mut list = self.list();
        list.retain(|viewer| viewer.number != number);
        self.metrics.viewers(list.len());
    }

    /// Queues samples for every page that watches their device.
    pub fn samples(&self, frame: &Arc<Frame>) {
        for viewer in self.list().iter() {
            let lost = viewer.queue().add(frame);
            if let Some(lost) = lost {
                self.metrics.drop_samples(lost.device(), lost.samples());
            }
            viewer.ready.notify_one();
        }
    }

    /// Queues a state of a device, in place of an older one that still waits.
    pub fn state(&self, device: u8, text: &Arc<str>) {
        let list = self.list();
        self.newest().insert(device, Arc::clone(text));
        for viewer in list.iter() {
            viewer.queue().states.insert(device, Arc::clone(text));
            viewer.ready.notify_one();
        }
    }

    /// Queues a text for every page.
    pub fn send(&self, text: &Arc<str>) {
        self.list().iter().for_each(|viewer| viewer.send(Arc::clone(text)));
    }

    /// Queues a text that depends on the page.
    pub fn send_each(&self, text: impl Fn(&Viewer) -> Arc<str>) {
        self.list().iter().for_each(|viewer| viewer.send(text(viewer)));
    }

    /// The newest state of each device.
    pub fn states(&self) -> Vec<Arc<str>> {
        self.newest().values().cloned().collect()
    }

    fn newest(&self) -> MutexGuard<'_, BTreeMap<u8, Arc<str>>> {
        self.states.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn list(&self) -> MutexGuard<'_, Vec<Arc<Viewer>>> {
        self.list.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::stream::frame::Point;
    use crate::stream::{DeviceInfo, Kind};
    use shared::breath::Phase;

    fn viewers() -> (Arc<Metrics>, Viewers) {
        let device = |id| DeviceInfo { id, name: format!("lung {id}"), kind: Kind::Board, period_us: 1000 };
        let metrics = Arc::new(Metrics::new(&[device(0), device(1)]));
        (Arc::clone(&metrics), Viewers::new(metrics))
    }

    fn frame(device: u8, first_tick: u64) -> Arc<Frame> {
        let point = Point {
            pressure: 5.0,
            target: 5.0,
            u_in: 0.0,
            u_out: 100.0,
            learned: 0.0,
            flow: 0.0,
            volume: 0.0,
            phase: Phase::Fall,
        };
        Arc::new(Frame::new(device, first_tick, 0.0, &[point; 10]))
    }

    /// Everything that waits for a page.
    fn waiting(viewer: &Viewer) -> Vec<Outgoing> {
        std::iter::from_fn(|| viewer.queue().next()).collect()
    }

    #[test]
    fn a_page_that_opens_gets_the_newest_state_of_each_device() {
        let (_, viewers) = viewers();
        for (device, text) in [(0, "old"), (1, "other"), (0, "new")] {
            viewers.state(device, &text.into());
        }
        let states = [Outgoing::Text("new".into()), Outgoing::Text("other".into())];
        assert_eq!(waiting(&viewers.add("here", 2).unwrap()), states);
        assert_eq!(viewers.states(), ["new".into(), "other".into()]);
    }

    /// The first tick of a message, and the samples lost before it.
    fn read(message: &Outgoing) -> (u64, u32) {
        let Outgoing::Binary(bytes) = message else { panic!("a text") };
        let tick = f64::from_le_bytes(bytes[8..16].try_into().unwrap()) as u64;
        (tick, u32::from_le_bytes(bytes[4..8].try_into().unwrap()))
    }

    #[test]
    fn a_full_queue_loses_the_oldest_samples_and_counts_them() {
        let (metrics, viewers) = viewers();
        let slow = viewers.add("here", 2).unwrap();
        let quick = viewers.add("there", 2).unwrap();
        for number in 0..300 {
            viewers.samples(&frame(0, 10 * number));
            let all = waiting(&quick);
            assert_eq!(read(&all[0]), (10 * number, 0), "the other page gets everything at once");
        }
        let left: Vec<_> = waiting(&slow).iter().map(read).collect();
        assert_eq!(left.len(), FRAMES_MAX);
        assert_eq!((left[0], left[255]), ((440, 440), (2990, 440)));
        assert!(metrics.text().contains("eupnea_viewer_dropped_samples_total{device=\"lung 0\"} 440"));
        assert!(metrics.text().contains("eupnea_viewer_dropped_samples_total{device=\"lung 1\"} 0"));
    }

    #[test]
    fn only_the_newest_state_of_a_device_waits() {
        let (_, viewers) = viewers();
        let viewer = viewers.add("here", 2).unwrap();
        let text = |text: &str| Arc::<str>::from(text);
        viewers.state(1, &text("old"));
        viewers.state(0, &text("other"));
        viewers.state(1, &text("new"));
        viewers.send(&text("answer"));
        let expected = ["answer", "other", "new"].map(|t| Outgoing::Text(text(t)));
        assert_eq!(waiting(&viewer), expected);
    }

    #[test]
    fn a_page_gets_the_samples_that_it_watches() {
        let (metrics, viewers) = viewers();
        let viewer = viewers.add("here", 2).unwrap();
        viewers.samples(&frame(0, 0));
        viewer.watch([1, 77]);
        viewers.samples(&frame(0, 10));
        viewers.samples(&frame(1, 20));
        assert_eq!(waiting(&viewer).iter().map(read).collect::<Vec<_>>(), [(20, 0)]);
        viewers.remove(viewer.number);
        viewers.samples(&frame(1, 30));
        assert_eq!(waiting(&viewer), []);
        assert!(metrics.text().contains("eupnea_viewers 0"));
    }

    #[test]
    fn a_page_that_loses_a_text_or_has_an_old_greeting_starts_again() {
        let runtime = tokio::runtime::Builder::new_current_thread().build().unwrap();
        let (_, viewers) = viewers();
        let viewer = viewers.add("here", 2).unwrap();
        (0..TEXTS_MAX).for_each(|_| viewers.send(&Arc::from("text")));
        assert!(runtime.block_on(viewer.next()).is_some(), "all of them fit");
        viewers.send(&Arc::from("it fits again"));
        viewers.send(&Arc::from("one too many"));
        assert_eq!(runtime.block_on(viewer.next()), None);
        let other = viewers.add("there", 2).unwrap();
        viewers.restart();
        assert_eq!(runtime.block_on(other.next()), None);
        assert!(viewers.is_open(other.number));
        viewers.remove(other.number);
        assert!(!viewers.is_open(other.number));
    }

    #[test]
    fn there_are_not_more_pages_than_the_server_feeds() {
        let (_, viewers) = viewers();
        let numbers: BTreeSet<u64> =
            (0..VIEWERS_MAX).map(|_| viewers.add("here", 1).unwrap().number).collect();
        assert_eq!(numbers.len(), VIEWERS_MAX);
        assert!(viewers.add("here", 1).is_none() && viewers.is_full());
    }
}
