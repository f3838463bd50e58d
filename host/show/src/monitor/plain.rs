//! A device's news as lines, for a terminal, a pipe or a file.
//!
//! A line is written when something changes, not at every poll.

use std::collections::BTreeMap;

use shared::control::memory::LEARNING;
use shared::link::messages::{AlarmStatus, ControllerChoice, Event, LeaseStatus, Request, Response};
use shared::link::telemetry::{BreathSummary, TelemetryBatch};
use shared::safety::alarms::{Action, Fault};
use shared::safety::indications::FaultSet;
use shared::safety::ladder::Level;
use shared::settings::Settings;
use shared::ventilator::Mode;

use super::News;
use super::words;
use device::LineCounters;

/// The state that was written last.
#[derive(Clone, Debug, Default)]
pub struct Lines {
    greeted: bool,
    period_us: u32,
    mode: Option<Mode>,
    controller: Option<ControllerChoice>,
    settings: Option<Settings>,
    level: Option<Level>,
    indicated: Option<FaultSet>,
    paused: bool,
    /// Tick of the last alarm of each kind.
    alarms: BTreeMap<Fault, u64>,
    lease: Option<LeaseStatus>,
    losses: Losses,
    /// Why requests had no answer, by name: the same reason is written once.
    unanswered: BTreeMap<&'static str, String>,
    /// Why the connection was lost, until it is there again.
    lost: Option<String>,
    /// Whether an impossible sample was written.
    impossible: bool,
}

/// Counters that should stay zero.
type Losses = [u64; 5];

impl Lines {
    /// The lines for a piece of news.
    pub fn take(&mut self, news: &News) -> Vec<String> {
        match news {
            News::Event(event) => self.happened(event).into_iter().collect(),
            News::Answer { result: Ok(response), request } => {
                self.unanswered.remove(name(request));
                self.learn(response)
            }
            News::Answer { request, result: Err(reason) } => self.failed(name(request), reason),
            News::Traffic(traffic) => self.traffic(traffic).into_iter().collect(),
            News::Lost(reason) => {
                self.greeted = false;
                let again = self.lost.replace(reason.clone()).is_some_and(|before| before == *reason);
                if again { Vec::new() } else { vec![format!("no connection: {reason}")] }
            }
        }
    }

    /// A device that does not know a polled request would fill the lines.
    fn failed(&mut self, name: &'static str, reason: &str) -> Vec<String> {
        let before = self.unanswered.insert(name, reason.to_owned());
        let again = before.is_some_and(|before| before == reason) && name != ANY_REQUEST;
        if again { Vec::new() } else { vec![format!("{name}: {reason}")] }
    }

    fn happened(&mut self, event: &Event) -> Option<String> {
        match event {
            Event::Telemetry(batch) => self.sampled(batch),
            Event::Breath(breath) => Some(self.ended(breath)),
            Event::Alarm { fault, tick } => Some(self.alarmed(*fault, *tick)),
            Event::Unacknowledged { fault, tick } => {
                (self.alarms.get(fault) != Some(tick)).then(|| self.alarmed(*fault, *tick))
            }
        }
    }

    /// Written once: the device would have to be mended.
    fn sampled(&mut self, batch: &TelemetryBatch) -> Option<String> {
        if self.impossible {
            return None;
        }
        let what = batch.samples.iter().find_map(|sample| words::impossible(&sample.unpack()))?;
        self.impossible = true;
        Some(format!("samples: the device sends {what}; compare its samples with docs/DEVICE_LINK.md"))
    }

    fn ended(&self, breath: &BreathSummary) -> String {
        let BreathSummary { breath, mean_absolute_error, peak_pressure, end_pressure, leak, adopted, .. } =
            *breath;
        let leak = leak.map_or_else(String::new, |leak| format!(", leak {leak:.3} L/s at 1 cmH2O"));
        let learns = self.controller == Some(ControllerChoice::Learned);
        let remembers =
            if learns { format!(", {adopted} of {LEARNING} breaths remembered") } else { String::new() };
        format!(
            "breath {breath}: mean error {mean_absolute_error:.2}, peak {peak_pressure:.1}, \
             end {end_pressure:.1} cmH2O{leak}{remembers}"
        )
    }

