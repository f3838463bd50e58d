//! A third-party plant, in any language, behind the lockstep plant link (`docs/PLANT_LINK.md`): where it is,
//! who it is, and one exchange at a time.
//!
//! Nothing that comes from a plant is believed unseen: a late, missing, torn or impossible answer ends the link with an error
//! that says what was wrong, and every later exchange gives the same error.

mod address;
mod line;

use std::time::Duration;

use shared::link::plant_link::{FRAME_BYTES, PlantFrame, PlantMessage, VERSION};
use thiserror::Error;

use crate::{Plant, Reading, TickTruth};
pub use address::{AddressError, PlantAddress, is_host_and_port};
use line::Line;

/// How long an answer may take unless told otherwise.
pub const PATIENCE: Duration = Duration::from_secs(10);
/// Highest pressure that a plant may claim, cmH2O.
const HIGHEST_MAX: u16 = 1000;

/// Why a plant cannot be used, or no longer.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum PlantError {
    /// Nobody listens there.
    #[error(
        "cannot connect to the plant at {address}: {reason}; start it first, as in `python3 plant.py 7000`"
    )]
    Connect {
        /// The address.
        address: String,
        /// Why not.
        reason: String,
    },
    /// The command cannot be started.
    #[error("cannot start the plant `{command}`: {reason}")]
    Start {
        /// The command.
        command: String,
        /// Why not.
        reason: String,
    },
    /// No answer in time.
    #[error(
        "the plant sent {bytes} of {FRAME_BYTES} bytes in {seconds} s after {question}; does it read its line? One that is only slow needs a longer --plant-timeout"
    )]
    Late {
        /// What it was asked.
        question: &'static str,
        /// Bytes that came.
        bytes: usize,
        /// How long it had, s.
        seconds: f64,
    },
    /// The line is closed.
    #[error("the plant is gone{status}: it closed its line after {question}; start it again")]
    Gone {
        /// What it was asked.
        question: &'static str,
        /// How it ended, where that is known.
        status: String,
    },
    /// The line fails otherwise.
    #[error("the plant's line failed after {question}: {reason}")]
    Line {
        /// What it was asked.
        question: &'static str,
        /// What the system says.
        reason: String,
    },
    /// Bytes that are no frame.
    #[error(
        "the plant answered {question} with bytes that are no frame ({bytes}): check start byte, byte order and CRC; a plant on a pipe may print to standard error alone"
    )]
    NoFrame {
        /// What it was asked.
        question: &'static str,
        /// The bytes.
        bytes: String,
    },
    /// Another version of the protocol.
    #[error(
        "the plant speaks version {0} of the plant link, this program version {VERSION}: take the one that fits"
    )]
    Version(u16),
    /// A greeting whose limit makes no sense.
    #[error("the plant greets with a highest pressure of {0} cmH2O; it must be 1 to {HIGHEST_MAX}")]
    Limit(u16),
    /// A control period that it does not run.
    #[error("the plant does not run at a control period of {asked} us{own}; say so with --period-us")]
    Period {
        /// Period asked for, microseconds.
        asked: u32,
        /// What it runs, where that is known.
        own: String,
    },
    /// An answer to something else.
    #[error(
        "the plant is out of step: it answered tick {told} where {asked} was asked; it must answer every frame once, with its tick"
    )]
    Tick {
        /// Tick asked.
        asked: u16,
        /// Tick told.
        told: u16,
    },
    /// An answer of the wrong kind.
    #[error("the plant answered {question} with {answer}")]
    Kind {
        /// What it was asked.
        question: &'static str,
        /// What it said.
        answer: &'static str,
    },
    /// A pressure that cannot be.
    #[error(
        "the plant tells {what} of {value} cmH2O after {question}; by its greeting at most {highest} cmH2O"
    )]
    Pressure {
        /// Which pressure.
        what: &'static str,
        /// Its value.
        value: String,
        /// What it was asked.
        question: &'static str,
        /// Highest magnitude by its greeting, cmH2O.
        highest: u16,
    },
    /// The truth is told now and then.
    #[error(
        "the plant tells the true pressure only now and then; it must do so after every Reset and Step, or never"
    )]
    Truth,
}

impl PlantError {
    /// For a plant with a control period of its own, both in microseconds.
    pub fn other_period(asked: u32, own: u32) -> Self {
        Self::Period { asked, own: format!(", but at {own} us") }
    }
}

/// What a plant says of itself.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Greeting {
    /// Highest magnitude of its pressures, cmH2O.
    pub highest: u16,
    /// Control period that it is made for, microseconds; none if it runs any.
    pub period_us: Option<u32>,
}

/// The ventilator's end of the link.
pub struct PlantLink {
    line: Line,
    address: PlantAddress,
    greeting: Greeting,
    tick: u16,
    /// Whether the last Reset was answered with the truth.
    truthful: bool,
    /// Why nothing more can be asked.
    broken: Option<PlantError>,
}

impl PlantLink {
    /// Connects to a plant, or starts it, and greets it; every answer may take as long as `patience`.
    ///
    /// # Errors
    /// A plant that is not there, does not answer or speaks another version.
    pub fn open(address: &PlantAddress, patience: Duration) -> Result<Self, PlantError> {
        let line = Line::open(address, patience)?;
        let greeting = Greeting { highest: HIGHEST_MAX, period_us: None };
        let mut link =
            Self { line, address: address.clone(), greeting, tick: 0, truthful: false, broken: None };
        link.greeting = link.greet()?;
        Ok(link)
    }

    /// Where the plant is.
    pub fn address(&self) -> &PlantAddress {
        &self.address
    }

    /// What it said of itself.
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

    /// One exchange. Whatever goes wrong is remembered.
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
        let bytes = self.line.exchange(question, &asked.encode())?;
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

    /// The pressures of an answer, if they can be.
    fn reading(&mut self, answer: PlantMessage, question: &'static str) -> Result<Reading, PlantError> {
        let (pressure, airway) = match answer {
            PlantMessage::Truth { pressure, airway } => (pressure, Some(airway)),
            PlantMessage::Ready { pressure } | PlantMessage::Pressure { pressure } => (pressure, None),
            other => unreachable!("{other:?} was refused as an answer"),
        };
        let highest = self.greeting.highest;
        let lie = |what, value: f32| {
            // A NaN is not possible either.
            let possible = value.abs() <= f32::from(highest);
            let error = || PlantError::Pressure { what, value: value.to_string(), question, highest };
            (!possible).then(error)
        };
        let lie = lie("a pressure", pressure).or_else(|| lie("a true pressure", airway?));
        let error = match lie {
            Some(error) => error,
            None if airway.is_some() != self.truthful => PlantError::Truth,
            None => {
                // A plant tells the airway's pressure and nothing else.
                let unknown = f32::NAN;
                let truth = airway.map(|airway_pressure| TickTruth {
                    airway_pressure,
                    sensor_pressure: unknown,
                    lung_volume: unknown,
                });
                return Ok(Reading { pressure, truth });
            }
        };
        self.broken = Some(error.clone());
        Err(error)
    }
}

/// A plant over the link is driven as any other. Beside what the link itself can meet, [`Plant::reset`] refuses a control
/// period that the plant does not run.
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

/// A message as errors name it.
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
