//! A measurement of the margins of a device that ventilates: its requests, and its breaths. Reads no clock and knows no page.
//!
//! The device goes on ventilating. It gets the sweep first, so that one which refuses it, as under an alarm, keeps its settings; then
//! the settings of a ramp; and at the end those of before. An alarm, other settings or a lost line ends the measurement.

use monitoring::{News, words};
use shared::link::messages::{Event, Request, Response};
use shared::link::telemetry::{PackedSample, TelemetryBatch};
use shared::safety::alarms::{Action, Fault};
use shared::settings::Settings;
use shared::ventilator::{Mode, Sample};
use tuning::measurement::{Ended, Measurement, Plan, PlanError};

/// Breaths from the newest known one to the first of the measurement: by then the device has its settings.
const AHEAD: u32 = 4;

/// Why a measurement ends if the device restarts.
pub const RESTARTED: &str = "the device has started again";

/// What is waited for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Stage {
    /// That the device takes the sweep.
    Sweep,
    /// That it takes the settings.
    Settings,
    /// Breaths.
    Breaths,
}

/// What comes after a piece of news.
#[derive(Debug)]
pub enum Next {
    /// Another request.
    Ask(Request),
    /// The breaths of the measurement follow.
    Begun,
    /// The device has refused: why, and the request that undoes what it has not refused.
    Refused(String, Option<Request>),
    /// It is over.
    Over(Over),
}

/// The end of a measurement.
#[derive(Debug)]
pub struct Over {
    /// Why, if not after the last breath.
    pub ended: Option<Ended>,
    /// Why nothing can be shown, if a plan has turned out to be wrong.
    pub refused: Option<PlanError>,
    /// What restores the device.
    pub undo: Vec<Request>,
}

impl Over {
    /// Why there is nothing to show of a measurement; none if there is.
    pub fn nothing(&self, measurement: &Measurement) -> Option<String> {
        match (&self.refused, &self.ended) {
            (Some(refused), _) => Some(refused.to_string()),
            _ if measurement.has_result() => None,
            (None, Some(Ended::Alarm(why))) => Some(format!("an alarm ended the measurement: {why}")),
            (None, Some(Ended::Failed(why))) => Some(why.clone()),
            (None, _) => Some("stopped before the first frequency was complete".to_owned()),
        }
    }
}

/// A measurement under way.
#[derive(Debug)]
pub struct Measuring {
    measurement: Measurement,
    /// The settings of before.
    before: Settings,
    /// Number of the first breath.
    first: u32,
    stage: Stage,
    /// The samples of the present breath.
    samples: Vec<Sample>,
}

impl Measuring {
    /// Measures a device with these settings by this plan. `newest` is the number of its newest breath.
    ///
    /// # Errors
    /// A plan that is refused.
    pub fn new(plan: Plan, period_us: u32, before: Settings, newest: u32) -> Result<Self, PlanError> {
        let measurement = Measurement::new(plan, period_us)?;
        let first = newest.saturating_add(AHEAD);
        Ok(Self { measurement, before, first, stage: Stage::Sweep, samples: Vec::new() })
    }

    /// The first request.
    pub fn request(&self) -> Request {
        Request::SetSweep(Some(self.measurement.sweep_from(self.first)))
    }

    fn settings(&self) -> Request {
        Request::ApplySettings(self.measurement.plan().settings)
    }

    /// Breaths so far, and all.
    pub fn breaths(&self) -> (u32, u32) {
        (self.measurement.breaths(), self.measurement.plan().breaths())
    }

    /// The measurement.
    pub fn into_measurement(self) -> Measurement {
        self.measurement
    }

    /// Takes a piece of news.
    pub fn take(&mut self, news: &News) -> Option<Next> {
        match news {
            News::Lost(reason) => Some(Next::Over(self.leave(reason))),
            News::Event(Event::Alarm { fault, .. }) => self.alarmed(*fault),
            News::Event(Event::Telemetry(batch)) if self.stage == Stage::Breaths => {
                self.listen(batch).map(Next::Over)
            }
            News::Answer { request, result } => self.answered(request, result),
            News::Event(_) | News::Traffic(_) => None,
        }
    }

