//! Messages from a page.

use std::collections::BTreeMap;
use std::fmt;

use serde::{Deserialize, Serialize};

use super::Sines;

/// A text that must not reach a log.
#[derive(Clone, PartialEq, Eq, Deserialize)]
#[serde(transparent)]
pub struct Secret(pub String);

impl fmt::Debug for Secret {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("(hidden)")
    }
}

/// A message of a page.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(tag = "type", rename_all = "snake_case", deny_unknown_fields)]
pub enum FromPage {
    /// The token of the address, as the first message.
    Token {
        /// The token.
        token: Secret,
    },
    /// The devices whose samples the page wants.
    Watch {
        /// Their numbers.
        devices: Vec<u8>,
    },
    /// Steer a device from this page.
    Take {
        /// The device.
        device: u8,
        /// Whether to take it from another page, which only a person may decide.
        #[serde(default)]
        take_over: bool,
    },
    /// Stop steering it.
    Release {
        /// The device.
        device: u8,
    },
    /// The first tick that the page has newly drawn since its last report, for the latency: the one that waited longest.
    Drawn {
        /// The device.
        device: u8,
        /// The tick.
        tick: u64,
    },
    /// Change settings from the next breath on.
    Apply {
        /// For the answer.
        id: u32,
        /// The device.
        device: u8,
        /// The settings to change, by name.
        settings: BTreeMap<String, f32>,
    },
    /// Start ventilation.
    Start {
        /// For the answer.
        id: u32,
        /// The device.
        device: u8,
    },
    /// Stop ventilation.
    Stop {
        /// For the answer.
        id: u32,
        /// The device.
        device: u8,
    },
    /// Acknowledge all alarms.
    Acknowledge {
        /// For the answer.
        id: u32,
        /// The device.
        device: u8,
    },
    /// Pause the sounder.
    PauseAudio {
        /// For the answer.
        id: u32,
        /// The device.
        device: u8,
        /// Length of the pause, s; 0 ends it.
        seconds: u16,
    },
    /// Mark this moment.
    Mark {
        /// For the answer.
        id: u32,
        /// The device.
        device: u8,
        /// The marker's text.
        text: String,
    },
    /// Start or end a recording.
    Record {
        /// For the answer.
        id: u32,
        /// The device.
        device: u8,
        /// Whether to record.
        on: bool,
    },
    /// Arm the triggered capture.
    Capture {
        /// For the answer.
        id: u32,
        /// The device.
        device: u8,
        /// What triggers it; nothing disarms it.
        triggers: Triggers,
    },
    /// Read the event log of the device's flight recorder.
    Recorder {
        /// For the answer.
        id: u32,
        /// The device.
        device: u8,
    },
    /// Measure the margins of a device that ventilates a test lung.
    Measure {
        /// For the answer.
        id: u32,
        /// The device.
        device: u8,
        /// Whether a person has confirmed that a test lung is connected, and no patient.
        test_lung: bool,
        /// The sines to add to the command.
        sines: Sines,
    },
    /// Stop measuring.
    StopMeasuring {
        /// For the answer.
        id: u32,
        /// The device.
        device: u8,
    },
    /// Inject a fault into a device of the demonstration.
    Fault {
        /// For the answer.
        id: u32,
        /// The device.
        device: u8,
        /// The fault.
        fault: DemoFault,
    },
}

impl FromPage {
    /// Id for the answer; none for a message that gets none.
    pub fn id(&self) -> Option<u32> {
        match self {
            Self::Apply { id, .. }
            | Self::Start { id, .. }
            | Self::Stop { id, .. }
            | Self::Acknowledge { id, .. }
            | Self::PauseAudio { id, .. }
            | Self::Mark { id, .. }
            | Self::Record { id, .. }
            | Self::Capture { id, .. }
            | Self::Recorder { id, .. }
            | Self::Measure { id, .. }
            | Self::StopMeasuring { id, .. }
            | Self::Fault { id, .. } => Some(*id),
            Self::Token { .. }
            | Self::Watch { .. }
            | Self::Take { .. }
            | Self::Release { .. }
            | Self::Drawn { .. } => None,
        }
    }

