//! A third-party plant, in any language, behind the lockstep plant link (`docs/PLANT_LINK.md`): its address, its
//! greeting, and single exchanges.
//!
//! All answers are checked: a late, missing, damaged or impossible answer ends the link with an error that describes
//! the problem, and every later exchange returns the same error.

use std::time::Duration;

use shared::link::plant_link::{FRAME_BYTES, PlantFrame, PlantMessage, VERSION};
use thiserror::Error;

use crate::line::{Address, Line, LineError};
use crate::{Plant, Reading, TickTruth};

/// The address of a plant.
pub type PlantAddress = Address;

/// Default for the longest time that an answer may take.
pub const PATIENCE: Duration = Duration::from_secs(10);
/// Largest pressure limit that a plant may report in its greeting, cmH2O.
const HIGHEST_MAX: u16 = 1000;

/// Why a plant cannot be used, or can no longer be used.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum PlantError {
    /// No plant listens at the address.
    #[error(
        "cannot connect to the plant at {address}: {reason}; start it first, for example with `python3 plant.py 7000`"
    )]
    Connect {
        /// The address.
        address: String,
        /// The reason.
        reason: String,
    },
    /// The command cannot be started.
    #[error("cannot start the plant `{command}`: {reason}")]
    Start {
        /// The command.
        command: String,
        /// The reason.
        reason: String,
    },
    /// The answer did not arrive in time.
    #[error(
        "the plant sent {bytes} of {FRAME_BYTES} bytes in {seconds} s after {question}: check that it reads its line; if it is only slow, raise --plant-timeout"
    )]
    Late {
        /// The request.
        question: &'static str,
        /// Number of bytes received.
        bytes: usize,
        /// The time limit, s.
        seconds: f64,
    },
    /// The line is closed.
    #[error("the plant is gone{status}: it closed its line after {question}; start it again")]
    Gone {
        /// The request.
        question: &'static str,
        /// How the plant ended, if known.
        status: String,
    },
    /// The line failed in another way.
    #[error("the plant's line failed after {question}: {reason}")]
    Line {
        /// The request.
        question: &'static str,
        /// The system's error.
        reason: String,
    },
    /// The answer is not a frame.
    #[error(
        "the plant answered {question} with bytes that are not a frame ({bytes}): check start byte, byte order and CRC; a plant on a pipe may print only to standard error"
    )]
    NoFrame {
        /// The request.
        question: &'static str,
        /// The bytes received.
        bytes: String,
    },
    /// The plant uses another version of the protocol.
    #[error(
        "the plant uses version {0} of the plant link, but this program uses version {VERSION}: use matching versions"
    )]
    Version(u16),
    /// The pressure limit in the greeting is not valid.
    #[error("the plant's greeting gives a highest pressure of {0} cmH2O; it must be 1 to {HIGHEST_MAX}")]
    Limit(u16),
    /// The plant does not support the control period.
    #[error("the plant does not support a period of {asked} us{own}: set a supported one with --period-us")]
    Period {
        /// Requested period, microseconds.
        asked: u32,
        /// The supported period as text, if known.
        own: String,
    },
    /// The answer belongs to another request.
    #[error(
        "the plant is out of step: it answered tick {told} to a request with tick {asked}; it must answer every frame once, with its tick"
    )]
    Tick {
        /// Tick of the request.
        asked: u16,
        /// Tick of the answer.
        told: u16,
    },
    /// The answer is of the wrong kind.
    #[error("the plant answered {question} with {answer}")]
    Kind {
        /// The request.
        question: &'static str,
        /// The answer.
        answer: &'static str,
    },
    /// An impossible pressure.
    #[error(
        "the plant reports {what} of {value} cmH2O after {question}; its greeting allows at most {highest} cmH2O"
    )]
    Pressure {
        /// The kind of pressure.
        what: &'static str,
        /// Its value.
        value: String,
        /// The request.
        question: &'static str,
        /// Highest magnitude allowed by its greeting, cmH2O.
        highest: u16,
    },
    /// The true pressure is reported only sometimes.
    #[error(
        "the plant reports the true pressure only sometimes; it must report it after every Reset and Step, or never"
    )]
    Truth,
}

