//! Which answers belong to a request, and which no device can give.

use std::fmt::Debug;
use std::ops::RangeInclusive;

use shared::breath::PERIOD_BOUNDS_US;
use shared::link::messages::{Request, Response};

use shared::ventilator::Sample;

use super::DeviceError;

/// Shortest and longest control period, microseconds.
pub(super) const SHORTEST_US: u32 = PERIOD_BOUNDS_US.0;
pub(super) const LONGEST_US: u32 = PERIOD_BOUNDS_US.1;
/// Largest pressure that counts as one, cmH2O: ten times what breaks a lung.
const PRESSURE_MAX: f32 = 1000.0;
/// Valve commands that count as such, percent.
const VALVE: RangeInclusive<f32> = 0.0..=100.0;

/// Name of a message's variant.
pub(super) fn kind(message: &impl Debug) -> String {
    format!("{message:?}").chars().take_while(char::is_ascii_alphanumeric).collect()
}

/// The error of an answer that does not belong to its request.
pub(super) fn unexpected(request: &Request, response: &Response) -> DeviceError {
    DeviceError::Unexpected { request: kind(request), response: kind(response) }
}

/// Checks an answer before anything acts on it.
///
/// # Errors
/// [`DeviceError::Unexpected`], [`DeviceError::Period`] or [`DeviceError::Settings`].
pub(super) fn check(request: &Request, response: &Response) -> Result<(), DeviceError> {
    if !belongs(request, response) {
        return Err(unexpected(request, response));
    }
    match response {
        Response::Identity(identity) if !(SHORTEST_US..=LONGEST_US).contains(&identity.period_us) => {
            Err(DeviceError::Period(identity.period_us))
        }
        Response::Settings { in_force, pending } => in_force
            .validate()
            .and(pending.map_or(Ok(()), |next| next.validate()))
            .map_err(DeviceError::Settings),
        _ => Ok(()),
    }
}

/// What is impossible about a sample, in words. A pressure that is not a number is possible: no sensor may be sound.
pub fn impossible(sample: &Sample) -> Option<String> {
    let Sample { target, pressure, u_in, explore, learned, flow, .. } = *sample;
    if !VALVE.contains(&u_in) {
        Some(format!("a valve command of {u_in} %"))
    } else if !(target.abs() <= PRESSURE_MAX) {
        Some(format!("a target of {target} cmH2O"))
    } else if pressure.abs() > PRESSURE_MAX {
        Some(format!("a pressure of {pressure} cmH2O"))
    } else if !explore.is_finite() || !learned.is_finite() {
        Some(format!("a perturbation of {explore} % and a learned part of {learned} %"))
    } else {
        flow.filter(|flow| !flow.is_finite()).map(|flow| format!("a flow of {flow} L/s"))
    }
}

/// Whether a response is the one that answers this request; a refusal answers all.
fn belongs(request: &Request, response: &Response) -> bool {
    match request {
        Request::Identify => matches!(response, Response::Identity(_)),
        Request::GetSettings | Request::ApplySettings(_) => matches!(response, Response::Settings { .. }),
        Request::Start | Request::Stop | Request::Acknowledge => matches!(response, Response::Mode(_)),
        Request::SetController(_) => matches!(response, Response::Controller(_)),
        Request::SetExploration(_) => matches!(response, Response::Exploration(_)),
        Request::Telemetry { .. } => matches!(response, Response::Telemetry { .. }),
        Request::BeginWeights { .. } | Request::WeightsChunk { .. } => {
            matches!(response, Response::Progress { .. })
        }
        Request::CommitWeights => matches!(response, Response::Weights { .. }),
        Request::Reset | Request::ResetPlant { .. } | Request::ClearRecorder => {
            matches!(response, Response::Done)
        }
        Request::QueueSettings(_) => matches!(response, Response::Queued { .. }),
        Request::GetTiming { .. } => matches!(response, Response::Timing(_)),
        Request::GetRecorder => matches!(response, Response::Recorder(_)),
        Request::ReadRecorder { .. } => matches!(response, Response::Recorded(_)),
        Request::GetAlarms => matches!(response, Response::Alarms(_)),
        Request::PauseAudio { .. } | Request::GetAudio => matches!(response, Response::Audio(_)),
        Request::GetSelfTest | Request::RunSelfTest(_) => matches!(response, Response::SelfTest(_)),
        Request::AcquireLease { .. } | Request::ReleaseLease | Request::GetLease => {
            matches!(response, Response::Lease(_))
        }
        Request::StoreCalibration(_) | Request::GetCalibration { .. } => {
            matches!(response, Response::Calibration { .. })
        }
    }
}
