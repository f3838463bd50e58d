//! What is known about a device, and the messages that its news become. Reads no clock: times are in ms since 1970.

use std::collections::VecDeque;
use std::ops::Range;

use learn::controller::shipped;
use shared::control::pid::PidGains;
use shared::link::messages::{ControllerChoice, DeviceIdentity, Event, LeaseStatus, Request, Response};
use shared::link::telemetry::TelemetryBatch;
use shared::safety::alarms::{Fault, Priority};
use shared::safety::ladder::Level;
use shared::settings::Settings;
use shared::ventilator::Mode;
use shared::weights::decode;
use show::monitor::view::{Known, View};
use show::monitor::{News, words};

use crate::alarms::AlarmList;
use crate::figures::BreathMeter;
use crate::metrics::DeviceNumbers;
use crate::stream::frame::{Frame, Point, SAMPLES_MAX};
use crate::stream::{Audio, EventKind, LineInfo, RecordingInfo, State, Ticks, ToPage};

/// Time without news after which a device counts as lost, ms: it is asked once a second, and sends samples while it ventilates.
const SILENT_MS: (u64, u64) = (1500, 800);
/// Arrivals that are remembered for the latencies: ten seconds of a chip's batches.
const ARRIVALS: usize = 640;

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
    view: View,
    meter: BreathMeter,
    /// The controller and the id of the weights, and the gains of the PID in it, if they are known.
    controller: (Option<ControllerChoice>, Option<u32>),
    gains: Option<PidGains>,
    alarms: AlarmList,
    /// Samples that are not sent yet, and the tick of the first one.
    points: Vec<Point>,
    first_tick: u64,
    came_ms: u64,
    /// When batches came: their ticks, and the time.
    arrivals: VecDeque<(Range<u64>, u64)>,
    /// When the device was last heard; none before.
    heard_ms: Option<u64>,
    samples: u64,
    /// Number of the ticks' statistics, which a restart sets back.
    ticks: u32,
}

impl Watched {
    /// A device of which nothing is known.
    pub fn new(device: u8, name: &str, period_us: u32) -> Self {
        Self {
            device,
            period_us,
            view: View::new(name, shared::control::pid::KNOWN_GOOD),
            meter: BreathMeter::new(period_us),
            controller: (None, None),
            gains: None,
            alarms: AlarmList::default(),
            points: Vec::new(),
            first_tick: 0,
            came_ms: 0,
            arrivals: VecDeque::new(),
            heard_ms: None,
            samples: 0,
            ticks: 0,
        }
    }