impl PlantError {
    /// For a plant whose line cannot be opened or gives no answer to this request.
    fn of_line(error: LineError, question: &'static str) -> Self {
        match error {
            LineError::Connect { address, reason } => Self::Connect { address, reason },
            LineError::Start { command, reason } => Self::Start { command, reason },
            LineError::Late { bytes, seconds, .. } => Self::Late { question, bytes, seconds },
            LineError::Gone { status } => Self::Gone { question, status },
            LineError::Failed(reason) => Self::Line { question, reason },
        }
    }

    /// For a plant with its own control period, both in microseconds.
    pub fn other_period(asked: u32, own: u32) -> Self {
        Self::Period { asked, own: format!(", but {own} us") }
    }
}

/// A plant's description of itself.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Greeting {
    /// Highest magnitude of its pressures, cmH2O.
    pub highest: u16,
    /// The only control period that it supports, microseconds; `None` if it supports any.
    pub period_us: Option<u32>,
}

/// The ventilator's end of the link.
pub struct PlantLink {
    line: Line,
    address: PlantAddress,
    greeting: Greeting,
    tick: u16,
    /// Whether the last Reset was answered with the true pressure.
    truthful: bool,
    /// The error that ended the link.
    broken: Option<PlantError>,
}

impl PlantLink {
    /// Connects to a plant, or starts it, and exchanges greetings; every answer may take up to `patience`.
    ///
    /// # Errors
    /// A plant that cannot be reached, does not answer or uses another version.
    pub fn open(address: &PlantAddress, patience: Duration) -> Result<Self, PlantError> {
        let line = Line::open(address, patience).map_err(|error| PlantError::of_line(error, ""))?;
        let greeting = Greeting { highest: HIGHEST_MAX, period_us: None };
        let mut link =
            Self { line, address: address.clone(), greeting, tick: 0, truthful: false, broken: None };
        link.greeting = link.greet()?;
        Ok(link)
    }

    /// The plant's address.
    pub fn address(&self) -> &PlantAddress {
        &self.address
    }

    /// The plant's greeting.
    pub fn greeting(&self) -> Greeting {
        self.greeting
    }

    fn greet(&mut self) -> Result<Greeting, PlantError> {
        match self.ask(PlantMessage::Hello { version: VERSION.into() })? {
            PlantMessage::Greeting { version, .. } if version != VERSION => Err(PlantError::Version(version)),
            PlantMessage::Greeting { highest, .. } if highest == 0 || highest > HIGHEST_MAX => {
                Err(PlantError::Limit(highest))
            }
            PlantMessage::Greeting { highest, period_us, .. } => {
                Ok(Greeting { highest, period_us: (period_us > 0).then_some(period_us) })
            }
            other => unreachable!("{other:?} was refused as an answer"),
        }
    }

    /// One exchange. An error is stored.
    fn ask(&mut self, message: PlantMessage) -> Result<PlantMessage, PlantError> {
        if let Some(error) = &self.broken {
            return Err(error.clone());
        }
        let answer = self.exchange(message);
        self.broken = answer.as_ref().err().cloned();
        answer
    }

    fn exchange(&mut self, message: PlantMessage) -> Result<PlantMessage, PlantError> {
        self.tick = self.tick.wrapping_add(1);
        let asked = PlantFrame { tick: self.tick, message };
        let question = name(message);
        let bytes =
            self.line.exchange(&asked.encode()).map_err(|error| PlantError::of_line(error, question))?;
        let answer = PlantFrame::decode(&bytes).ok_or_else(|| PlantError::NoFrame {
            question,
            bytes: bytes.map(|byte| format!("{byte:02X}")).join(" "),
        })?;
        if answer.tick != asked.tick {
            return Err(PlantError::Tick { asked: asked.tick, told: answer.tick });
        }
        match (message, answer.message) {
            (PlantMessage::Hello { .. }, PlantMessage::Greeting { .. })
            | (PlantMessage::Step { .. }, PlantMessage::Pressure { .. } | PlantMessage::Truth { .. })
            | (PlantMessage::Reset { .. }, PlantMessage::Ready { .. } | PlantMessage::Truth { .. })
            | (PlantMessage::Peep { .. } | PlantMessage::Seed { .. }, PlantMessage::Ready { .. }) => {
                Ok(answer.message)
            }
            (_, other) => Err(PlantError::Kind { question, answer: name(other) }),
        }
    }