    fn alarmed(&mut self, fault: Fault, tick: u64) -> String {
        if fault.alarm().action == Action::Vent {
            self.mode = Some(Mode::Fault(fault));
        }
        self.alarms.insert(fault, tick);
        format!("alarm {}: {}", words::moment(tick, self.period_us), words::fault(fault))
    }

    fn learn(&mut self, response: &Response) -> Vec<String> {
        let mut lines = Vec::new();
        match response {
            Response::Identity(identity) => {
                self.period_us = identity.period_us;
                if !std::mem::replace(&mut self.greeted, true) {
                    self.lost = None;
                    lines.push(format!("device: {}", words::identity(identity)));
                }
                lines.extend(changed(&mut self.mode, identity.mode).map(mode));
                lines.extend(changed(&mut self.controller, identity.controller).map(controller));
            }
            Response::Mode(now) => lines.extend(changed(&mut self.mode, *now).map(mode)),
            Response::Controller(choice) => {
                lines.extend(changed(&mut self.controller, *choice).map(controller));
            }
            Response::Alarms(alarms) => {
                lines.extend(changed(&mut self.level, alarms.level).map(level));
                if changed(&mut self.indicated, alarms.indicated).is_some() {
                    lines.push(indicated(alarms));
                }
            }
            Response::Audio(audio) => {
                let paused = audio.pause_left > 0;
                if std::mem::replace(&mut self.paused, paused) != paused {
                    lines.push(format!("sounder: {}", words::audio(audio)));
                }
            }
            Response::Lease(status) => {
                let line = |now| format!("steered by: {}", words::lease(&now));
                lines.extend(changed(&mut self.lease, *status).map(line));
            }
            Response::Settings { in_force, .. } => {
                lines.extend(
                    changed(&mut self.settings, *in_force)
                        .map(|now| format!("settings: {}", words::settings(&now))),
                );
            }
            _ => {}
        }
        lines
    }

    fn traffic(&mut self, traffic: &LineCounters) -> Option<String> {
        let LineCounters { corrupt, lost_batches, device, .. } = *traffic;
        let [dropped, refused, missed] =
            [device.dropped, device.corrupt_frames, device.missed_ticks].map(u64::from);
        let losses = [corrupt, lost_batches, dropped, refused, missed];
        (std::mem::replace(&mut self.losses, losses) != losses).then(|| {
            format!(
                "losses: {corrupt} frames to the host damaged, {refused} to the device, \
                 {lost_batches} batches lost, {dropped} samples dropped, {missed} ticks missed"
            )
        })
    }
}

fn changed<T: PartialEq + Copy>(known: &mut Option<T>, now: T) -> Option<T> {
    (known.replace(now) != Some(now)).then_some(now)
}

fn mode(now: Mode) -> String {
    format!("mode: {}", words::mode(now))
}

fn level(now: Level) -> String {
    format!("in command: {}", words::level(now))
}

/// All indicated alarms, the most urgent first.
fn indicated(alarms: &AlarmStatus) -> String {
    let list: Vec<_> =
        words::indicated(alarms).into_iter().map(|fault| words::alarm(fault, alarms)).collect();
    format!("indicated alarms: {}", if list.is_empty() { "none".to_owned() } else { list.join("; ") })
}

fn controller(now: ControllerChoice) -> String {
    format!("controller: {}", words::controller(now))
}

/// Name of the requests that no poll makes: each of their refusals is written.
const ANY_REQUEST: &str = "request";

/// Name of a refused request.
fn name(request: &Request) -> &'static str {
    match request {
        Request::Identify => "identify",
        Request::GetSettings => "settings",
        Request::GetAlarms => "alarms",
        Request::GetAudio => "sounder",
        Request::PauseAudio { .. } => "audio pause",
        Request::GetLease => "lease",
        Request::GetTiming { .. } => "tick times",
        Request::Telemetry { .. } => "telemetry",
        _ => ANY_REQUEST,
    }
}
