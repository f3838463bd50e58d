//! The ventilator's end of the policy link: the exchanges, and what they tell of the policy.
//!
//! A policy has one state, so ventilations take turns: each begins with Reset, and the frames of two are never mixed. A failure ends
//! the link for good. Whether a policy that was restarted behaved as before would be unknown.

use std::time::{Duration, Instant};

use plant::line::{Address, Line, LineError};
use shared::control::memory::Lesson;
use shared::control::{COMMAND_MAX, Observation};
use thiserror::Error;

use super::account::{Account, Event};
use super::frame::{FRAME_BYTES, PolicyFrame, PolicyMessage, VERSION};

/// What to do about a frame that was not answered.
fn advice(error: &LineError) -> &'static str {
    match error {
        LineError::Gone { .. } => "see what it printed before it ended",
        _ => "it must answer each frame with one, and if it is only slow, raise --policy-timeout",
    }
}

/// Why a policy cannot be used, or can no longer be used.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum PolicyError {
    /// It cannot be reached.
    #[error("{0}")]
    Open(LineError),
    /// A frame was not answered.
    #[error("it did not answer {question}: {error}; {}", advice(error))]
    Line {
        /// The frame.
        question: &'static str,
        /// The reason.
        error: LineError,
    },
    /// The answer is not a frame.
    #[error(
        "it answered {question} with bytes that are not a frame ({bytes}): check start byte, byte order and CRC; a policy on a pipe may print only to standard error"
    )]
    NoFrame {
        /// The frame.
        question: &'static str,
        /// The bytes received.
        bytes: String,
    },
    /// The answer belongs to another frame.
    #[error("it answered frame {asked} with number {told}: it must answer every frame once, with its number")]
    Number {
        /// Number of the frame.
        asked: u16,
        /// Number of the answer.
        told: u16,
    },
    /// The answer is of the wrong kind.
    #[error("it answered {question} with {answer}")]
    Kind {
        /// The frame.
        question: &'static str,
        /// The answer.
        answer: &'static str,
    },
    /// The policy uses another version of the protocol.
    #[error(
        "it uses version {0} of the policy link, but this program uses version {VERSION}: use matching versions"
    )]
    Version(u32),
    /// Two ventilations use it at the same time.
    #[error("two ventilations use it at the same time, but it has one state: let them take turns")]
    Shared,
}

/// The ventilator's end of the link.
pub struct PolicyLink {
    line: Line,
    address: Address,
    /// The only control period that the policy supports, microseconds.
    period_us: Option<u32>,
    /// Number of the last frame.
    number: u16,
    /// What ended the link.
    broken: Option<PolicyError>,
    /// What is known of the policy.
    account: Account,
}

/// Where a ventilation is.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Place {
    /// Number of the ventilation, from 1.
    pub(super) run: u64,
    /// Number of its breath.
    pub(super) breath: u32,
    /// Tick of the breath.
    pub(super) tick: u32,
}

impl Place {
    fn event(self, what: String) -> Event {
        let Self { run, breath, tick } = self;
        Event { run, breath, tick, what }
    }
}

impl PolicyLink {
    /// Connects to a policy, or starts it, and exchanges greetings; every answer may take up to `patience`.
    ///
    /// # Errors
    /// A policy that cannot be reached, does not answer or uses another version.
    pub fn open(address: &Address, patience: Duration) -> Result<Self, PolicyError> {
        let line = Line::open(address, patience).map_err(PolicyError::Open)?;
        let mut link = Self {
            line,
            address: address.clone(),
            period_us: None,
            number: 0,
            broken: None,
            account: Account::default(),
        };
        match link.exchange(PolicyMessage::Hello { version: VERSION })? {
            PolicyMessage::Greeting { version: VERSION, period_us } => {
                link.period_us = (period_us > 0).then_some(period_us);
                Ok(link)
            }
            PolicyMessage::Greeting { version, .. } => Err(PolicyError::Version(version)),
            other => unreachable!("{other:?} was refused as an answer"),
        }
    }

    /// The policy's address.
    pub fn address(&self) -> &Address {
        &self.address
    }