    /// The pressures of an answer, if they are possible.
    fn reading(&mut self, answer: PlantMessage, question: &'static str) -> Result<Reading, PlantError> {
        let (pressure, airway) = match answer {
            PlantMessage::Truth { pressure, airway } => (pressure, Some(airway)),
            PlantMessage::Ready { pressure } | PlantMessage::Pressure { pressure } => (pressure, None),
            other => unreachable!("{other:?} was refused as an answer"),
        };
        let highest = self.greeting.highest;
        let lie = |what, value: f32| {
            // NaN is not possible either.
            let possible = value.abs() <= f32::from(highest);
            let error = || PlantError::Pressure { what, value: value.to_string(), question, highest };
            (!possible).then(error)
        };
        let lie = lie("a pressure", pressure).or_else(|| lie("a true pressure", airway?));
        let error = match lie {
            Some(error) => error,
            None if airway.is_some() != self.truthful => PlantError::Truth,
            None => {
                // A plant reports only the airway pressure.
                let unknown = f32::NAN;
                let truth = airway.map(|airway_pressure| TickTruth {
                    airway_pressure,
                    sensor_pressure: unknown,
                    lung_volume: unknown,
                });
                return Ok(Reading { truth, ..Reading::of_pressure(pressure) });
            }
        };
        self.broken = Some(error.clone());
        Err(error)
    }
}

/// A plant over the link is driven like any other. In addition to the link's errors, [`Plant::reset`] refuses a control
/// period that the plant does not support.
impl Plant for PlantLink {
    type Error = PlantError;

    fn name(&self) -> String {
        format!("plant at {}", self.address)
    }

    fn reset(&mut self, period_us: u32, seed: u64, peep: f32) -> Result<Reading, PlantError> {
        if let Some(own) = self.greeting.period_us.filter(|own| *own != period_us) {
            return Err(PlantError::other_period(period_us, own));
        }
        self.ask(PlantMessage::Seed { seed })?;
        self.set_peep(peep)?;
        self.truthful = false;
        let answer = self.ask(PlantMessage::Reset { period_us })?;
        if let PlantMessage::Ready { pressure } = answer
            && pressure.is_nan()
        {
            return Err(PlantError::Period { asked: period_us, own: String::new() });
        }
        self.truthful = matches!(answer, PlantMessage::Truth { .. });
        self.reading(answer, "Reset")
    }

    fn set_peep(&mut self, peep: f32) -> Result<(), PlantError> {
        self.ask(PlantMessage::Peep { pressure: peep }).map(|_| ())
    }

    fn step(&mut self, u_in: f32, u_out: bool) -> Result<Reading, PlantError> {
        let answer = self.ask(PlantMessage::Step { u_in, u_out })?;
        self.reading(answer, "Step")
    }
}

/// Name of a message in errors.
fn name(message: PlantMessage) -> &'static str {
    match message {
        PlantMessage::Reset { .. } => "Reset",
        PlantMessage::Step { .. } => "Step",
        PlantMessage::Peep { .. } => "Peep",
        PlantMessage::Seed { .. } => "Seed",
        PlantMessage::Hello { .. } => "Hello",
        PlantMessage::Greeting { .. } => "Greeting",
        PlantMessage::Ready { .. } => "Ready",
        PlantMessage::Pressure { .. } => "Pressure",
        PlantMessage::Truth { .. } => "Truth",
    }
}