    /// The device that it is about.
    pub fn device(&self) -> Option<u8> {
        match self {
            Self::Apply { device, .. }
            | Self::Start { device, .. }
            | Self::Stop { device, .. }
            | Self::Acknowledge { device, .. }
            | Self::PauseAudio { device, .. }
            | Self::Mark { device, .. }
            | Self::Record { device, .. }
            | Self::Capture { device, .. }
            | Self::Recorder { device, .. }
            | Self::Measure { device, .. }
            | Self::StopMeasuring { device, .. }
            | Self::Fault { device, .. }
            | Self::Take { device, .. }
            | Self::Release { device }
            | Self::Drawn { device, .. } => Some(*device),
            Self::Token { .. } | Self::Watch { .. } => None,
        }
    }

    /// Reads a message.
    ///
    /// # Errors
    /// Why it is not one.
    pub fn parse(text: &str) -> Result<Self, serde_json::Error> {
        serde_json::from_str(text)
    }
}

/// What triggers a capture.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Triggers {
    /// Any alarm that begins.
    pub alarm: bool,
    /// A breath with more overshoot, cmH2O.
    pub overshoot: Option<f32>,
    /// A pressure above this, cmH2O.
    pub pressure: Option<f32>,
}

impl Triggers {
    /// Whether anything can trigger it.
    pub fn is_armed(&self) -> bool {
        self.alarm || self.overshoot.is_some() || self.pressure.is_some()
    }

    /// Checks the thresholds.
    ///
    /// # Errors
    /// A text that names the threshold that cannot trigger anything.
    pub fn check(&self) -> Result<(), String> {
        let wrong = [("overshoot", self.overshoot), ("pressure", self.pressure)]
            .into_iter()
            .find(|(_, limit)| limit.is_some_and(|limit| !(limit.is_finite() && limit > 0.0)));
        wrong.map_or(Ok(()), |(name, _)| {
            Err(format!("the threshold of the {name} must be a number above 0 cmH2O"))
        })
    }
}

/// A fault of the demonstration.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum DemoFault {
    /// The tube comes off.
    Disconnect,
    /// The patient coughs.
    Cough,
    /// The reading of the pressure sensor sticks.
    Stick,
    /// All faults end.
    None,
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    #[test]
    fn a_threshold_that_nothing_can_exceed_or_that_all_exceed_is_wrong() {
        let with = |pressure| Triggers { pressure: Some(pressure), ..Triggers::default() };
        assert_eq!(with(30.0).check(), Ok(()));
        for wrong in [0.0, -1.0, f32::NAN, f32::INFINITY] {
            assert!(with(wrong).check().unwrap_err().contains("pressure"), "{wrong}");
        }
    }

    #[test]
    fn a_page_takes_over_only_if_it_says_so() {
        let take = |text| FromPage::parse(text).unwrap();
        let plain = FromPage::Take { device: 1, take_over: false };
        assert_eq!(take(r#"{"type":"take","device":1}"#), plain);
        assert_ne!(take(r#"{"type":"take","device":1,"take_over":true}"#), plain);
    }

    #[test]
    fn a_request_is_read_and_an_unknown_one_is_not() {
        let apply = FromPage::parse(r#"{"type":"apply","id":7,"device":0,"settings":{"pip":25}}"#).unwrap();
        let settings = BTreeMap::from([("pip".to_owned(), 25.0)]);
        assert_eq!(apply, FromPage::Apply { id: 7, device: 0, settings });
        for wrong in [
            r#"{"type":"shell","id":7}"#,
            r#"{"type":"start","device":0}"#,
            r#"{"type":"start","id":1,"device":256}"#,
            r#"{"type":"start","id":1,"device":0,"force":true}"#,
            r#"{"type":"fault","id":1,"device":0,"fault":"fire"}"#,
            "[]",
            "",
        ] {
            assert!(FromPage::parse(wrong).is_err(), "{wrong}");
        }
    }

    proptest! {
        #[test]
        fn no_text_of_a_page_causes_a_panic(text in ".{0,200}") {
            let _ = FromPage::parse(&text);
        }
    }
}
