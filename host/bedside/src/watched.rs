//! What is known about a device, and the messages that its news become. Reads no clock: times are in ms since 1970.

use std::collections::{BTreeMap, VecDeque};
use std::ops::Range;

use monitoring::reported::Reported;
use monitoring::ticks::Evenness;
use monitoring::{News, POLLED, words};
use shared::control::memory::{LEARNING, Lesson};
use shared::link::messages::{ControllerChoice, Event, LeaseStatus, Request, Response};
use shared::link::telemetry::{BreathSummary, TelemetryBatch};
use shared::safety::alarms::{Fault, Priority};
use shared::safety::ladder::Level;
use shared::settings::Settings;
use shared::ventilator::Mode;

use crate::alarms::AlarmList;
use crate::figures::BreathMeter;
use crate::stream::frame::{Frame, Point, SAMPLES_MAX};
use crate::stream::{
    Adaptation, Audio, EventKind, LineInfo, Missing, RecordingInfo, State, Ticks, ToPage, Triggers,
};

/// Time without answers after which a device counts as lost, ms: it is asked once a second, and again 1.5 s after a request that the
/// line has lost.
const UNANSWERED_MS: u64 = 3000;
/// Time without samples after which a device that ventilates counts as lost, ms.
const UNSAMPLED_MS: u64 = 800;
/// Largest number of things that a page is told about a device that is wrong in ever new ways.
const COMPLAINTS: usize = 16;
/// Arrivals that are remembered for the latencies: ten seconds of a chip's batches.
const ARRIVALS: usize = 640;

/// Numbers of a device.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct DeviceNumbers {
    /// Samples received.
    pub samples: u64,
    /// Batches of samples lost on the line.
    pub lost_batches: u64,
    /// Damaged frames.
    pub corrupt: u64,
    /// Reports that the device dropped.
    pub reports_dropped: u64,
    /// Whether it answers.
    pub connected: bool,
    /// Whether it ventilates, as far as its line is there.
    pub ventilating: bool,
    /// Indicated alarms of high, medium and low priority.
    pub alarms: [u64; 3],
}

/// A message that a piece of news becomes.
#[derive(Clone, Debug, PartialEq)]
pub enum Out {
    /// Samples.
    Frame(Frame),
    /// Text.
    Message(ToPage),
}

/// A watched device.
pub struct Watched {
    device: u8,
    period_us: u32,
    reported: Reported,
    meter: BreathMeter,
    /// What the device has reported of its last breath.
    summary: Option<BreathSummary>,
    alarms: AlarmList,
    /// Samples that are not sent yet, and the tick of the first one.
    points: Vec<Point>,
    first_tick: u64,
    came_ms: u64,
    /// When batches came: their ticks, and the time.
    arrivals: VecDeque<(Range<u64>, u64)>,
    /// When the device last answered; none before.
    answered_ms: Option<u64>,
    /// When the last samples came, or when they became due.
    sampled_ms: Option<u64>,
    /// Whether it is a replay, whose samples have gaps.
    replays: bool,
    /// Losses on all lines so far, and on those before the one that is open.
    line: LineInfo,
    before: LineInfo,
    samples: u64,
    breath: Option<u32>,
    /// Number of the ticks' statistics, which a restart sets back.
    ticks: u32,
    /// What the device does not report, or reports wrongly, in words, and whether pages were told.
    complaints: BTreeMap<String, bool>,
}

impl Watched {
    /// A device of which nothing is reported.
    pub fn new(device: u8, period_us: u32) -> Self {
        Self {
            device,
            period_us,
            reported: Reported::default(),
            meter: BreathMeter::new(period_us),
            summary: None,
            alarms: AlarmList::default(),
            points: Vec::new(),
            first_tick: 0,
            came_ms: 0,
            arrivals: VecDeque::new(),
            answered_ms: None,
            sampled_ms: None,
            replays: false,
            line: LineInfo::default(),
            before: LineInfo::default(),
            samples: 0,
            breath: None,
            ticks: 0,
            complaints: BTreeMap::new(),
        }
    }

    /// The same, of a replay if `replays`.
    #[must_use]
    pub fn replaying(self, replays: bool) -> Self {
        Self { replays, ..self }
    }

    /// Control period, microseconds.
    pub fn period_us(&self) -> u32 {
        self.period_us
    }