    /// What the device has reported.
    pub fn known(&self) -> Known<'_> {
        self.view.known()
    }

    /// Settings that apply next, if they are known.
    pub fn settings(&self) -> Option<&Settings> {
        let known = self.view.known();
        known.pending.or(known.in_force)
    }

    /// Takes a piece of news; samples wait for [`Self::flush`].
    pub fn take(&mut self, news: &News, now_ms: u64, out: &mut Vec<Out>) {
        let connected = self.view.known().lost.is_none();
        self.view.take(news);
        match news {
            News::Event(event) => {
                self.heard_ms = Some(now_ms);
                self.happened(event, now_ms, out);
            }
            News::Answer { result: Ok(response), request } => {
                self.heard_ms = Some(now_ms);
                self.answered(request, response, now_ms, out);
            }
            News::Lost(reason) if connected => {
                self.heard_ms = None;
                out.push(self.event(now_ms, EventKind::Lost, reason));
            }
            News::Answer { .. } | News::Traffic(_) | News::Lost(_) => {}
        }
    }

    fn happened(&mut self, event: &Event, now_ms: u64, out: &mut Vec<Out>) {
        match event {
            Event::Telemetry(batch) => self.samples(batch, now_ms, out),
            // The meter makes better figures of the samples.
            Event::Breath(_) => {}
            Event::Alarm { fault, .. } | Event::Unacknowledged { fault, .. } => {
                self.alarm(*fault, now_ms, out);
            }
        }
    }

    fn alarm(&mut self, fault: Fault, now_ms: u64, out: &mut Vec<Out>) {
        if self.alarms.began(fault, now_ms) {
            out.push(self.event(now_ms, EventKind::Alarm, words::fault(fault)));
        }
    }

    fn samples(&mut self, batch: &TelemetryBatch, now_ms: u64, out: &mut Vec<Out>) {
        for (tick, packed) in (batch.first_tick..).zip(&batch.samples) {
            let follows = tick == self.first_tick + self.points.len() as u64;
            if !follows || self.points.len() == SAMPLES_MAX {
                self.flush(out);
            }
            if self.points.is_empty() {
                self.first_tick = tick;
            }
            let (point, figures) = self.meter.take(tick, &packed.unpack(), self.view.known().in_force);
            self.points.push(point);
            let device = self.device;
            out.extend(figures.map(|figures| Out::Message(ToPage::Breath { device, figures })));
        }
        self.samples += batch.samples.len() as u64;
        self.came_ms = now_ms;
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
            Response::Identity(_) | Response::Controller(_) => self.know_controller(),
            Response::Alarms(status) => self.alarms.report(status, now_ms),
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
        self.flush(out);
        self.meter = BreathMeter::new(self.period_us);
        self.meter.gains(self.gains);
        self.arrivals.clear();
        let cause =
            self.view.known().identity.map_or("unknown cause", |identity| words::reset(identity.reset));
        out.push(self.event(now_ms, EventKind::Restarted, &format!("the device restarted: {cause}")));
    }

    /// Looks the controller's gains up, if it is another one: decoding an image takes time.
    fn know_controller(&mut self) {
        let known = self.view.known();
        let controller = (known.controller, known.identity.and_then(DeviceIdentity::running_id));
        if self.controller != controller {
            self.controller = controller;
            self.gains = self.find_gains();
            self.meter.gains(self.gains);
        }
    }

    /// Gains of the PID in the device's controller, as it has reported them or as its weights have them, if those are shipped ones.
    fn find_gains(&self) -> Option<PidGains> {
        let known = self.view.known();
        match known.controller? {
            ControllerChoice::Pid(gains) => Some(gains),
            ControllerChoice::Learned => {
                let running = known.identity?.running_id()?;
                let images = shipped::names().filter_map(|name| decode(shipped::image(name)?).ok());
                images.filter(|image| image.id == running).map(|image| image.residual.pid().gains()).next()
            }
        }
    }

    fn event(&self, time_ms: u64, kind: EventKind, text: &str) -> Out {
        Out::Message(ToPage::Event { device: self.device, time_ms, kind, text: text.to_owned() })
    }

    /// Time from the arrival of a tick until now, ms; none if that is not remembered.
    pub fn latency_ms(&self, tick: u64, now_ms: u64) -> Option<u64> {
        let (_, came) = self.arrivals.iter().find(|(ticks, _)| ticks.contains(&tick))?;
        Some(now_ms.saturating_sub(*came))
    }

    /// Why the device is not heard, if it is not.
    fn lost(&self, now_ms: u64) -> Option<String> {
        let known = self.view.known();
        if let Some(lost) = known.lost {
            return Some(lost.to_owned());
        }
        let Some(heard) = self.heard_ms else { return Some("waiting for the device's first answer".into()) };
        let silent = now_ms.saturating_sub(heard);
        let limit = if known.mode == Some(Mode::Ventilating) { SILENT_MS.1 } else { SILENT_MS.0 };
        (silent > limit).then(|| format!("the device has been silent for {:.1} s", silent as f64 * 1e-3))
    }

    /// The state to show. `page` is the page that steers, `recording` the recording that is being written.
    pub fn state(&self, now_ms: u64, page: Option<&str>, recording: Option<RecordingInfo>) -> State {
        let known = self.view.known();
        let lost = self.lost(now_ms);
        let audio = known.audio.unwrap_or_default();
        State {
            device: self.device,
            connected: lost.is_none(),
            lost,
            mode: known.mode.map(words::mode).unwrap_or_default(),
            ventilating: known.mode == Some(Mode::Ventilating),
            controller: known.controller.map(words::controller).unwrap_or_default(),
            level: known.status.map_or("", |status| level(status.level, known.controller)),
            distrust: self.alarms.distrust(),
            settings: known.in_force.copied(),
            pending: known.pending.copied(),
            alarms: self.alarms.list(),
            audio: Audio { priority: audio.priority.map(words::priority), pause_left: audio.pause_left },
            steered_by: page.map(str::to_owned).or_else(|| known.lease.and_then(holder)),
            ticks: self.ticks(),
            line: self.line(),
            adaptation: None,
            recording,
        }
    }

    fn ticks(&self) -> Ticks {
        self.view.known().times.map_or_else(Ticks::default, |times| Ticks {
            mean_us: times.microseconds(times.work.mean),
            worst_us: times.microseconds(times.work.longest as f32),
            missed: times.missed,
        })
    }

    fn line(&self) -> LineInfo {
        let traffic = self.view.known().traffic;
        LineInfo {
            corrupt: traffic.corrupt,
            lost_batches: traffic.lost_batches,
            dropped: traffic.device.dropped,
        }
    }

    /// The numbers for the metrics.
    pub fn numbers(&self, now_ms: u64) -> DeviceNumbers {
        let LineInfo { corrupt, lost_batches, dropped } = self.line();
        DeviceNumbers {
            samples: self.samples,
            lost_batches,
            corrupt,
            reports_dropped: dropped.into(),
            connected: self.lost(now_ms).is_none(),
            ventilating: self.view.known().mode == Some(Mode::Ventilating),
            alarms: [Priority::High, Priority::Medium, Priority::Low]
                .map(|priority| self.alarms.count(priority) as u64),
        }
    }
}

/// What commands the inspiratory valve.
fn level(level: Level, controller: Option<ControllerChoice>) -> &'static str {
    match (level, controller) {
        (Level::Learned, Some(ControllerChoice::Learned)) => "learned",
        (Level::Learned | Level::Pid, _) => "pid",
        (Level::CappedPid, _) => "capped",
        (Level::Backup, _) => "backup",
    }
}

/// The program that steers; none if it is nobody.
fn holder(lease: &LeaseStatus) -> Option<String> {
    lease.holder.map(|_| words::lease(lease))
}

#[cfg(test)]
mod tests;