    /// The only control period that the policy supports, microseconds; none if it supports any.
    pub fn period_us(&self) -> Option<u32> {
        self.period_us
    }

    /// What is known of the policy.
    pub fn account(&self) -> &Account {
        &self.account
    }

    /// Counts a tick; see [`Account::count`].
    pub(super) fn count(&mut self, applied: f32, asked: Option<(f32, Option<f32>)>) {
        self.account.count(applied, asked);
    }

    /// Begins a ventilation, and returns its number.
    pub(super) fn reset(&mut self, period_us: u32) -> u64 {
        self.account.runs += 1;
        let place = Place { run: self.account.runs, ..Place::default() };
        self.ask(place, PolicyMessage::Reset { period_us });
        place.run
    }

    /// Begins a breath.
    pub(super) fn start(&mut self, place: Place, seen: &Observation, applied: f32) {
        let Observation { pip, peep, rise_ticks, .. } = *seen;
        self.ask(place, PolicyMessage::Start { breath: place.breath, pip, peep, applied, rise_ticks });
    }

    /// Tells the policy what to do with the breath that has ended.
    pub(super) fn learn(&mut self, place: Place, lesson: Lesson, applied: f32) {
        self.ask(place, PolicyMessage::Learn { lesson, applied });
    }

    /// Counts a breath.
    pub(super) fn breath_begins(&mut self) {
        self.account.breaths += 1;
    }

    /// The policy's command, percent; none if there is none or it cannot be used.
    pub(super) fn command(&mut self, place: Place, seen: &Observation, applied: f32) -> Option<f32> {
        let Observation { pressure, target, pip, peep, tick, .. } = *seen;
        let asked = Instant::now();
        let answer = self.ask(place, PolicyMessage::Observe { pressure, target, pip, peep, applied, tick });
        let Some(PolicyMessage::Command { u_in }) = answer else { return None };
        self.account.answers.add(asked.elapsed());
        // A NaN is not within either. A command out of range is not limited: it shows a mistake, such as a wrong unit.
        if (0.0..=COMMAND_MAX).contains(&u_in) {
            return Some(u_in);
        }
        self.account.refused += 1;
        self.account.first_refused.get_or_insert_with(|| place.event(format!("a command of {u_in} percent")));
        None
    }

    /// One exchange, unless the link is broken or another ventilation has begun. A failure is kept, with its place.
    fn ask(&mut self, place: Place, message: PolicyMessage) -> Option<PolicyMessage> {
        if self.broken.is_some() {
            return None;
        }
        let answer =
            if place.run == self.account.runs { self.exchange(message) } else { Err(PolicyError::Shared) };
        if let Err(error) = &answer {
            self.account.failure = Some(place.event(error.to_string()));
            self.broken = Some(error.clone());
        }
        answer.ok()
    }

    fn exchange(&mut self, message: PolicyMessage) -> Result<PolicyMessage, PolicyError> {
        self.number = self.number.wrapping_add(1);
        let (asked, question) = (PolicyFrame { number: self.number, message }, message.name());
        let answered = self.line.exchange::<FRAME_BYTES>(&asked.encode());
        let bytes = answered.map_err(|error| PolicyError::Line { question, error })?;
        let answer = PolicyFrame::decode(&bytes).ok_or_else(|| PolicyError::NoFrame {
            question,
            bytes: bytes.map(|byte| format!("{byte:02X}")).join(" "),
        })?;
        if answer.number != asked.number {
            return Err(PolicyError::Number { asked: asked.number, told: answer.number });
        }
        match (message, answer.message) {
            (PolicyMessage::Hello { .. }, PolicyMessage::Greeting { .. })
            | (
                PolicyMessage::Reset { .. } | PolicyMessage::Start { .. } | PolicyMessage::Learn { .. },
                PolicyMessage::Ready,
            )
            | (PolicyMessage::Observe { .. }, PolicyMessage::Command { .. }) => Ok(answer.message),
            (_, other) => Err(PolicyError::Kind { question, answer: other.name() }),
        }
    }
}