    /// What the device has reported.
    pub fn reported(&self) -> &Reported {
        &self.reported
    }

    /// Settings that apply next, if they are reported.
    pub fn settings(&self) -> Option<&Settings> {
        self.reported.pending.as_ref().or(self.reported.in_force.as_ref())
    }

    /// Takes a piece of news; samples wait for [`Self::flush`].
    pub fn take(&mut self, news: &News, now_ms: u64, out: &mut Vec<Out>) {
        let (connected, sampled) = (self.is_connected(), self.is_sampled());
        self.reported.take(news);
        if self.is_sampled() && !sampled {
            self.sampled_ms = Some(now_ms);
        }
        match news {
            News::Event(event) => self.happened(event, now_ms, out),
            News::Answer { result: Ok(response), request } => {
                self.answered_ms = Some(now_ms);
                self.answered(request, response, now_ms, out);
            }
            News::Lost(reason) if connected => {
                self.answered_ms = None;
                // Requests that failed with the line are part of its loss.
                self.complaints.retain(|_, told| *told);
                self.summary = None;
                // The next line counts from zero.
                self.before = self.line;
                out.push(self.event(now_ms, EventKind::Lost, reason));
            }
            News::Traffic(traffic) => {
                self.line = LineInfo {
                    corrupt: self.before.corrupt + traffic.corrupt,
                    lost_batches: self.before.lost_batches + traffic.lost_batches,
                    dropped: traffic.device.dropped,
                };
                self.tell_complaints(now_ms, out);
            }
            News::Answer { result: Err(reason), request } if POLLED.contains(request) => {
                self.complain(format!("not shown: {reason}"));
            }
            News::Answer { .. } | News::Lost(_) => {}
        }
    }

    /// Notes what is wrong with the device, until the line has shown that it is not the line.
    fn complain(&mut self, what: String) {
        if self.complaints.len() < COMPLAINTS {
            self.complaints.entry(what).or_insert(false);
        }
    }

    fn tell_complaints(&mut self, now_ms: u64, out: &mut Vec<Out>) {
        let untold = self.complaints.iter().filter(|(_, told)| !**told);
        out.extend(untold.map(|(text, _)| self.event(now_ms, EventKind::Device, text)));
        self.complaints.values_mut().for_each(|told| *told = true);
    }

    fn is_connected(&self) -> bool {
        self.reported.lost.is_none()
    }

    /// Number of the newest breath; none before the first sample.
    pub fn newest_breath(&self) -> Option<u32> {
        self.breath
    }

    /// Whether it should send samples.
    pub fn is_sampled(&self) -> bool {
        self.is_connected() && self.reported.mode == Some(Mode::Ventilating)
    }

    fn happened(&mut self, event: &Event, now_ms: u64, out: &mut Vec<Out>) {
        match event {
            Event::Telemetry(batch) => self.samples(batch, now_ms, out),
            // The meter makes the other figures of the samples.
            Event::Breath(summary) => {
                self.meter.leak(summary.leak);
                self.summary = Some(*summary);
            }
            Event::Alarm { fault, .. } => {
                let new = self.alarms.began(*fault, now_ms);
                self.alarm(*fault, new, now_ms, out);
            }
            Event::Unacknowledged { fault, .. } => {
                let new = self.alarms.repeated(*fault, now_ms);
                self.alarm(*fault, new, now_ms, out);
            }
        }
    }

    fn alarm(&self, fault: Fault, new: bool, now_ms: u64, out: &mut Vec<Out>) {
        if new {
            out.push(self.event(now_ms, EventKind::Alarm, words::fault(fault)));
        }
    }

    fn samples(&mut self, batch: &TelemetryBatch, now_ms: u64, out: &mut Vec<Out>) {
        for (tick, packed) in (batch.first_tick..).zip(&batch.samples) {
            let sample = packed.unpack();
            // A file lacks what no device does, such as the learned part.
            let impossible = if self.replays { None } else { words::impossible(&sample) };
            if let Some(what) = impossible {
                self.complain(format!("samples left out: the device sends {what} (docs/DEVICE_LINK.md)"));
                continue;
            }
            let follows = tick == self.first_tick + self.points.len() as u64;
            if !follows || self.points.len() == SAMPLES_MAX {
                self.flush(out);
            }
            if self.points.is_empty() {
                self.first_tick = tick;
            }
            self.breath = Some(sample.breath);
            let (point, figures) = self.meter.take(tick, &sample, self.reported.in_force.as_ref());
            self.points.push(point);
            let device = self.device;
            out.extend(
                figures.map(|figures| Out::Message(ToPage::Breath { device, time_ms: now_ms, figures })),
            );
        }
        self.samples += batch.samples.len() as u64;
        self.came_ms = now_ms;
        self.sampled_ms = Some(now_ms);
        let past = batch.first_tick + batch.samples.len() as u64;
        self.arrivals.push_back((batch.first_tick..past, now_ms));
        if self.arrivals.len() > ARRIVALS {
            self.arrivals.pop_front();
        }
    }

