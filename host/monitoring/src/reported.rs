//! The state of a device, from its news.

use shared::device::annunciator::AudioStatus;
use shared::link::messages::{AlarmStatus, ControllerChoice, DeviceIdentity, Event, LeaseStatus, Response};
use shared::safety::alarms::Action;
use shared::settings::Settings;
use shared::timing::TickTimes;
use shared::ventilator::Mode;

use crate::News;

/// What a device has reported; none of it before the first answers.
#[derive(Clone, Debug, Default)]
pub struct Reported {
    /// Why the connection is lost, if it is.
    pub lost: Option<String>,
    /// The greeting.
    pub identity: Option<DeviceIdentity>,
    /// The mode now.
    pub mode: Option<Mode>,
    /// The chosen controller.
    pub controller: Option<ControllerChoice>,
    /// Settings of the running breath.
    pub in_force: Option<Settings>,
    /// Settings that wait for the next breath.
    pub pending: Option<Settings>,
    /// Statistics of the control ticks.
    pub times: Option<TickTimes>,
    /// Alarms, and the level of the ladder.
    pub status: Option<AlarmStatus>,
    /// State of the sounder.
    pub audio: Option<AudioStatus>,
    /// Who steers the device.
    pub lease: Option<LeaseStatus>,
}

impl Reported {
    /// Takes a piece of news.
    pub fn take(&mut self, news: &News) {
        match news {
            News::Event(Event::Alarm { fault, .. }) => {
                if fault.alarm().action == Action::Vent {
                    self.mode = Some(Mode::Fault(*fault));
                }
            }
            News::Answer { result: Ok(response), .. } => self.learn(response),
            News::Lost(reason) => {
                self.forget_what_steers();
                self.lost = Some(reason.clone());
            }
            News::Event(_) | News::Answer { .. } | News::Traffic(_) => {}
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
