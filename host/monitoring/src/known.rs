//! What is known about a device from its news.

use shared::device::annunciator::AudioStatus;
use shared::link::messages::{AlarmStatus, ControllerChoice, DeviceIdentity, Event, LeaseStatus, Response};
use shared::safety::alarms::Action;
use shared::settings::Settings;
use shared::timing::TickTimes;
use shared::ventilator::Mode;

use crate::{LineCounters, News};

/// What the device has reported, for other ways to show it; none of it before the first answers.
#[derive(Clone, Copy, Debug)]
pub struct Known<'a> {
    /// Why the connection is lost, if it is.
    pub lost: Option<&'a str>,
    /// The greeting.
    pub identity: Option<&'a DeviceIdentity>,
    /// The mode now.
    pub mode: Option<Mode>,
    /// The chosen controller.
    pub controller: Option<ControllerChoice>,
    /// Settings of the running breath.
    pub in_force: Option<&'a Settings>,
    /// Settings that wait for the next breath.
    pub pending: Option<&'a Settings>,
    /// Statistics of the control ticks.
    pub times: Option<&'a TickTimes>,
    /// Alarms, and the level of the ladder.
    pub status: Option<&'a AlarmStatus>,
    /// State of the sounder.
    pub audio: Option<AudioStatus>,
    /// Who steers the device.
    pub lease: Option<&'a LeaseStatus>,
    /// Counters of the line.
    pub traffic: LineCounters,
}

/// Collects what a device reports.
#[derive(Clone, Debug, Default)]
pub struct Reported {
    lost: Option<String>,
    identity: Option<DeviceIdentity>,
    mode: Option<Mode>,
    controller: Option<ControllerChoice>,
    in_force: Option<Settings>,
    pending: Option<Settings>,
    times: Option<TickTimes>,
    status: Option<AlarmStatus>,
    audio: Option<AudioStatus>,
    lease: Option<LeaseStatus>,
    traffic: LineCounters,
}

impl Reported {
    /// What the device has reported.
    pub fn known(&self) -> Known<'_> {
        Known {
            lost: self.lost.as_deref(),
            identity: self.identity.as_ref(),
            mode: self.mode,
            controller: self.controller,
            in_force: self.in_force.as_ref(),
            pending: self.pending.as_ref(),
            times: self.times.as_ref(),
            status: self.status.as_ref(),
            audio: self.audio,
            lease: self.lease.as_ref(),
            traffic: self.traffic,
        }
    }

    /// Takes a piece of news.
    pub fn take(&mut self, news: &News) {
        match news {
            News::Event(Event::Alarm { fault, .. }) => {
                if fault.alarm().action == Action::Vent {
                    self.mode = Some(Mode::Fault(*fault));
                }
            }
            News::Answer { result: Ok(response), .. } => self.learn(response),
            News::Traffic(traffic) => self.traffic = *traffic,
            News::Lost(reason) => {
                self.forget_what_steers();
                self.lost = Some(reason.clone());
            }
            News::Event(_) | News::Answer { .. } => {}
        }
    }

    /// Records the state that the device reports as in force.
    fn learn(&mut self, response: &Response) {
        match response {
            Response::Identity(identity) => {
                self.lost = None;
                (self.mode, self.controller) = (Some(identity.mode), Some(identity.controller));
                self.identity = Some(identity.clone());
            }
            Response::Settings { in_force, pending } => {
                (self.in_force, self.pending) = (Some(*in_force), *pending);
            }
            Response::Mode(mode) => self.mode = Some(*mode),
            Response::Controller(choice) => self.controller = Some(*choice),
            Response::Alarms(alarms) => self.status = Some(*alarms),
            Response::Audio(audio) => self.audio = Some(*audio),
            Response::Lease(status) => self.lease = Some(*status),
            Response::Timing(times) => {
                if self.times.is_some_and(|before| times.ticks < before.ticks) {
                    self.forget_what_steers();
                }
                self.times = Some(*times);
            }
            _ => {}
        }
    }

    /// After a lost line or a restart the device may have other settings: a change of the old ones must not reach it.
    fn forget_what_steers(&mut self) {
        (self.in_force, self.pending) = (None, None);
        (self.audio, self.lease) = (None, None);
    }
}