    /// Gives out the waiting samples.
    pub fn flush(&mut self, out: &mut Vec<Out>) {
        if !self.points.is_empty() {
            out.push(Out::Frame(Frame::new(self.device, self.first_tick, self.came_ms as f64, &self.points)));
            self.first_tick += self.points.len() as u64;
            self.points.clear();
        }
    }

    fn answered(&mut self, request: &Request, response: &Response, now_ms: u64, out: &mut Vec<Out>) {
        match response {
            Response::Identity(identity) => self.know_period(identity.period_us, out),
            Response::Alarms(status) => {
                // Those whose own message was lost.
                for fault in self.alarms.report(status, now_ms) {
                    self.alarm(fault, true, now_ms, out);
                }
            }
            Response::Audio(audio) => self.alarms.heard(audio),
            Response::Timing(times) => {
                let restarted = times.ticks < self.ticks;
                self.ticks = times.ticks;
                if restarted {
                    self.restarted(now_ms, out);
                }
            }
            _ if *request == Request::Acknowledge => self.alarms.acknowledge(),
            _ => {}
        }
    }

    fn restarted(&mut self, now_ms: u64, out: &mut Vec<Out>) {
        self.start_afresh(out);
        self.alarms.clear();
        if let Some(status) = &self.reported.status {
            // The report of the same poll, from after the restart.
            self.alarms.report(status, now_ms);
        }
        let cause =
            self.reported.identity.as_ref().map_or("unknown cause", |identity| words::reset(identity.reset));
        out.push(self.event(now_ms, EventKind::Restarted, &format!("the device restarted: {cause}")));
    }

    /// Forgets the running breath.
    fn start_afresh(&mut self, out: &mut Vec<Out>) {
        self.flush(out);
        self.meter = BreathMeter::new(self.period_us);
        self.summary = None;
        self.arrivals.clear();
    }

    /// Takes the control period, which is another one if another device is plugged in.
    fn know_period(&mut self, period_us: u32, out: &mut Vec<Out>) {
        if period_us > 0 && period_us != self.period_us {
            self.period_us = period_us;
            self.start_afresh(out);
        }
    }

    /// How far the learned controller has adapted to the patient; none if another one is chosen, or before its first breath.
    fn adaptation(&self) -> Option<Adaptation> {
        let summary = self.summary.filter(|_| self.reported.controller == Some(ControllerChoice::Learned))?;
        let last = match summary.lesson {
            Lesson::Adopt => "adopted",
            Lesson::Discard => "discarded",
            Lesson::Forget => "all forgotten",
        };
        Some(Adaptation { breaths: summary.adopted, of: LEARNING, last })
    }

    fn event(&self, time_ms: u64, kind: EventKind, text: &str) -> Out {
        let tick = self.newest_tick();
        Out::Message(ToPage::Event { device: self.device, time_ms, kind, text: text.to_owned(), tick })
    }

    /// The tick of the newest sample; none before the first one.
    pub fn newest_tick(&self) -> Option<u64> {
        (self.samples > 0).then(|| (self.first_tick + self.points.len() as u64).saturating_sub(1))
    }

    /// Time from a control tick until now, ms; none if the tick is not remembered. A batch counts as sent at its last tick and as having
    /// taken no time on the line.
    pub fn latency_ms(&self, tick: u64, now_ms: u64) -> Option<u64> {
        let (ticks, came_ms) = self.arrivals.iter().find(|(ticks, _)| ticks.contains(&tick))?;
        let waited_us = (ticks.end - 1 - tick) * u64::from(self.period_us);
        Some(now_ms.saturating_sub(*came_ms) + waited_us / 1000)
    }

