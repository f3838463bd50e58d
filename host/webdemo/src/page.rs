//! What a page gets: its greeting, states when they are due, and messages.

use std::collections::VecDeque;

use bedside::stream::{DeviceInfo, Hello, Limits, STATE_EVERY_MS, SettingInfo, State, ToPage, VERSION};
use bedside::watched::Out;

/// The page's number, for the wheels.
pub const VIEWER: u64 = 0;

/// A message to the page.
#[derive(Clone, Debug, PartialEq)]
pub enum Message {
    /// JSON.
    Text(String),
    /// Samples, in the stream's format.
    Samples(Vec<u8>),
}

impl Message {
    /// A text.
    pub fn text(message: &ToPage) -> Self {
        Self::Text(message.to_json())
    }
}

/// The greeting: what the page may do with these devices.
pub fn hello(demo: bool, devices: Vec<DeviceInfo>) -> ToPage {
    ToPage::Hello(Hello {
        version: VERSION,
        steer: true,
        record: false,
        demo,
        settings: SettingInfo::all(),
        limits: Limits::default(),
        // The fit of a valve's play is not worth its size in a module.
        measure: None,
        devices,
    })
}

/// Queues what a device has for the page; samples only if it is watched.
pub fn hand_on(from: &mut Vec<Out>, watched: bool, to: &mut VecDeque<Message>) {
    for out in from.drain(..) {
        match out {
            Out::Frame(frame) if watched => to.push_back(Message::Samples(frame.bytes(0))),
            Out::Frame(_) => {}
            Out::Message(message) => to.push_back(Message::text(&message)),
        }
    }
}

/// The state of a device that was shown last, and when.
#[derive(Default)]
pub struct Shown(Option<(State, u64)>);

impl Shown {
    /// Lets the next state be shown at once.
    pub fn forget(&mut self) {
        self.0 = None;
    }

    /// Queues the state at this time in ms, if it has changed or is due.
    pub fn update(&mut self, now_ms: u64, state: impl FnOnce() -> State, to: &mut VecDeque<Message>) {
        let age = self.0.as_ref().map(|(_, at)| now_ms.saturating_sub(*at));
        if age.is_some_and(|age| age < STATE_EVERY_MS.0) {
            return;
        }
        let state = state();
        let unchanged = self.0.as_ref().is_some_and(|(shown, _)| *shown == state);
        if unchanged && age.is_some_and(|age| age < STATE_EVERY_MS.1) {
            return;
        }
        self.0 = Some((state.clone(), now_ms));
        to.push_back(Message::text(&ToPage::State(Box::new(state))));
    }
}