    /// Ends it for a reason outside of the device.
    pub fn end(&self, ended: Ended) -> Over {
        Over { ended: Some(ended), refused: None, undo: self.undo() }
    }

    fn undo(&self) -> Vec<Request> {
        vec![Request::SetSweep(None), Request::ApplySettings(self.before)]
    }

    /// The end of a measurement whose device must not get the settings of before: it has others, or is not there.
    pub fn leave(&self, reason: &str) -> Over {
        Over { undo: Vec::new(), ..self.end(Ended::Failed(reason.to_owned())) }
    }

    /// The device ends the sines at any alarm but that of a leak.
    fn alarmed(&self, fault: Fault) -> Option<Next> {
        if fault == Fault::Leak {
            return None;
        }
        let over = self.end(Ended::Alarm(words::fault(fault).to_owned()));
        let vents = fault.alarm().action == Action::Vent;
        Some(Next::Over(if vents { Over { undo: Vec::new(), ..over } } else { over }))
    }

    fn answered(&mut self, request: &Request, result: &Result<Response, String>) -> Option<Next> {
        let own = match self.stage {
            Stage::Sweep => *request == self.request(),
            Stage::Settings => *request == self.settings(),
            Stage::Breaths => false,
        };
        match (self.stage, result) {
            (Stage::Sweep, Ok(_)) if own => {
                self.stage = Stage::Settings;
                Some(Next::Ask(self.settings()))
            }
            (Stage::Settings, Ok(_)) if own => {
                self.stage = Stage::Breaths;
                Some(Next::Begun)
            }
            (Stage::Sweep, Err(why)) if own => Some(Next::Refused(why.clone(), None)),
            (Stage::Settings, Err(why)) if own => {
                Some(Next::Refused(why.clone(), Some(Request::SetSweep(None))))
            }
            (_, Ok(response)) => self.is_left(response),
            (_, Err(_)) => None,
        }
    }

    /// Whether the device does something else.
    fn is_left(&self, response: &Response) -> Option<Next> {
        let mode = match response {
            Response::Mode(mode) => Some(*mode),
            Response::Identity(identity) => Some(identity.mode),
            _ => None,
        };
        if mode.is_some_and(|mode| mode != Mode::Ventilating) {
            return Some(Next::Over(self.leave("the ventilation was stopped")));
        }
        let wanted = self.measurement.plan().settings;
        match response {
            Response::Settings { in_force, pending }
                if self.measurement.breaths() > 0 && pending.unwrap_or(*in_force) != wanted =>
            {
                Some(Next::Over(self.leave("another program has changed the settings")))
            }
            _ => None,
        }
    }

    /// Takes samples; the end, if there is one.
    fn listen(&mut self, batch: &TelemetryBatch) -> Option<Over> {
        for sample in batch.samples.iter().map(PackedSample::unpack) {
            if let Some(what) = words::impossible(&sample) {
                return Some(self.end(Ended::Failed(format!("the device sends {what}"))));
            }
            let awaited = self.first + self.measurement.breaths();
            if sample.breath < awaited {
                if self.measurement.breaths() == 0 {
                    continue;
                }
                return Some(self.leave(RESTARTED));
            }
            if sample.breath == awaited + 1 && !self.samples.is_empty() {
                let samples = std::mem::take(&mut self.samples);
                if let Some(over) = self.breath(samples) {
                    return Some(over);
                }
            }
            let follows = sample.breath == self.first + self.measurement.breaths()
                && sample.tick as usize == self.samples.len();
            if !follows {
                return Some(self.end(Ended::Failed("samples were lost on the line".to_owned())));
            }
            self.samples.push(sample);
        }
        None
    }

    /// Takes a whole breath.
    fn breath(&mut self, samples: Vec<Sample>) -> Option<Over> {
        match self.measurement.take(samples) {
            Ok(None) if self.measurement.is_complete() => {
                Some(Over { ended: None, refused: None, undo: self.undo() })
            }
            Ok(ended) => ended.map(|ended| self.end(ended)),
            Err(refused) => Some(Over { ended: None, refused: Some(refused), undo: self.undo() }),
        }
    }
}

#[cfg(test)]
mod tests;