    /// What is missing from the device, if anything is, and why in words, which stay the same while it is missing.
    fn lost(&self, now_ms: u64) -> Option<(Missing, String)> {
        let silent = |since_ms: u64, limit_ms: u64| now_ms.saturating_sub(since_ms) > limit_ms;
        let because = |missing, why: &str| Some((missing, why.to_owned()));
        if let Some(lost) = &self.reported.lost {
            return because(Missing::Line, lost);
        }
        match self.answered_ms {
            None => return because(Missing::Answers, "waiting for the device's first answer"),
            Some(answered) if silent(answered, UNANSWERED_MS) => {
                return because(Missing::Answers, "the device does not answer");
            }
            Some(_) => {}
        }
        let unsampled = !self.replays && self.is_sampled();
        if unsampled && self.sampled_ms.is_none_or(|sampled| silent(sampled, UNSAMPLED_MS)) {
            return because(Missing::Samples, "the device ventilates, but no samples arrive");
        }
        None
    }

    /// The state to show. `page` is the page that steers, `recording` the recording that is being written, `triggers` are armed.
    pub fn state(
        &self,
        now_ms: u64,
        page: Option<&str>,
        recording: Option<RecordingInfo>,
        triggers: Option<Triggers>,
    ) -> State {
        let reported = &self.reported;
        let (missing, lost) = self.lost(now_ms).unzip();
        let audio = reported.audio.unwrap_or_default();
        State {
            device: self.device,
            connected: lost.is_none(),
            lost,
            missing,
            mode: reported.mode.map(words::mode).unwrap_or_default(),
            safe_state: matches!(reported.mode, Some(Mode::Fault(_))),
            ventilating: reported.mode == Some(Mode::Ventilating),
            controller: reported.controller.map(words::controller).unwrap_or_default(),
            level: reported
                .status
                .as_ref()
                .map_or("", |status| in_command(status.level, reported.controller)),
            distrust: self.alarms.distrust(),
            adaptation: self.adaptation(),
            settings: reported.in_force,
            pending: reported.pending,
            alarms: self.alarms.list(),
            audio: Audio { priority: audio.priority.map(Priority::name), pause_left: audio.pause_left },
            steered_by: page.map(str::to_owned),
            lease: reported.lease.as_ref().and_then(holder),
            measuring: None,
            ticks: self.ticks(),
            line: self.line,
            recording,
            triggers,
        }
    }

    fn ticks(&self) -> Ticks {
        self.reported.times.as_ref().map_or_else(Ticks::default, |times| {
            // A simulated device has no core clock: all its times are zero.
            let us = |cycles: f32| (times.work.longest > 0).then(|| times.microseconds(cycles));
            let (mean_us, worst_us) = (us(times.work.mean), us(times.work.longest as f32));
            let even = Evenness::of(times, self.period_us);
            let (bias_us, jitter_us) = even.map(|even| (even.bias_us, even.jitter_us)).unzip();
            Ticks { mean_us, worst_us, bias_us, jitter_us, missed: times.missed }
        })
    }

    /// The numbers for the metrics.
    pub fn numbers(&self, now_ms: u64) -> DeviceNumbers {
        let LineInfo { corrupt, lost_batches, dropped } = self.line;
        DeviceNumbers {
            samples: self.samples,
            lost_batches,
            corrupt,
            reports_dropped: dropped.into(),
            connected: self.lost(now_ms).is_none(),
            ventilating: self.is_sampled(),
            alarms: [Priority::High, Priority::Medium, Priority::Low]
                .map(|priority| self.alarms.count(priority) as u64),
        }
    }
}

/// What commands the inspiratory valve, as a word of the stream.
fn in_command(level: Level, controller: Option<ControllerChoice>) -> &'static str {
    match (level, controller) {
        (Level::Learned, Some(ControllerChoice::Learned)) => "learned",
        (Level::Learned | Level::Pid, _) => "pid",
        (Level::CappedPid, _) => "capped",
        (Level::Backup, _) => "backup",
    }
}

/// The program that holds the lease; none if none does.
fn holder(lease: &LeaseStatus) -> Option<String> {
    lease
        .holder
        .as_ref()
        .map(|holder| if lease.yours { "this server".to_owned() } else { holder.to_string() })
}

#[cfg(test)]
mod tests;
